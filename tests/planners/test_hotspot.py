"""The hot-spot method and its opposite: what the coupling map promises and warns of."""

import time

import numpy as np
import pytest

from tests.core.arms import PLANAR_GAINS, WRIST_GAINS, planar_arm, six_joint_arm
from ves_gym.core.motion import QUINTIC_PEAK_SPEED
from ves_gym.core.params import ParameterError
from ves_gym.core.system import System
from ves_gym.planners.coupling import coupling_length
from ves_gym.planners.query import Query, solve
from ves_gym.planners.registry import get_planner
from ves_gym.planners.suites import reach100

QUERIES = {q.name: q for _, q in reach100(System(), "bent", 1).queries}


@pytest.fixture(params=QUERIES)
def query(request):
    return QUERIES[request.param]


def sampled_length(query, motion, duration):
    path = motion.at(np.linspace(0, query.duration, 400)).q
    return coupling_length(query.system, path, duration)


@pytest.mark.parametrize("name", ["hotspot-q", "hotspot-qt"])
def test_its_path_is_no_longer_than_the_straight_one(name, query):
    """In its own metric; 1 % for the smoothing of the timed motion."""
    plan = solve(get_planner(name), query)
    info = plan.info
    assert info["coupling_length"] <= info["straight_coupling_length"] * (1 + 1e-9)
    assert 0 <= info["share"] <= 1
    assert info["from"] in ("straight", "lattice")
    duration = query.duration if name == "hotspot-qt" else None
    if info["share"] == 1.0:
        timed = sampled_length(query, plan.motion, duration)
        straight = sampled_length(query, query.straight, duration)
        assert timed <= 1.01 * straight
    assert plan.feasible


def test_it_goes_around_where_the_straight_line_is_long():
    """A long way through the map: the geodesic is shorter, and not straight."""
    query = Query(system=System(), start=(-1.0, -0.8, 1.5), goal=(1.2, 0.9, -1.4), duration=8.0)
    plan = solve(get_planner("hotspot-q"), query)
    assert plan.info["coupling_length"] < 0.95 * plan.info["straight_coupling_length"]
    t = np.linspace(0, 8, 101)
    line = query.straight.at(t).q
    path = plan.motion.at(t).q
    gap = np.linalg.norm(path[:, None] - line[None], axis=-1).min(axis=1).max()
    assert gap > 0.1


def test_paths_keep_the_joint_limits():
    arm = System().arm
    high = 0.98 * arm.column("q_max")
    query = Query(
        system=System(), start=tuple(high), goal=tuple(-high * [1, -1, 1]), duration=9.0
    )
    plan = solve(get_planner("hotspot-q"), query)
    assert plan.feasible
    q = plan.motion.at(np.linspace(0, 9, 1001)).q
    assert (np.abs(q) <= arm.column("q_max") * (1 + 1e-3)).all()  # between samples


def test_a_path_the_limits_forbid_is_drawn_towards_the_straight_line():
    """Speed limits that leave the straight line 3 % of room leave a detour less."""
    start, goal = np.array([-1.0, -0.8, 1.5]), np.array([1.2, 0.9, -1.4])
    peak = np.abs(goal - start) * QUINTIC_PEAK_SPEED / 8.0
    ends = {"system": System(), "start": tuple(start), "goal": tuple(goal), "duration": 8.0}
    loose = solve(get_planner("hotspot-q"), Query(**ends))
    bound = solve(get_planner("hotspot-q"), Query(**ends, v_max=tuple(1.03 * peak)))
    assert 0 < bound.info["share"] < 0.5 < loose.info["share"]
    assert bound.feasible


def test_the_bad_path_is_longer_than_the_straight_one(query):
    """One joint after the other, all monotone; its corners are rounded by the timing."""
    plan = solve(get_planner("bad-path"), query)
    straight = sampled_length(query, query.straight, None)
    assert plan.info["coupling_length"] >= straight
    assert sampled_length(query, plan.motion, None) >= straight


def test_the_bad_path_passes_the_corners_of_the_box(query):
    """One joint has moved at the first, two at the second; within 5 % of the ranges."""
    plan = solve(get_planner("bad-path"), query)
    q = plan.motion.at(np.linspace(0, query.duration, 2001)).q
    start, goal = query.ends
    progress = (q - start) / (goal - start)
    corners = [np.abs(progress - c).max(axis=1).min() for c in np.ndindex(2, 2, 2)]
    assert sum(miss < 0.05 for miss in corners) >= 4


@pytest.mark.parametrize("name", ["hotspot-q", "hotspot-qt"])
def test_too_many_joints_are_refused_before_the_lattice_is_built(name):
    query = Query(
        system=System(arm=six_joint_arm()),
        start=(0.0,) * 6,
        goal=(0.1,) * 6,
        duration=1.0,
        servo=WRIST_GAINS,
    )
    begin = time.perf_counter()
    with pytest.raises(ParameterError, match="puma560-wrist with 6 joints needs"):
        solve(get_planner(name), query)
    assert time.perf_counter() - begin < 1.0  # the lattice would fill gigabytes


def test_two_joints_are_fine():
    query = Query(
        system=System(arm=planar_arm()),
        start=(-1.0, 0.4),
        goal=(1.0, 1.2),
        duration=3.0,
        servo=PLANAR_GAINS,
    )
    for name in ("hotspot-q", "hotspot-qt", "bad-path"):
        assert solve(get_planner(name), query).motion.n == 2
