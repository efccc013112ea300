"""Sequential quadratic programming over motions: steps in a trust region, an exact penalty.

The exact derivative of the momentum and Gauss and Newton's second derivative J^T W J; the
subproblems go to an active-set method.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from ves_gym._util.params import Array
from ves_gym.planners.motion_problem import MotionProblem
from ves_gym.planners.query import answer_limits, check_motion

_ROUNDS = 4  # of looking for torque between samples
_LOADED = 3  # rounds of taking what the base asks of the joints from their limits
_NEARLY = 0.01  # of a limit: what breaks it by more is not looked at more closely
_FIRST = 0.3  # rad: how far control points may move in the first step
_LEAST_STEP = 1e-6  # rad
_NEAREST = 0.1  # of a limit: what is nearer to it a step minds from the start
_MISSED = 1e-8  # of a limit by which a step may break what it did not mind
_RIDGE = 1e-7  # of the mean curvature, on flat directions
_BARELY = 1e-4  # of a limit: less is nothing to tell optimisations apart by
_ACCEPTED = 1e-6  # of a limit by which an answer may break it; `_SHARE` is for that


@dataclass(frozen=True)
class Minimum:
    """The end of an optimisation."""

    x: Array
    energy: float  # J
    excess: float  # by how much of a limit x breaks it; <= 0 if none
    iterations: int
    evaluations: int
    message: str

    def info(self) -> dict[str, Any]:
        """Statistics of the search as plain data."""
        return {k: getattr(self, k) for k in ("evaluations", "iterations", "message")}


def rank(minimum: Minimum) -> tuple[float, float]:
    """Sort key: motions that keep the limits first, by energy; then by what they break."""
    if minimum.excess <= _BARELY:
        return 0.0, minimum.energy
    return minimum.excess, minimum.energy


class _Point(NamedTuple):
    """A decision, its energy and limits, their derivatives."""

    x: Array
    energy: float
    u: Array
    slope: Array  # of u
    limits: Array
    rows: Array  # derivative of limits
    excess: float  # the largest of the limits


def minimise(
    problem: MotionProblem, x0: Array, iterations: int = 60, tolerance: float = 1e-4
) -> Minimum:
    """Find the least E_mean from x0 by steps in a trust region that an exact penalty judges.

    Args:
        problem: the query's motions and their limits.
        x0: (free n,) start [rad]; it may break limits.
        iterations: at most, in each round.
        tolerance: relative decrease of E_mean below which a step is the last.
    """
    done = evaluations = 0
    for _ in range(_ROUNDS):
        minimum = _minimise(problem, x0, iterations, tolerance)
        x0 = minimum.x
        done, evaluations = done + minimum.iterations, evaluations + minimum.evaluations
        if minimum.excess > _NEARLY or not problem.add_torque_samples(x0):
            break
    return replace(minimum, iterations=done, evaluations=evaluations)


def against_base(problem: MotionProblem, minimum: Minimum) -> Minimum:
    """Minimise again while what the moving base asks of the joints breaks a limit."""
    query = problem.query
    for _ in range(_LOADED if query.is_loaded else 0):
        motion = problem.motion(minimum.x)
        if not check_motion(query, motion, answer_limits(query)).broken:
            break
        problem.load(motion)
        problem.add_torque_samples(minimum.x)
        repeated = minimise(problem, minimum.x)
        done = minimum.iterations + repeated.iterations
        evaluations = minimum.evaluations + repeated.evaluations
        minimum = replace(repeated, iterations=done, evaluations=evaluations)
    return minimum


def _minimise(problem: MotionProblem, x0: Array, iterations: int, tolerance: float) -> Minimum:
    low, high = problem.bounds

    def at(x: Array) -> _Point:
        u, slope = problem.momentum(x)
        limits, rows = problem.limits(x)
        excess = float(limits.max(initial=-1.0))
        return _Point(x, problem.energy.value(u), u, slope, limits, rows, excess)

    point = at(np.clip(x0, low, high))
    scale = max(point.energy, 1e-12)
    radius, price, done, evaluations = _FIRST, 10.0, 0, 1
    message = "iteration limit reached"
    while done < iterations:
        done += 1
        hessian = problem.energy.curvature(point.u, point.slope) / scale
        gradient = point.slope.T @ problem.energy.force(point.u) / scale
        step = None
        while radius > _LEAST_STEP:
            box = np.maximum(low - point.x, -radius), np.minimum(high - point.x, radius)
            step, slack, price = _subproblem(hessian, gradient, point, *box, price)
            trial = at(point.x + step)
            evaluations += 1
            model = -(gradient @ step + 0.5 * step @ hessian @ step)
            model += price * (max(point.excess, 0.0) - slack)
            actual = (point.energy - trial.energy) / scale
            actual += price * (max(point.excess, 0.0) - max(trial.excess, 0.0))
            if actual >= 0.1 * model:
                break
            radius = min(radius, float(np.abs(step).max())) / 3
            step = None
            if model <= tolerance * point.energy / scale and point.excess <= _ACCEPTED:
                break
        if step is None:
            message = "no better step"
            break
        if actual > 0.7 * model and np.abs(step).max() > 0.9 * radius:
            radius *= 2.5
        merit = trial.energy / scale + price * max(trial.excess, 0.0)
        point = trial
        if abs(actual) <= tolerance * merit:
            message = "converged" if point.excess <= _ACCEPTED else "limits cannot be satisfied"
            break
    return Minimum(point.x, point.energy, point.excess, done, evaluations, message)


def _subproblem(
    hessian: Array, gradient: Array, point: _Point, low: Array, high: Array, price: float
) -> tuple[Array, float, float]:
    """Least quadratic model within bounds, limits linear, their largest excess priced.

    Returns the step, the excess it leaves, and the price, raised if it was too low to matter.
    """
    size = len(gradient)
    ridge = _RIDGE * np.trace(hessian) / size + 1e-12
    H = np.zeros((size + 1, size + 1))
    H[:size, :size] = hessian + ridge * np.eye(size)
    H[size, size] = price
    low, high = np.r_[low, 0.0], np.r_[high, max(point.excess, 0.0) + 10.0]
    working = point.limits > -_NEAREST
    while True:  # few of the rows matter: those that the step breaks are added
        A = np.hstack([point.rows[working], np.full((int(working.sum()), 1), -1.0)])
        solution, multipliers = quadratic_program(
            H, np.r_[gradient, price], A, -point.limits[working], low, high
        )
        step, slack = solution[:size], float(solution[size])
        missed = (point.limits + point.rows @ step > slack + _MISSED) & ~working
        if not missed.any():
            break
        working |= missed
    return step, slack, max(price, 2.0 * float(np.abs(multipliers).sum()))


def quadratic_program(
    H: Array, g: Array, A: Array, upper: Array, low: Array, high: Array
) -> tuple[Array, Array]:
    """Minimise 1/2 x^T H x + g^T x with A x <= upper, low <= x <= high, H positive definite.

    An active-set method from CasADi's distribution (DAQP, or qpOASES in one without it).
    Returns x (k,) and the multipliers of the rows of A (r,), zero where it gives up: what it
    leaves there then differs from run to run.
    """
    size = float(np.abs(H[:-1, :-1]).max())  # the last variable is a slack
    solver = _solver(len(g), len(A))
    result = solver(h=H / size, g=g / size, a=A, lba=-math.inf, uba=upper, lbx=low, ubx=high)
    x = np.clip(np.nan_to_num(np.array(result["x"]).ravel()), low, high)
    solved = solver.stats()["success"]
    return x, size * np.array(result["lam_a"]).ravel() if solved else np.zeros(len(A))


@lru_cache(maxsize=256)
def _solver(size: int, rows: int) -> Any:
    import casadi as ca

    name = next(k for k in ("daqp", "qpoases") if ca.has_conic(k))
    shape = {"h": ca.Sparsity.dense(size, size), "a": ca.Sparsity.dense(rows, size)}
    # rows reach 2000 per rad; DAQP's own tolerance of 1e-6 is after scaling them to 1. With so
    # small a one its count of 10 iterations without progress is no sign yet that it cycles.
    options: dict[str, Any] = {
        "daqp": {"daqp": {"primal_tol": 1e-10, "cycle_tol": 1000}},
        "qpoases": {"printLevel": "none"},
    }
    return ca.conic("qp", name, shape, {"error_on_fail": False, **options[name]})
