"""Refinement: any motion made to disturb the base less, its timing and its way at once.

The problem is that of `direct` with more control points and several starts: the straight
line and detours from it or, among obstacles, paths of a search. A start may break limits;
the answer keeps speed, acceleration and torque, and the clearance, checked again finely.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ves_gym._util.optional import require
from ves_gym._util.params import Array
from ves_gym.mechanics.motion import Motion
from ves_gym.planners.motion_problem import MotionProblem
from ves_gym.planners.ompl_search import Ompl
from ves_gym.planners.paths import time_path
from ves_gym.planners.query import (
    NoPlan,
    Query,
    first_violation,
    min_duration,
    require_possible,
)
from ves_gym.planners.sequential import Minimum, against_base, minimise, rank

FREE = 24  # control points: at 2 s, 12 leave 3 % more energy, 32 take 0.5 % off
_DETOURS = (0.3, 0.7)  # rad, by turns: sizes of the random detours started from
_TOO_MUCH = 0.5  # of a limit that a start may break it by
_FIRST_LOOK = 15  # iterations after which starts are compared
_COARSE, _FINE = 1e-3, 1e-5  # relative decrease of E_mean that ends an optimisation
# Times the duration: what takes more after a first look does not fit in the end; of some
# starts, of all.
_SURE, _LIKELY = 1.5, 1.1
_LARGE = 100  # variables: of larger problems starts are compared with half the control points


class Refined:
    """The best of several refined starts."""

    def __init__(self, free: int = FREE, starts: int = 5, name: str = "refined") -> None:
        self.free, self.starts, self.name = free, starts, name
        self.summary = (
            f"least predicted E_mean over smooth motions ({free} free points, {starts}"
            " starts), inside all limits, clear of obstacles"
        )

    def find(self, query: Query, seed: int) -> tuple[Motion, dict[str, Any]]:
        """Refine several starts; the seed chooses the detours, and the search among obstacles.

        Raises:
            NoPlan: no way was found, and the straight one could not be bent around.
        """
        require_possible(query)
        problem = MotionProblem(query, self.free)
        if query.surroundings is None or first_violation(query, query.straight) is None:
            compared = problem
            if problem.straight.size > _LARGE and self.free > 1:
                compared = MotionProblem(query, self.free // 2, problem.energy)
            starts = [compared.straight, *detours(compared, self.starts - 1, seed)]
            return _best(problem, starts, compared)
        require(f"planner {self.name} among obstacles", "ompl")
        starts, why = [problem.straight], None
        for objective in ("time", "qt"):
            try:
                result = Ompl(objective=objective).search(query, seed)
            except NoPlan as error:
                why = error
            else:
                assert result.path is not None
                starts.append(problem.of(time_path(query, result.path)[0]))
        motion, info = _best(problem, starts)
        if len(starts) == 1 and why is not None and first_violation(query, motion) is not None:
            raise why  # no way was found, and the straight one could not be bent around
        return motion, info


def detours(problem: MotionProblem, count: int, seed: int) -> list[Array]:
    """Straight lines with random half and full sine waves on every joint, (free n,) each."""
    rng = np.random.default_rng(seed)
    low, high = problem.bounds
    n = problem.n
    u = (np.arange(problem.straight.size // n) + 1) / (problem.straight.size // n + 1)
    waves = np.stack([np.sin(np.pi * u), 0.5 * np.sin(2 * np.pi * u)], axis=1)
    out = []
    for k in range(count):
        size = _DETOURS[k % len(_DETOURS)] * rng.normal(size=(2, n))
        step = (waves @ size).ravel()
        for _ in range(6):  # what the limits are far from allowing is no good start
            x = np.clip(problem.straight + step, low, high)
            if problem.limits(x)[0].max(initial=-1.0) < _TOO_MUCH:
                break
            step /= 2
        out.append(x)
    return out


def _best(
    problem: MotionProblem, starts: Sequence[Array], compared: MotionProblem | None = None
) -> tuple[Motion, dict[str, Any]]:
    """The least of the minima from several starts that stands up to a fine check.

    Where none does, the least of the starts that does; where none does either, the minimum
    that breaks least.

    Args:
        problem: of which the answer is a minimum.
        starts: decisions of `compared` (free n,) [rad].
        compared: the problem with fewer control points on which starts are compared.
    """
    first = problem if compared is None else compared
    looks = []
    for x in starts:
        looks.append(minimise(first, x, _FIRST_LOOK, _COARSE))
        _require_duration(first, looks, _SURE if len(looks) < len(starts) else _LIKELY)
    order = sorted(range(len(looks)), key=lambda i: rank(looks[i]))
    best: tuple[Motion, Minimum, int] | None = None
    stands = False
    for k in order[: max(1, sum(map(_is_feasible, looks)))]:
        x = looks[k].x if first is problem else problem.of(first.motion(looks[k].x))
        minimum = against_base(problem, minimise(problem, x, tolerance=_FINE))
        motion = problem.motion(minimum.x)
        stands = first_violation(problem.query, motion) is None
        if best is None or stands:
            best = motion, minimum, k
        if stands:
            break
    assert best is not None
    info: dict[str, Any] = {
        "starts": len(starts),
        "from": best[2],
        "energies": [m.energy for m in looks],
        **best[1].info(),
        "iterations": sum(m.iterations for m in (*looks, best[1])),
    }
    if stands:
        return best[0], info
    as_they_are = [first.motion(x) for x in starts]
    feasible = [m for m in as_they_are if first_violation(problem.query, m) is None]
    if not feasible:
        return best[0], info
    least = min(feasible, key=problem.energy.of)
    return least, info | {"message": f"not refined: {best[1].message}"}


def _require_duration(problem: MotionProblem, looks: Sequence[Minimum], share: float) -> None:
    """Raise NoPlan where motions found so far say that there is too little time for any.

    From rest on a base at rest, without obstacles; other queries pass. `share`: of the
    duration that the shortest motion found must take for that.
    """
    query = problem.query
    if query.is_moving or query.base is not None or query.surroundings is not None:
        return
    if any(map(_is_feasible, looks)):
        return
    motions = [query.straight, *(problem.motion(candidate.x) for candidate in looks)]
    shortest = min(min_duration(query, motion) for motion in motions)
    if shortest > share * query.duration:
        raise NoPlan(
            f"no motion: {query.duration:g} s are too short for speeds and torques of"
            f" {query.system.arm.name}, the shortest motion found that keeps its limits takes"
            f" {_up(shortest):.3g} s"
        )


def _up(seconds: float) -> float:
    """Three digits, rounded up."""
    digit = 10.0 ** (math.floor(math.log10(seconds)) - 2)
    return math.ceil(seconds / digit) * digit


def _is_feasible(minimum: Minimum) -> bool:
    return rank(minimum)[0] == 0.0
