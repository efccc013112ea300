"""Natural modes of many systems at once: Jacobi's rotations, a system per lane."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from ves_gym._util.params import Array
from ves_gym.engine.kernel.compiled_function import (
    CompiledFunction,
    Program,
    aligned,
    everywhere,
    fill,
    unlane,
)
from ves_gym.engine.kernel.emit import LANES
from ves_gym.engine.kernel.symbolic import column, symbols
from ves_gym.mechanics.modes import jacobi_sweep, natural_modes, reduced

if TYPE_CHECKING:
    import casadi

# sweeps over all pairs of axes: in the worst of 1e5 matrices of six axes, near-equal ones among
# them, six leave 2e-11 of the largest entry beside the diagonal and seven 2e-22; seven leave
# 2e-17 of eight axes, nine 5e-26 of twelve
_SWEEPS = {8: 7, 12: 9}  # up to so many axes
_MOST = max(_SWEEPS)  # axes: code grows by their cube


class ModeMap:
    """Modes of K x = omega^2 M x and how vectors push them, for many M, over and over.

    Gives what `mechanics.modes.natural_modes` gives, but for the order of the modes and the
    signs of their shapes; by that function where k is above 12.

    Args:
        K: (k, k) stiffness, symmetric.
        columns: vectors per system.
        n: systems at most.
    """

    def __init__(self, K: Array, columns: int, n: int) -> None:
        self.K, k = K, len(K)
        self._lower = np.tril_indices(k)
        entries = len(self._lower[0])
        self._diagonal = np.cumsum(np.arange(1, k + 1)) - 1  # among the lower entries
        self._run: Program | None = None
        if k > _MOST:
            return
        sizes = entries, k * columns, entries + k * columns, entries + k * columns
        self._M, self._b, source, target = (aligned(-(-n // LANES), m, LANES) for m in sizes)
        reduce, sweep = (
            CompiledFunction(f"{graph.__name__} {k} {columns}", partial(graph, k, columns))
            for graph in (_reduction, _sweep)
        )
        stiffness = everywhere(K[self._lower])
        pieces = [reduce.piece(self._M, stiffness, self._b, source)]
        for _ in range(next(count for most, count in _SWEEPS.items() if k <= most)):
            pieces.append(sweep.piece(source, target))
            source, target = target, source
        self._out, self._run = source, Program(pieces)

    def __call__(self, M: Array, b: Array) -> tuple[Array, Array]:
        """Return frequencies and pushes of m systems, m at most the number given.

        Args:
            M: (m, k, k) mass, symmetric positive definite.
            b: (m, k, columns) vectors.

        Returns:
            omega (m, k) [rad/s], and shapes^T b (m, k, columns), shapes^T M shapes = 1.
        """
        if self._run is None:
            omega, shapes = natural_modes(self.K, M)
            return omega, np.swapaxes(shapes, -1, -2) @ b
        m, size = len(M), b.shape[1] * b.shape[2]
        fill(self._M, M[:, *self._lower])
        fill(self._b, b.reshape(m, size))
        self._run(0, -(-m // LANES))  # the blocks that hold them
        out = unlane(self._out, m)
        omega = np.sqrt(np.maximum(out[:, self._diagonal], 0.0))
        return omega, out[:, -size:].reshape(b.shape)


def _reduction(k: int, columns: int) -> casadi.Function:
    """(M, K, b) -> `modes.reduced`; lower triangles of M, K and the result."""
    import casadi as ca

    entries = k * (k + 1) // 2
    parts = [("M", entries), ("K", entries), ("b", k * columns)]
    mass, stiffness, b = rows = [symbols(name, (size,)) for name, size in parts]
    A, vectors = reduced(_symmetric(stiffness, k), _symmetric(mass, k), b.reshape(k, columns))
    out = column(A[np.tril_indices(k)], vectors)
    return ca.Function("reduce", [column(row) for row in rows], [out])


def _sweep(k: int, columns: int) -> casadi.Function:
    """(A, b) -> `modes.jacobi_sweep`; lower triangles of A."""
    import casadi as ca

    entries = k * (k + 1) // 2
    row = symbols("row", (entries + k * columns,))
    A, b = jacobi_sweep(_symmetric(row[:entries], k), row[entries:].reshape(k, columns))
    out = column(A[np.tril_indices(k)], b)
    return ca.Function("sweep", [column(row)], [out])


def _symmetric(lower: Array, k: int) -> Array:
    """Matrix from its lower triangle, row by row."""
    i, j = np.indices((k, k))
    high, low = np.maximum(i, j), np.minimum(i, j)
    matrix: Array = lower[high * (high + 1) // 2 + low]
    return matrix
