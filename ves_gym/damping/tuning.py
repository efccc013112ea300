"""PPED gain tuning: the gains that leave least energy in the base (thesis 4.3)."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from operator import itemgetter
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy.linalg
import scipy.optimize

from ves_gym._util.params import Array, ParameterError, Vector, finite, require_one_of, unit
from ves_gym.damping.plant import (
    THESIS_DISPLACEMENT,
    GainMatrices,
    LinearPlant,
    Lyapunov,
    require_decay,
    worst_displacement,
)

Objective = Callable[[Array], tuple[float, Array]]  # closed A -> value to minimise, d / dA

OBJECTIVES = {
    "strain": "time integral of strain energy after one displacement [J s]",
    "worst": "the same per joule of initial strain energy, worst displacement [s]",
    "estimator": "damping estimator, thesis eq. 4.4 [1], the larger the better",
}
_SCREENING = 30  # iterations given to every start; the best _FINALISTS go on to the end
_FINALISTS = 6
# long memory for long valleys; ftol of a logarithm: 4e-7 of the integral per step
_SEARCH = {"maxcor": 30, "ftol": 1e-7}


@dataclass(frozen=True, kw_only=True)
class Bounds:
    """Least and largest gain; of full matrices, least and largest eigenvalue."""

    K: Vector = unit("N m/rad", default=(1.0, 1e4))
    B: Vector = unit("N m s/rad", default=(0.1, 1e3))

    def __post_init__(self) -> None:
        for name in ("K", "B"):
            low, high = finite(getattr(self, name), (2,), f"Bounds.{name}")
            if not 0 < low < high:
                raise ParameterError(
                    f"Bounds.{name} must be 0 < least < largest, got {low:g} and {high:g}"
                )


WIDE = Bounds()


def objective_of(
    plant: LinearPlant, name: str, y: npt.ArrayLike = THESIS_DISPLACEMENT
) -> Objective:
    """One of `OBJECTIVES` as a function to minimise, of the closed A, with its gradient.

    strain and worst are in logarithms (they differ by decades), the estimator negative;
    y (6,) is the initial displacement of "strain" [m, rad].

    Raises:
        ParameterError: an unknown name.
    """
    require_one_of("objective", name, OBJECTIVES)
    if name == "estimator":
        return _estimator_objective
    return _integral_objective(plant, plant.start(y) if name == "strain" else None)


def _integral_objective(plant: LinearPlant, x: Array | None) -> Objective:
    """Logarithm of the strain integral after a start x (2 w,); None: from the worst one."""
    S = plant.strain

    def value(A: Array) -> tuple[float, Array]:
        equation = Lyapunov(A)
        P = equation.cost(S)
        if x is not None:
            X0 = np.outer(x, x)
            J = float(np.sum(P * X0))
        else:
            J, y = worst_displacement(plant, P)
            start = plant.start(y)  # the eigenvector: J moves as its own cost does
            X0 = np.outer(start, start)
        return math.log(J), 2 / J * P @ equation.spread(X0)

    return value


def _estimator_objective(A: Array) -> tuple[float, Array]:
    poles, shapes = np.linalg.eig(A)
    omega = np.abs(poles)
    zeta, total = -poles.real / omega, omega.sum()
    by_zeta = 1 - omega / total
    by_omega = -zeta / total + np.sum(zeta * omega) / total**2 + by_zeta * poles.real / omega**2
    # d omega = Re(conj(p) dp) / omega, d zeta = -Re(dp) / omega + zeta's share of omega
    weight = -by_zeta / omega + by_omega * poles.conj() / omega
    # dp_i = (left_i dA right_i), left = shapes^-1
    slope = np.real((shapes * weight) @ np.linalg.inv(shapes)).T
    return -float(np.sum(zeta * by_zeta)), -slope


class _Inside:
    """Symmetric matrices with eigenvalues inside bounds, from free parameters u.

    gain = f(T), T symmetric (or diagonal) with entries u, f(t) = exp(middle + half sin t):
    smooth, positive, never out of bounds, and no dead end at a bound.
    """

    def __init__(self, n: int, bounds: Vector, full: bool) -> None:
        low, high = math.log(bounds[0]), math.log(bounds[1])
        self.n, self.middle, self.half = n, (low + high) / 2, (high - low) / 2
        self.at = np.triu_indices(n) if full else (np.arange(n), np.arange(n))
        self.size = len(self.at[0])
        self.twice = np.where(self.at[0] == self.at[1], 1.0, 2.0)

    def gain(self, u: Array) -> tuple[Array, Callable[[Array], Array]]:
        """The matrix, and what turns a gradient by its entries into one by u."""
        T = np.zeros((self.n, self.n))
        T[self.at] = u
        T[self.at[::-1]] = u
        t, V = np.linalg.eigh(T)
        f = np.exp(self.middle + self.half * np.sin(t))
        slope = f * self.half * np.cos(t)

        def by_u(G: Array) -> Array:
            # Daleckii and Krein: the derivative of a matrix function by divided differences
            gap = t[:, None] - t
            near = np.abs(gap) < 1e-6
            ratio = (f[:, None] - f) / np.where(near, 1.0, gap)
            ratio = np.where(near, (slope[:, None] + slope) / 2, ratio)
            inner = V.T @ ((G + G.T) / 2) @ V
            return np.asarray((V @ (ratio * inner) @ V.T)[self.at] * self.twice)

        return (V * f) @ V.T, by_u

    def parameters(self, gain: Array) -> Array:
        """u of a matrix, the nearest one if it is out of bounds."""
        values, V = np.linalg.eigh(gain)
        inside = (np.log(np.maximum(values, 1e-300)) - self.middle) / self.half
        t = np.arcsin(np.clip(inside, -1 + 1e-6, 1 - 1e-6))
        T: Array = (V * t) @ V.T
        return T[self.at]


class Tuned(NamedTuple):
    """Gains found by a search."""

    gains: GainMatrices
    objective: str
    value: float  # of the objective, in its unit (`OBJECTIVES`)
    evaluations: int
    seconds: float


def tune(
    plant: LinearPlant,
    objective: str = "strain",
    *,
    y: npt.ArrayLike = THESIS_DISPLACEMENT,
    full: bool = False,
    bounds: Bounds = WIDE,
    starts: int = 24,
    seed: int = 0,
    first: GainMatrices | None = None,
) -> Tuned:
    """Find the gains that are best by an objective: quasi-Newton search from several starts.

    Args:
        plant: the linear model.
        objective: one of `OBJECTIVES`.
        y: (6,) initial displacement of "strain" [m, rad].
        full: symmetric positive definite matrices instead of diagonal ones.
        bounds: of the gains [N m/rad, N m s/rad].
        starts: random starts; full matrices also start from the best diagonal ones.
        seed: of the random starts; the same seed finds the same gains.
        first: gains to start from as well.

    Raises:
        ParameterError: an unknown objective, or a base that no gains bring to rest.
    """
    began = time.perf_counter()
    goal = objective_of(plant, objective, y)
    boxes = [_Inside(plant.n, b, full) for b in (bounds.K, bounds.B)]
    split = boxes[0].size
    w = plant.port.shape[1]
    evaluations = 0

    def gains_of(u: Array) -> GainMatrices:
        return GainMatrices(boxes[0].gain(u[:split])[0], boxes[1].gain(u[split:])[0])

    def value(u: Array) -> tuple[float, Array]:
        nonlocal evaluations
        evaluations += 1
        K, by_K = boxes[0].gain(u[:split])
        B, by_B = boxes[1].gain(u[split:])
        measure, slope = goal(plant.closed(GainMatrices(K, B)))
        inner = -plant.drive.T @ slope  # A falls by drive [K port, B port]
        by_gains = inner[:, :w] @ plant.port.T, inner[:, w:] @ plant.port.T
        return measure, np.r_[by_K(by_gains[0]), by_B(by_gains[1])]

    require_decay(plant, gains_of(np.zeros(2 * split)))
    rng = np.random.default_rng(seed)
    points = list(rng.uniform(-1.2, 1.2, (starts, 2 * split)))
    seeds = [] if first is None else [first]
    if full:
        diagonal = tune(plant, objective, y=y, bounds=bounds, starts=starts, seed=seed)
        seeds.append(diagonal.gains)
        evaluations += diagonal.evaluations
    points += [np.r_[boxes[0].parameters(g.K), boxes[1].parameters(g.B)] for g in seeds]
    best = _minimise(value, points)
    if objective == "estimator":  # where two poles meet it has a kink, and gradients stop
        result = scipy.optimize.minimize(
            lambda u: value(u)[0], best[1], method="Nelder-Mead", options={"maxfev": 1000}
        )
        best = min(best, (float(result.fun), result.x), key=itemgetter(0))
    gains = gains_of(best[1])
    return Tuned(
        gains=gains,
        objective=objective,
        value=-best[0] if objective == "estimator" else math.exp(best[0]),
        evaluations=evaluations,
        seconds=time.perf_counter() - began,
    )


def _minimise(
    value: Callable[[Array], tuple[float, Array]], points: list[Array]
) -> tuple[float, Array]:
    """Least value and where: every point for a few steps, the best of them to the end."""

    def search(u: Array, steps: int) -> tuple[float, Array]:
        result = scipy.optimize.minimize(
            value, u, jac=True, method="L-BFGS-B", options={**_SEARCH, "maxiter": steps}
        )
        return float(result.fun), result.x

    tried = sorted((search(u, _SCREENING) for u in points), key=itemgetter(0))
    return min((search(u, 1000) for _, u in tried[:_FINALISTS]), key=itemgetter(0))
