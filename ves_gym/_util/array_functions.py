"""Functions of arrays for which NumPy and compiled graphs have no common spelling.

A formula written with `+`, `@`, slices, `np.stack` and these runs on arrays of numbers and,
with `engine.kernel.graph_arrays.GRAPH` in place of `NUMPY`, on arrays of symbols.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from ves_gym._util.params import Array


class ArrayFunctions(Protocol):
    """A namespace `xp` of array functions; truth values may be numbers 0 and 1."""

    def zeros(self, shape: tuple[int, ...]) -> Array:
        """Zeros that may be overwritten."""

    def where(self, condition: Any, a: Any, b: Any) -> Array:
        """`a` where the condition holds, `b` elsewhere."""

    def less_equal(self, a: Any, b: Any) -> Any:
        """a <= b; false where either is not a number."""

    def not_equal(self, a: Any, b: Any) -> Any:
        """a != b."""

    def all(self, condition: Any) -> Any:
        """True where the condition holds all along the last axis."""

    def any(self, condition: Any) -> Any:
        """True where the condition holds somewhere along the last axis."""

    def both(self, a: Any, b: Any) -> Any:
        """True where both hold."""

    def either(self, a: Any, b: Any) -> Any:
        """True where one of the two holds."""

    def negate(self, condition: Any) -> Any:
        """True where the condition does not hold."""

    def maximum(self, a: Any, b: Any) -> Array:
        """The larger one."""

    def largest(self, a: Any) -> Array:
        """The largest along the last axis."""

    def rint(self, a: Any) -> Array:
        """The nearest whole number, halves to the even one."""

    def solve(self, A: Array, b: Array) -> Array:
        """Return A^-1 b.

        Args:
            A: (..., m, m), one that elimination without exchange of rows can solve.
            b: (..., m).

        Returns:
            (..., m), in NumPy NaN where A is singular.
        """


class _NumpyFunctions:
    """`ArrayFunctions` of numbers."""

    less_equal = staticmethod(np.less_equal)
    not_equal = staticmethod(np.not_equal)
    both = staticmethod(np.logical_and)
    either = staticmethod(np.logical_or)
    negate = staticmethod(np.logical_not)
    maximum = staticmethod(np.maximum)
    rint = staticmethod(np.rint)

    @staticmethod
    def zeros(shape: tuple[int, ...]) -> Array:
        return np.zeros(shape)

    @staticmethod
    def where(condition: Any, a: Any, b: Any) -> Array:
        out: Array = np.where(condition, a, b)
        return out

    @staticmethod
    def all(condition: Any) -> Any:
        return np.all(condition, axis=-1)

    @staticmethod
    def any(condition: Any) -> Any:
        return np.any(condition, axis=-1)

    @staticmethod
    def largest(a: Any) -> Array:
        return np.asarray(np.max(a, axis=-1))

    @staticmethod
    def solve(A: Array, b: Array) -> Array:
        try:
            out = np.linalg.solve(A, b[..., None])[..., 0]
        except np.linalg.LinAlgError:  # of one matrix; the others have their answers
            bad = np.linalg.det(A) == 0
            out = np.linalg.solve(
                np.where(bad[..., None, None], np.eye(b.shape[-1]), A), b[..., None]
            )[..., 0]
            out = np.where(bad[..., None], np.nan, out)
        return np.asarray(out, dtype=np.float64)


NUMPY: ArrayFunctions = _NumpyFunctions()
