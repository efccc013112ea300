"""Lengths of joint-space edges in the coupling metrics, compiled: what searches evaluate.

A metric is a matrix of the configuration (`coupling.py`): raw Q, Q_T for a duration, or the
disturbance map of a free base. An edge is straight; its length is the integral of
sqrt(dq^T Q dq) along it by Gauss's rule, one node per lane, so one compiled call an edge.
"""

from __future__ import annotations

import math
from functools import cached_property, lru_cache, partial
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from scipy.stats import qmc

from ves_gym._util.params import Array, ParameterError
from ves_gym._util.suggest import did_you_mean
from ves_gym.engine.kernel.blocks import aligned
from ves_gym.engine.kernel.build import Library, cached
from ves_gym.engine.kernel.emit import LANES, emit_map
from ves_gym.engine.kernel.maps import evaluate
from ves_gym.engine.kernel.trace import inertia_matrix, parameters, structure
from ves_gym.system.system import System

if TYPE_CHECKING:
    import casadi

METRICS = ("q", "qt", "disturbance")
LEAST = 1e-2  # of the mean coupling: keeps null directions from being free
_SWEEPS = 6  # of Jacobi's method on 6x6: quadratic, converged to rounding after five
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(LANES)
_NODES, _WEIGHTS = (_NODES + 1) / 2, _WEIGHTS / 2
_SAMPLES = 256  # configurations the mean coupling is taken over


class Metric:
    """dq^T (Q(q) + least 1) dq with Q by `kind`; least is LEAST of the mean of Q's diagonal.

    Kinds: "q" raw Q, "qt" band-limited to a duration [J/rad^2], "disturbance" the rotation
    of a free base per joint motion, squared. Where the vehicle has no stiffness Q is zero,
    and "q" and "qt" stand for the base's kinetic energy, H_bm^T M_t^-1 H_bm [kg m^2].
    """

    def __init__(self, system: System, kind: str, duration: float | None = None) -> None:
        if kind not in METRICS:
            raise ParameterError(
                f"metric must be one of {', '.join(METRICS)}, got {kind!r}"
                f"{did_you_mean(kind, METRICS)}"
            )
        if kind == "qt" and not (duration is not None and 0 < duration < np.inf):
            raise ParameterError(f"metric qt needs a duration > 0 s, got {duration!r}")
        self.kind, self.system, self.n = kind, system.ideal(), system.arm.n
        self.duration = duration
        base = self.system.base
        if kind != "disturbance" and not base.K.any():
            kind = "kinetic"
        self._graph = partial(_form, self.system, kind)
        self._key = f"metric {kind} {_SWEEPS} {structure(self.system)}"
        # internal modes follow the interface here: what guides a search need not swing
        condensed = base.condensed()
        fixed = (condensed[0].ravel(), condensed[2].ravel())
        robot = parameters(self.system)[1]
        self._p = np.concatenate([robot, *fixed, [duration or 0.0, 0.0]])
        self._p[-1] = self._least()
        self.floor = math.sqrt(self._p[-1])  # length that no step of 1 rad is below

    @property
    def least(self) -> float:
        """Number added to the diagonal [unit of `squares` per rad^2]."""
        return float(self._p[-1])

    def _least(self) -> float:
        """LEAST of the mean of the diagonal over the joint box."""
        arm = self.system.arm
        low, high = arm.column("q_min"), arm.column("q_max")
        at = qmc.scale(qmc.Halton(self.n, scramble=False).random(_SAMPLES), low, high)
        axes = np.eye(self.n)[:, None, :]
        return LEAST * float(
            np.mean(self.squares(at, np.broadcast_to(axes, (self.n, *at.shape))))
        )

    def squares(self, q: npt.ArrayLike, dq: npt.ArrayLike) -> Array:
        """dq^T (Q(q) + least 1) dq over leading axes.

        Args:
            q: (..., n) configurations [rad].
            dq: (..., n) joint steps [rad].

        Returns:
            (...) [J], of kind disturbance [rad^2], kinetic [kg m^2 rad^2].
        """
        at = np.concatenate(np.broadcast_arrays(q, dq), axis=-1).astype(float)
        return evaluate(self._key, self._graph, at, self._p, 1)[..., 0]

    def lengths(self, a: npt.ArrayLike, b: npt.ArrayLike) -> Array:
        """Lengths of straight edges.

        Args:
            a, b: (..., n) ends [rad].

        Returns:
            (...) roots of the unit of `squares`.
        """
        start, step = np.asarray(a, float), np.asarray(b, float) - np.asarray(a, float)
        at = start[..., None, :] + _NODES[:, None] * step[..., None, :]
        squares = self.squares(at, np.broadcast_to(step[..., None, :], at.shape))
        out: Array = np.sqrt(np.maximum(squares, 0.0)) @ _WEIGHTS
        return out

    def length(self, path: npt.ArrayLike) -> float:
        """Length of a polyline (N, n)."""
        points = np.asarray(path, float)
        return float(self.lengths(points[:-1], points[1:]).sum())

    @cached_property
    def edge(self) -> Edge:
        """Lengths one at a time, without the overhead of batches."""
        return Edge(self)


