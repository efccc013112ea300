"""Claim: no motion that is called a success touches anything; what is solvable is solved.

reach100 among its obstacles (`suites.REACH_OBSTACLES`): every successful motion is checked
by another geometry than the planners': distances of capsules from boxes and spheres by
hand, at sixteen times the planning resolution. Solvable is what any planner of the run
solved. An unsolvable query says why.
"""

import dataclasses

import numpy as np
import pytest

from tests.arms import capsules
from tests.reach import reach
from ves_gym.mechanics.spatial import rotation
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.planners.obstacles import RESOLUTION, Sphere
from ves_gym.planners.query import sample_path, solve
from ves_gym.planners.registry import get_planner
from ves_gym.planners.suites import REACH_OBSTACLES
from ves_gym.system.system import System

PLANNERS = ("ompl-time", "ompl-qt", "refined")
ARM = System(vehicle=BENT_THESIS).arm


def least_gap(path: np.ndarray) -> float:
    """Least distance [m] of the arm from the obstacles along configurations (N, n).

    Along each capsule's axis 25 points; the distance of a point from a box is exact.
    """
    gap = np.inf
    u = np.linspace(0, 1, 25)[:, None, None]
    for q in path:
        a, b, r = capsules(ARM, q)
        points = a + u * (b - a)  # (25, k, 3)
        for obstacle in REACH_OBSTACLES.obstacles:
            centre = np.array(obstacle.centre)
            if isinstance(obstacle, Sphere):
                distance = np.linalg.norm(points - centre, axis=-1) - obstacle.radius
            else:
                turn = rotation(np.array([0, 0, 0, *obstacle.angles]))
                local = np.abs((points - centre) @ turn) - np.array(obstacle.size) / 2
                distance = np.linalg.norm(np.maximum(local, 0), axis=-1)
            gap = min(gap, float((distance - r).min()))
    return gap


def answers(count: int, durations: tuple[float, ...]) -> list[dict]:
    """What each planner says to the first queries of some durations."""
    out = []
    for duration in durations:
        for query in reach(duration, count, obstacles="on"):
            plans = {name: solve(get_planner(name), query) for name in PLANNERS}
            out.append({"query": query, **plans})
    return out


@pytest.mark.slow
@pytest.mark.parametrize(("count", "durations"), [(5, (4.0,)), (20, (1.0, 2.0, 4.0))])
def test_no_motion_touches_anything(count, durations):
    found = answers(count, durations)
    solvable = [f for f in found if any(f[name].feasible for name in PLANNERS)]
    assert len(solvable) >= 0.7 * len(found)
    assert np.mean([f["refined"].feasible for f in solvable]) >= 0.95
    gaps = [
        least_gap(sample_path(f[name].motion, RESOLUTION / 16))
        for f in found
        for name in PLANNERS
        if f[name].feasible
    ]
    assert min(gaps) > 0.01  # of the 0.02 m kept at the resolution of the check
    for f in found:
        if f not in solvable:
            said = f["refined"].failure  # no motion, no path, or the limit that cannot be kept
            assert said.startswith("no ") or said.endswith(" of its limit")


def test_the_check_sees_a_collision():
    """A straight line through a crate."""
    (query,) = reach(4.0, 1, obstacles="on")
    plan = solve(get_planner("straight"), query)
    assert "obstacle" in plan.failure
    assert least_gap(sample_path(plan.motion, RESOLUTION)) < 0
    free = dataclasses.replace(query, surroundings=None)
    assert solve(get_planner("straight"), free).feasible
