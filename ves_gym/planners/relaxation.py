"""Local relaxation of a path: from a search's answer down to the minimum it lies near.

A search by samples comes close to the best path slowly, for corners and detours shrink only as
samples fall beside them. From its answer on, descent along exact derivatives is quicker.
`shorten` takes coupling length down by L-BFGS-B; `settle` takes predicted E_mean down by the
sequential programming of `direct`, way and timing at once, inside the query's limits. Both keep
clear of obstacles by sampled distances; whoever calls checks the answer more finely.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.optimize

from ves_gym._util.params import Array
from ves_gym.mechanics.motion import Motion
from ves_gym.planners.direct import MotionProblem
from ves_gym.planners.hotspot import resample
from ves_gym.planners.metric import Metric
from ves_gym.planners.obstacles import RESOLUTION, Collisions
from ves_gym.planners.query import Query
from ves_gym.planners.sequential import minimise, rank

SLOPE = (
    3  # evaluations that an edge with its derivatives stands for: 1.4 (Q) to 2.6 (Q_T) times
)
INSTANTS = 8  # of a motion that stand for one evaluation, an edge's nodes
_LEVELS = (8, 16)  # edges, coarse first: long waves of a path settle on few
_ENOUGH = 1e-6  # relative decrease that ends a descent
_ROOM = 0.005  # m kept beyond the clearance, for what happens between samples
_NEAR = 0.05  # m: shapes further apart than this and the clearance are not looked at
_PRICE = 30.0  # of lacking distance, in units of the path energy per 0.1 m squared
_BENDS = (0.3, 0.7)  # rad, by turns: sizes of random bends
_LOOK = 12  # iterations after which starts are compared
_MOST = 60  # iterations that end an optimisation
_COARSE, _FINE = 1e-3, 1e-5  # relative decrease of E_mean that ends one
POINTS = 49  # way-points that stand for a motion


class Relaxed(NamedTuple):
    """A relaxed path and its effort."""

    path: Array  # (k, n) way-points [rad]
    evaluations: int  # in those of edges
    checks: int  # configurations whose distance from obstacles was asked
    motion: Motion | None = None  # where its timing was relaxed as well


def shorten(
    metric: Metric, path: Array, budget: int, checker: Collisions | None = None
) -> Relaxed:
    """Descend to a path of locally least length.

    Minimises k sum l_e^2 over the inner points of k edges: its minimum is the shortest path,
    its points evenly spaced in the metric. An edge with its derivatives counts as `SLOPE`.

    Args:
        metric: of the lengths l_e.
        path: (k, n) way-points to start from [rad].
        budget: evaluations allowed.
        checker: of the distance from obstacles, None for none.

    Returns:
        The path; the straight edges between its points are what was measured.
    """
    spent = checks = 0
    for level, edges in enumerate(_LEVELS):
        remaining = (budget - spent) // (len(_LEVELS) - level)
        calls = remaining // (SLOPE * edges)
        if calls < 2:
            break
        descent = _Descent(metric, resample(path, edges + 1), checker)
        path = descent.run(calls)
        spent += SLOPE * edges * descent.calls
        checks += descent.checks
    return Relaxed(path, spent, checks)


class _Descent:
    """L-BFGS-B on the inner points of a path."""

    def __init__(self, metric: Metric, path: Array, checker: Collisions | None) -> None:
        self.metric, self.path, self.checker = metric, path, checker
        self.edges, self.n = len(path) - 1, path.shape[1]
        self.calls = self.checks = 0
        self.scale = 1.0
        self.scale = max(self.value(path[1:-1].ravel(), with_distance=False)[0], 1e-12)

    def run(self, calls: int) -> Array:
        arm = self.metric.system.arm
        low, high = (np.tile(arm.column(k), self.edges - 1) for k in ("q_min", "q_max"))
        self.calls = 0
        result = scipy.optimize.minimize(
            self.value, self.path[1:-1].ravel(), jac=True, method="L-BFGS-B",
            bounds=scipy.optimize.Bounds(low, high),
            options={"maxfun": max(calls - 5, 1), "maxiter": calls, "ftol": _ENOUGH},
        )  # fmt: skip
        return self._points(result.x)

    def _points(self, x: Array) -> Array:
        return np.vstack([self.path[0], x.reshape(-1, self.n), self.path[-1]])

    def value(self, x: Array, with_distance: bool = True) -> tuple[float, Array]:
        """Path energy and lack of distance over the scale, and their gradient."""
        self.calls += 1
        points = self._points(x)
        length, slope = self.metric.slopes(points[:-1], points[1:])
        weight = 2 * self.edges * length[:, None] / self.scale
        gradient = np.zeros_like(points)
        gradient[:-1] += weight * slope[:, 0]
        gradient[1:] += weight * slope[:, 1]
        value = self.edges * float(length @ length) / self.scale
        if with_distance and self.checker is not None:
            lack, by = self._lack(points, self.checker)
            value, gradient = value + lack, gradient + by
        return value, gradient[1:-1].ravel()

    def _lack(self, points: Array, checker: Collisions) -> tuple[float, Array]:
        """Penalty on distances below the clearance, and its gradient by the points."""
        total, gradient = 0.0, np.zeros_like(points)
        least = checker.clearance + _ROOM
        gaps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        for i, gap in enumerate(gaps):
            count = 1 + int(gap / RESOLUTION)
            for share in (np.arange(count) + 1) / (count + 1):
                q = (1 - share) * points[i] + share * points[i + 1]
                near = checker.proximity(q, least + _NEAR)
                self.checks += 1
                lack = 10 * np.maximum(least - near.distance, 0.0)
                total += _PRICE * float(lack @ lack) / count
                pull = -20 * _PRICE / count * (lack @ near.slope)
                gradient[i] += (1 - share) * pull
                gradient[i + 1] += share * pull
        return total, gradient


# ------------------------------------------------------------------ a motion in time


def bends(query: Query, count: int, seed: int) -> list[Array]:
    """Straight lines with random half and full sine waves on every joint.

    Args:
        query: the ends; bends stay inside the joint limits.
        count: how many.
        seed: of the waves.

    Returns:
        `count` paths (k, n) [rad].
    """
    rng = np.random.default_rng(seed)
    (start, goal), arm = query.ends, query.system.arm
    u = np.linspace(0, 1, POINTS)[:, None]
    waves = np.hstack([np.sin(np.pi * u), 0.5 * np.sin(2 * np.pi * u)])
    straight, low, high = start + u * (goal - start), arm.column("q_min"), arm.column("q_max")
    sizes = (_BENDS[k % len(_BENDS)] * rng.normal(size=(2, arm.n)) for k in range(count))
    return [
        np.vstack([start, np.clip(straight + waves @ size, low, high)[1:-1], goal])
        for size in sizes
    ]


def settle(problem: MotionProblem, starts: Sequence[Motion], budget: int) -> list[Relaxed]:
    """Descend to motions of locally least predicted E_mean, inside the query's limits.

    All starts are looked at briefly; what is left of the budget goes to the best of them.

    Args:
        problem: the query's motions.
        starts: motions; they may break limits.
        budget: evaluations allowed; a motion's energy with its derivatives counts as `SLOPE`
            of them per `INSTANTS` instants.

    Returns:
        A motion from every start that the budget reaches, best first as far as was looked.
    """
    price = SLOPE * -(-len(problem.energy.t) // INSTANTS)
    remaining = budget // price
    trials = []
    for start in starts:
        if remaining < 2:
            break
        trial = minimise(problem, problem.of(start), min(_LOOK, remaining), _COARSE)
        remaining -= trial.evaluations
        trials.append(trial)
    out = []
    for trial in sorted(trials, key=rank):
        spent, minimum = trial.evaluations, trial
        if remaining >= 2:
            minimum = minimise(problem, trial.x, min(_MOST, remaining), _FINE)
            remaining -= minimum.evaluations
            spent += minimum.evaluations
        motion = problem.motion(minimum.x)
        path = motion.at(np.linspace(0, motion.duration, POINTS)).q
        path[[0, -1]] = problem.query.ends  # not to rounding only
        out.append(Relaxed(path, price * spent, 0, motion))
    return out
