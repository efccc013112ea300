"""Arrays of symbols: NumPy arrays of dtype object that hold CasADi scalars.

They take `+`, `@`, slices, `np.stack` and `np.sin` like any array, so that a text written for
arrays of numbers is traced into a graph; `GRAPH` has what NumPy cannot do with symbols.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ves_gym._util.array_functions import ArrayFunctions
from ves_gym._util.params import Array


def symbols(name: str, shape: tuple[int, ...]) -> Array:
    """Return an array of fresh symbols."""
    import casadi as ca

    size = int(np.prod(shape))
    return array(ca.vertsplit(ca.SX.sym(name, size)) if size else [], shape)


def column(parts: Sequence[Array]) -> Any:
    """Return all entries of arrays of symbols or numbers below each other."""
    import casadi as ca

    flat = [entry for part in parts for entry in np.ravel(part).tolist()]
    return ca.vertcat(*flat) if flat else ca.SX(0, 1)


def array(entries: Sequence[Any], shape: tuple[int, ...]) -> Array:
    """Return an array of symbols.

    Args:
        entries: row by row.
        shape: of the array.
    """
    out = np.empty(len(entries), object)
    for k, entry in enumerate(entries):  # at once, NumPy would look into them
        out[k] = entry
    return out.reshape(shape)


def _elementwise(function: Callable[..., Any], *arrays: Any) -> Array:
    wide = np.broadcast_arrays(*(np.asarray(a, object) for a in arrays))
    entries = [function(*row) for row in zip(*(a.ravel().tolist() for a in wide), strict=True)]
    return array(entries, wide[0].shape)


def _along_last(function: Callable[[Any, Any], Any], a: Any) -> Array:
    array = np.asarray(a, object)
    out = array[..., 0]
    for k in range(1, array.shape[-1]):
        out = _elementwise(function, out, array[..., k])
    return np.asarray(out, object)


class _GraphFunctions:
    """`ArrayFunctions` of symbols; a truth value is a symbol of value 0 or 1."""

    @staticmethod
    def zeros(shape: tuple[int, ...]) -> Array:
        out = np.empty(shape, object)
        out[...] = 0.0
        return out

    @staticmethod
    def where(condition: Any, a: Any, b: Any) -> Array:
        import casadi as ca

        return _elementwise(ca.if_else, condition, a, b)

    @staticmethod
    def less_equal(a: Any, b: Any) -> Any:
        return np.less_equal(np.asarray(a, object), np.asarray(b, object), dtype=object)

    @staticmethod
    def not_equal(a: Any, b: Any) -> Any:
        return np.not_equal(np.asarray(a, object), np.asarray(b, object), dtype=object)

    @staticmethod
    def both(a: Any, b: Any) -> Any:
        return _elementwise(lambda x, y: x * y, a, b)

    @staticmethod
    def either(a: Any, b: Any) -> Any:
        import casadi as ca

        return _elementwise(ca.fmax, a, b)

    @staticmethod
    def negate(condition: Any) -> Any:
        return 1.0 - np.asarray(condition, object)

    @classmethod
    def all(cls, condition: Any) -> Any:
        return _along_last(lambda x, y: x * y, condition)

    @classmethod
    def any(cls, condition: Any) -> Any:
        return cls.largest(condition)

    @staticmethod
    def maximum(a: Any, b: Any) -> Array:
        import casadi as ca

        return _elementwise(ca.fmax, a, b)

    @staticmethod
    def largest(a: Any) -> Array:
        import casadi as ca

        return _along_last(ca.fmax, a)

    @staticmethod
    def rint(a: Any) -> Array:
        import casadi as ca

        # what the kernel makes of remainder(x, 1): x less the nearest whole number
        return _elementwise(lambda x: x - ca.remainder(x, 1.0), a)

    @staticmethod
    def solve(A: Array, b: Array) -> Array:
        shape = np.broadcast_shapes(A.shape[:-2], b.shape[:-1])
        size = b.shape[-1]
        wide = np.broadcast_to(A, (*shape, size, size))
        right = np.broadcast_to(b, (*shape, size))
        out = np.empty(right.shape, object)
        for at in np.ndindex(*shape):
            out[at] = _eliminated(wide[at].tolist(), right[at].tolist())
        return out


def _eliminated(A: list[list[Any]], b: list[Any]) -> list[Any]:
    """Return A^-1 b by elimination from the last row up, as `mechanics.solve` goes.

    The joints are eliminated before their base, so that a joint of 1e8 kg m^2 costs the base
    no digits.
    """
    size, A, b = len(b), [list(row) for row in A], list(b)
    for k in reversed(range(size)):
        inverse = 1.0 / A[k][k]
        for i in range(k):
            factor = A[i][k] * inverse
            if _is_zero(factor):
                continue
            for j in range(k):
                A[i][j] = A[i][j] - factor * A[k][j]
            b[i] = b[i] - factor * b[k]
        A[k][k] = inverse
    out: list[Any] = [0.0] * size
    for k in range(size):
        total = b[k]
        for j in range(k):
            total = total - A[k][j] * out[j]
        out[k] = total * A[k][k]
    return out


def _is_zero(value: Any) -> bool:
    return bool(value.is_zero()) if hasattr(value, "is_zero") else value == 0.0


GRAPH: ArrayFunctions = _GraphFunctions()
