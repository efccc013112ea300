"""Natural modes of many systems at once: Jacobi's rotations, a system per lane."""

from __future__ import annotations

import hashlib
from functools import lru_cache
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ves_gym._util.params import Array
from ves_gym.engine.kernel.blocks import aligned, fill, unlane
from ves_gym.engine.kernel.build import Library, cached
from ves_gym.engine.kernel.emit import LANES
from ves_gym.engine.kernel.pieces import Piece, Program, emit_pieces
from ves_gym.mechanics.modes import natural_modes

if TYPE_CHECKING:
    import casadi

# sweeps over all pairs of axes: in the worst of 1e5 matrices of six axes, near-equal ones among
# them, six leave 2e-11 of the largest entry beside the diagonal and seven 2e-22; seven leave
# 2e-17 of eight axes, nine 5e-26 of twelve
_SWEEPS = {8: 7, 12: 9}  # up to so many axes
_MOST = max(_SWEEPS)  # axes: code grows by their cube
_TINY = 1e-300  # keeps 0 / 0 away where two axes are alike and uncoupled

Matrix = list[list[Any]]  # of expressions


class ModeMap:
    """Modes of K x = omega^2 M x and how vectors push them, for many M, over and over.

    Gives what `mechanics.modes.natural_modes` gives, but for the order of the modes and the
    signs of their shapes; by that function where nothing compiles or k is above 12.

    Args:
        K: (k, k) stiffness, symmetric.
        columns: vectors per system.
        n: systems at most.
    """

    def __init__(self, K: Array, columns: int, n: int) -> None:
        self.K, self._columns = K, columns
        k = len(K)
        self._lower = np.tril_indices(k)
        entries = len(self._lower[0])
        self._diagonal = np.cumsum(np.arange(1, k + 1)) - 1  # among the lower entries
        self._run: Program | None = None
        if k > _MOST:
            return
        try:
            library = _library(k, columns)
        except (ImportError, RuntimeError, OSError):
            return
        self._blocks = -(-n // LANES)
        sizes = (entries, k * columns, entries + k * columns, entries + k * columns)
        self._M, self._b, source, target = (
            aligned(self._blocks, size, LANES) for size in sizes
        )
        stiffness = aligned(1, entries, LANES)
        stiffness[:] = K[self._lower][:, None]
        pieces = [Piece(library, "reduce", [self._M, stiffness, self._b, source])]
        for _ in range(next(n for most, n in _SWEEPS.items() if k <= most)):
            pieces.append(Piece(library, "sweep", [source, target]))
            source, target = target, source
        self._out, self._run = source, Program(library, pieces)

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
        m, size = len(M), b.shape[1] * self._columns
        fill(self._M, M[:, *self._lower])
        fill(self._b, b.reshape(m, size))
        self._run(0, -(-m // LANES))  # the blocks that hold them
        out = unlane(self._out, m)
        omega = np.sqrt(np.maximum(out[:, self._diagonal], 0.0))
        return omega, out[:, -size:].reshape(b.shape)


@lru_cache
def _library(k: int, columns: int) -> Library:
    def text() -> str:
        return emit_pieces({"reduce": _reduction(k, columns), "sweep": _sweep(k, columns)})

    return cached(f"modes {k} {columns} {_source()}", text)


@lru_cache(maxsize=1)
def _source() -> str:
    """Digest of the text that writes the code, so that a changed one is compiled anew."""
    files = [Path(__file__).with_name(name) for name in ("emit.py", "modes.py", "pieces.py")]
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()


def _reduction(k: int, columns: int) -> casadi.Function:
    """(M, K, b) -> A = L^-1 K L^-T and L^-1 b, where M = L L^T; lower triangles of M, K, A."""
    import casadi as ca

    entries = k * (k + 1) // 2
    rows = [ca.SX.sym("M", entries), ca.SX.sym("K", entries), ca.SX.sym("b", k * columns)]
    mass, stiffness, b = (ca.vertsplit(row) for row in rows)
    L = _cholesky(_symmetric(mass, k), ca)
    half = [_forward(L, column) for column in _symmetric(stiffness, k)]
    A = [_forward(L, [half[j][i] for j in range(k)]) for i in range(k)]
    vectors = [_forward(L, b[c::columns]) for c in range(columns)]
    return ca.Function("reduce", rows, [ca.vertcat(*_packed(A, vectors))])


def _sweep(k: int, columns: int) -> casadi.Function:
    """(A, b) -> (V^T A V, V^T b), V a rotation in the plane of each pair of axes in turn.

    Golub and Van Loan, Matrix Computations, 4th ed., 8.5.
    """
    import casadi as ca

    entries = k * (k + 1) // 2
    row = ca.SX.sym("row", entries + k * columns)
    values = ca.vertsplit(row)
    A = _symmetric(values[:entries], k)
    vectors = [values[entries + c :: columns] for c in range(columns)]
    for i, j in combinations(range(k), 2):
        across, half = A[i][j], (A[j][j] - A[i][i]) / 2
        size = ca.fabs(half) + ca.sqrt(half * half + across * across) + _TINY
        t = ca.if_else(half < 0, -across, across) / size  # tangent of the smaller angle
        c = 1 / ca.sqrt(1 + t * t)
        s = t * c
        A[i][i], A[j][j] = A[i][i] - t * across, A[j][j] + t * across
        A[i][j] = A[j][i] = ca.SX(0)
        for other in set(range(k)) - {i, j}:
            x, y = A[other][i], A[other][j]
            A[other][i] = A[i][other] = c * x - s * y
            A[other][j] = A[j][other] = s * x + c * y
        for vector in vectors:
            x, y = vector[i], vector[j]
            vector[i], vector[j] = c * x - s * y, s * x + c * y
    return ca.Function("sweep", [row], [ca.vertcat(*_packed(A, vectors))])


def _symmetric(lower: list[Any], k: int) -> Matrix:
    """Matrix from its lower triangle, row by row."""
    return [
        [lower[max(i, j) * (max(i, j) + 1) // 2 + min(i, j)] for j in range(k)]
        for i in range(k)
    ]


def _packed(A: Matrix, vectors: Matrix) -> list[Any]:
    """Lower triangle of a matrix, then vectors as the columns of a matrix, row by row."""
    lower = [A[i][j] for i in range(len(A)) for j in range(i + 1)]
    return lower + [vector[i] for i in range(len(A)) for vector in vectors]


def _cholesky(M: Matrix, xp: Any) -> Matrix:
    """L of M = L L^T, with the inverse of each number on its diagonal."""
    k = len(M)
    L: Matrix = [[0.0] * k for _ in range(k)]
    for j in range(k):
        L[j][j] = 1 / xp.sqrt(M[j][j] - sum(L[j][m] * L[j][m] for m in range(j)))
        for i in range(j + 1, k):
            L[i][j] = (M[i][j] - sum(L[i][m] * L[j][m] for m in range(j))) * L[j][j]
    return L


def _forward(L: Matrix, b: list[Any]) -> list[Any]:
    """L^-1 b, L as from `_cholesky`."""
    x: list[Any] = []
    for i, row in enumerate(L):
        x.append((b[i] - sum(a * c for a, c in zip(row, x, strict=False))) * row[i])
    return x