class Edge:
    """Length of one straight edge: a block of LANES quadrature nodes, one compiled call."""

    def __init__(self, metric: Metric) -> None:
        self.n, self._metric = metric.n, metric
        self._x = aligned(1, 2 * metric.n, LANES)
        self._y = aligned(1, 1, LANES)
        self._p = aligned(len(metric._p), LANES)
        self._p[:] = metric._p[:, None]
        self._run: Any = None
        try:
            library = _library(metric._key, metric._graph)
        except (ImportError, RuntimeError, OSError):
            return
        where = (k.ctypes.data for k in (self._x, self._p, self._y))
        self._run = partial(library.map, *where, 0, 1)

    def __call__(self, a: Array, b: Array) -> float:
        """(n,), (n,) -> length."""
        if self._run is None:
            return float(self._metric.lengths(a, b))
        step = b - a
        self._x[0, : self.n] = a[:, None] + step[:, None] * _NODES
        self._x[0, self.n :] = step[:, None]
        self._run()
        return float(np.sqrt(self._y[0, 0]) @ _WEIGHTS)


@lru_cache(maxsize=64)
def _library(key: str, graph: partial[casadi.Function]) -> Library:
    return cached(key, lambda: emit_map(graph()))


# ---------------------------------------------------------------------------- graphs


def _form(system: System, kind: str) -> casadi.Function:
    """((q, dq), (p, M, K, duration, least)) -> dq^T (Q + least 1) dq."""
    import casadi as ca

    from ves_gym.engine.kernel.mechanics import solve

    n, count = system.arm.n, len(parameters(system)[0])
    x, numbers = ca.SX.sym("x", 2 * n), ca.SX.sym("p", count + 74)
    step, p = x[n:], numbers[:count]
    M, K = (ca.reshape(numbers[count + i : count + i + 36], 6, 6) for i in (0, 36))
    H = ca.reshape(inertia_matrix(system)(x[:n], p), 6 + n, 6 + n)
    Mt, u = H[:6, :6] + M, ca.vertsplit(H[:6, 6:] @ step)  # mass, momentum of the step
    if kind == "qt":
        value = _band_limited(_rows(Mt), _rows(K), u, numbers[-2])
    else:
        moved = ca.vertcat(*solve(_rows(Mt), list(u)))  # of the base, per step
        value = {
            "q": lambda: ca.bilin(K, moved, moved),
            "kinetic": lambda: ca.dot(ca.vertcat(*u), moved),
            "disturbance": lambda: ca.sumsqr(moved[3:]),
        }[kind]()
    out = value + numbers[-1] * ca.sumsqr(step)
    return ca.Function("form", [x, numbers], [ca.cse(ca.densify(out))])


def _rows(matrix: casadi.SX) -> list[list[Any]]:
    return [[matrix[i, j] for j in range(6)] for i in range(6)]


def _band_limited(Mt: list[list[Any]], K: list[list[Any]], u: Any, duration: Any) -> Any:
    """sum_i omega_i^2 S(omega_i T)^2 (phi_i^T u)^2 over the modes of (K, M_t)."""
    L = _cholesky(Mt)
    half = [_forward(L, [row[j] for row in K]) for j in range(6)]  # columns of L^-1 K
    C = [_forward(L, [half[j][i] for j in range(6)]) for i in range(6)]  # L^-1 K L^-T
    y = _forward(L, list(u))
    _diagonalise(C, y)
    return sum(_weight(C[i][i], duration) * y[i] * y[i] for i in range(6))


def _weight(square: Any, duration: Any) -> Any:
    """omega^2 S(omega T)^2 with S of `modes.quintic_spectrum`, from omega^2."""
    import casadi as ca

    square = ca.fmax(square, 0.0)
    x = ca.sqrt(square) * duration / 2
    h = ca.fmax(x, 0.1)
    bessel = (3 / (h * h) - 1) * ca.sin(h) / h - 3 * ca.cos(h) / (h * h)  # j_2(h)
    series = 1 - x**2 / 14 + x**4 / 504 - x**6 / 33264
    shape = ca.if_else(x < 0.1, series, 15 * bessel / (h * h))
    return square * shape * shape


def _cholesky(A: list[list[Any]]) -> list[list[Any]]:
    import casadi as ca

    L: list[list[Any]] = [[0.0] * 6 for _ in range(6)]
    for i in range(6):
        for j in range(i + 1):
            remainder = A[i][j] - sum(L[i][k] * L[j][k] for k in range(j))
            L[i][j] = ca.sqrt(remainder) if i == j else remainder / L[j][j]
    return L


def _forward(L: list[list[Any]], b: list[Any]) -> list[Any]:
    """L^-1 b for a lower triangle."""
    out: list[Any] = []
    for i in range(6):
        out.append((b[i] - sum(L[i][k] * out[k] for k in range(i))) / L[i][i])
    return out


def _diagonalise(C: list[list[Any]], y: list[Any]) -> None:
    """Jacobi's method in place: C becomes V^T C V (diagonal), y becomes V^T y.

    A fixed number of rotations, so that there is nothing to decide in compiled code.
    """
    import casadi as ca

    for _ in range(_SWEEPS):
        for p in range(5):
            for q in range(p + 1, 6):
                off = C[p][q]
                # the smaller of two angles; where there is nothing to do, t is 0
                gap, twice = C[q][q] - C[p][p], 2 * off
                size = ca.fabs(gap) + ca.sqrt(gap * gap + twice * twice)
                t = ca.if_else(
                    size > 0, ca.if_else(gap < 0, -1, 1) * twice / (size + 1e-300), 0
                )
                c = 1 / ca.sqrt(t * t + 1)
                s = t * c
                C[p][p], C[q][q] = C[p][p] - t * off, C[q][q] + t * off
                C[p][q] = C[q][p] = 0.0
                for k in range(6):
                    if k in (p, q):
                        continue
                    a, b = C[p][k], C[q][k]
                    C[p][k] = C[k][p] = c * a - s * b
                    C[q][k] = C[k][q] = s * a + c * b
                y[p], y[q] = c * y[p] - s * y[q], s * y[p] + c * y[q]
