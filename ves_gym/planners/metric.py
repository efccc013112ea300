"""Lengths of joint-space edges in the coupling metrics, compiled: what searches evaluate.

A metric is a matrix of the configuration (`coupling.py`): raw Q, or Q_T for a duration. An
edge is straight; its length is the integral of sqrt(dq^T Q dq) along it by Gauss's rule, one
node per lane, so one compiled call an edge.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from scipy.stats import qmc

from ves_gym._util.params import Array
from ves_gym.engine.kernel.build import LANES
from ves_gym.engine.kernel.compiled_function import CompiledFunction, aligned, everywhere
from ves_gym.engine.kernel.numbers import parameters, structure
from ves_gym.engine.kernel.symbolic import column, symbols, traced
from ves_gym.engine.kernel.trace import inertia_matrix
from ves_gym.mechanics.modes import jacobi_sweep, reduced
from ves_gym.mechanics.spatial import solve_symmetric
from ves_gym.system.system import System

if TYPE_CHECKING:
    import casadi

LEAST = 1e-2  # of the mean coupling: keeps null directions from being free
_SWEEPS = 6  # of Jacobi's method on 6x6: quadratic, converged to rounding after five
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(LANES)
_NODES, _WEIGHTS = (_NODES + 1) / 2, _WEIGHTS / 2
_SAMPLES = 256  # configurations the mean coupling is taken over


class Metric:
    """dq^T (Q(q) + least 1) dq [J/rad^2]; least is LEAST of the mean of Q's diagonal.

    Q is raw Q, or with a duration [s] Q_T. Where the vehicle has no stiffness Q is zero, and
    the base's kinetic energy, H_bm^T M_t^-1 H_bm [kg m^2], stands for both.
    """

    def __init__(self, system: System, duration: float | None) -> None:
        self.system, self.n = system.ideal(), system.arm.n
        base = self.system.base
        kind = "q" if duration is None else "qt"
        if not base.K.any():
            kind = "kinetic"
        key = f"metric {kind} {structure(self.system)}"
        self._form = CompiledFunction(key, partial(_form, self.system, kind))
        # internal modes follow the interface here: what guides a search need not swing
        condensed = base.condensed()
        fixed = (condensed[0].ravel(), condensed[2].ravel())
        robot = parameters(self.system)[1]
        self._p = np.concatenate([robot, *fixed, [duration or 0.0, 0.0]])
        arm, halton = system.arm, qmc.Halton(self.n, scramble=False).random(_SAMPLES)
        at = qmc.scale(halton, arm.column("q_min"), arm.column("q_max"))
        diagonal = self.squares(at, np.eye(self.n)[:, None, :])
        self.least = LEAST * float(np.mean(diagonal))  # added to the diagonal
        self._p[-1] = self.least
        self.floor = math.sqrt(self.least)  # length that no step of 1 rad is below

    def squares(self, q: npt.ArrayLike, dq: npt.ArrayLike) -> Array:
        """dq^T (Q(q) + least 1) dq over leading axes of q and dq (..., n) [rad]."""
        at = np.concatenate(np.broadcast_arrays(q, dq), axis=-1).astype(float)
        return self._form(at, self._p)[..., 0]

    def lengths(self, a: npt.ArrayLike, b: npt.ArrayLike) -> Array:
        """Lengths (...) of straight edges from a to b (..., n); roots of `squares`'s unit."""
        start, step = np.asarray(a, float), np.asarray(b, float) - np.asarray(a, float)
        at = start[..., None, :] + _NODES[:, None] * step[..., None, :]
        squares = self.squares(at, step[..., None, :])
        return np.asarray(np.sqrt(np.maximum(squares, 0.0)) @ _WEIGHTS)

    def edge(self, a: Array, b: Array) -> float:
        """Length of one straight edge (n,) to (n,): a block of LANES nodes, one call."""
        x, y, run = self._block
        step = b - a
        x[0, : self.n] = a[:, None] + step[:, None] * _NODES
        x[0, self.n :] = step[:, None]
        run(0, 1)
        return float(np.sqrt(y[0, 0]) @ _WEIGHTS)

    @cached_property
    def _block(self) -> tuple[Array, Array, Callable[[int, int], object]]:
        x, y = aligned(1, 2 * self.n, LANES), aligned(1, 1, LANES)
        return x, y, self._form.piece(x, everywhere(self._p), y)


# ---------------------------------------------------------------------------- graphs


def _form(system: System, kind: str) -> casadi.Function:
    """((q, dq), (p, M, K, duration, least)) -> dq^T (Q + least 1) dq."""
    import casadi as ca

    n, size, count = system.arm.n, 6 + system.arm.n, len(parameters(system)[0])
    x, p = symbols("x", (2, n)), symbols("p", (count + 74,))
    (q, step), (M, K) = x, p[count:-2].reshape(2, 6, 6)
    entries = inertia_matrix(system)(column(q), column(p[:count]))
    H = traced(ca.vertsplit(entries), (size, size))
    Mt, u = H[:6, :6] + M, H[:6, 6:] @ step  # mass, momentum of the step
    if kind == "qt":
        value = _band_limited(Mt, K, u, p[-2:-1])
    else:
        moved = solve_symmetric(Mt, u[:, None])[:, 0]  # of the base, per step
        value = moved @ (K @ moved) if kind == "q" else u @ moved
    out = value + p[-1:] * (step @ step)
    return ca.Function("form", [column(x), column(p)], [ca.cse(column(out))])


def _band_limited(Mt: Array, K: Array, u: Array, duration: Array) -> Array:
    """sum_i omega_i^2 S(omega_i T)^2 (phi_i^T u)^2 over the modes of (K, M_t), T in s."""
    C, y = reduced(K, Mt, u[..., None])
    for _ in range(_SWEEPS):
        C, y = jacobi_sweep(C, y)
    squares = C[..., range(6), range(6)]
    return (_weight(squares, duration) * y[..., 0] ** 2).sum(axis=-1)


def _weight(square: Array, duration: Array) -> Array:
    """omega^2 S(omega T)^2 with S of `modes.quintic_spectrum`, from omega^2."""
    square = np.maximum(square, 0.0)
    x = np.sqrt(square) * duration / 2
    h = np.maximum(x, 0.1)
    bessel = (3 / (h * h) - 1) * np.sin(h) / h - 3 * np.cos(h) / (h * h)  # j_2(h)
    series = 1 - x**2 / 14 + x**4 / 504 - x**6 / 33264
    shape = np.where(x < 0.1, series, 15 * bessel / (h * h))
    return square * shape * shape
