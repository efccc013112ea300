"""The hot-spot method and its opposite: what the coupling map promises and warns of."""

import dataclasses
import itertools

import numpy as np
import pytest

from tests.arms import planar_arm, six_joint_arm
from ves_gym.mechanics.motion import QUINTIC_PEAK_SPEED
from ves_gym.mechanics.vehicle import BENT_THESIS, get_vehicle
from ves_gym.planners.coupling import coupling_length
from ves_gym.planners.hotspot import Roadmap, worst_order
from ves_gym.planners.query import Query, solve
from ves_gym.planners.registry import get_planner
from ves_gym.planners.suites import reach100
from ves_gym.system.system import System

BENT = System(vehicle=BENT_THESIS)

QUERIES = [q for _, q in reach100(BENT, "bent-thesis", 1, durations=(0.5, 4.0)).queries]


def sampled_length(query, motion, duration):
    path = motion.at(np.linspace(0, query.duration, 400)).q
    return coupling_length(query.system, path, duration)


@pytest.mark.parametrize(
    ("name", "which"),
    [
        ("hotspot-q", 0),
        ("hotspot-qt", 1),
        pytest.param("hotspot-q", 1, marks=pytest.mark.slow),
        pytest.param("hotspot-qt", 0, marks=pytest.mark.slow),
    ],
)
def test_its_path_is_no_longer_than_the_straight_one(name, which):
    """In its own metric; 1 % for the smoothing of the timed motion."""
    query = QUERIES[which]
    plan = solve(get_planner(name), query)
    info = plan.info
    assert info["coupling_length"] <= info["straight_coupling_length"] * (1 + 1e-9)
    assert 0 <= info["share"] <= 1
    assert info["from"] in ("straight", "roadmap")
    duration = query.duration if name == "hotspot-qt" else None
    if info["share"] == 1.0:
        timed = sampled_length(query, plan.motion, duration)
        straight = sampled_length(query, query.straight, duration)
        assert timed <= 1.01 * straight
    assert plan.feasible


def test_it_goes_around_where_the_straight_line_is_long():
    """A long way through the map: the geodesic is shorter, and not straight."""
    query = Query(system=BENT, start=(-1.0, -0.8, 1.5), goal=(1.2, 0.9, -1.4), duration=8.0)
    plan = solve(get_planner("hotspot-q"), query)
    assert plan.info["coupling_length"] < 0.95 * plan.info["straight_coupling_length"]
    t = np.linspace(0, 8, 101)
    straight = query.straight.at(t).q
    path = plan.motion.at(t).q
    gap = np.linalg.norm(path[:, None] - straight[None], axis=-1).min(axis=1).max()
    assert gap > 0.1


def test_a_path_the_limits_forbid_is_drawn_towards_the_straight_line():
    """Speed limits that leave the straight line 3 % of room leave a detour less."""
    start, goal = np.array([-1.0, -0.8, 1.5]), np.array([1.2, 0.9, -1.4])
    peak = np.abs(goal - start) * QUINTIC_PEAK_SPEED / 8.0
    ends = {"system": BENT, "start": tuple(start), "goal": tuple(goal), "duration": 8.0}
    loose = solve(get_planner("hotspot-q"), Query(**ends))
    bound = solve(get_planner("hotspot-q"), Query(**ends, v_max=tuple(1.03 * peak)))
    assert 0 < bound.info["share"] < 0.5 < loose.info["share"]
    assert bound.feasible


def test_the_bad_path_is_longer_than_the_straight_one():
    """One joint after the other, all monotone; its corners are rounded by the timing."""
    for query in QUERIES:
        plan = solve(get_planner("bad-path"), query)
        straight = sampled_length(query, query.straight, None)
        assert plan.info["coupling_length"] >= straight
        assert sampled_length(query, plan.motion, None) >= straight


def test_no_order_of_five_joints_is_longer_than_the_bad_paths():
    """All 120 orders, each path as a whole; the sixth joint does not move."""
    system = System(vehicle=BENT_THESIS, arm=six_joint_arm())
    start = np.array([-1.2, -0.8, 1.0, -0.8, 0.6, 0.3])
    goal = np.array([1.2, 0.9, -1.0, 0.8, -0.6, 0.3])

    def length(order):
        corners = [start.copy()]
        for j in order:
            corners.append(corners[-1].copy())
            corners[-1][j] = goal[j]
        legs = [np.linspace(a, b, 41)[:-1] for a, b in itertools.pairwise(corners)]
        return coupling_length(system, np.vstack([*legs, goal]), None)

    lengths = {order: length(order) for order in itertools.permutations(range(5))}
    worst = tuple(worst_order(system, start, goal))
    assert sorted(worst) == [0, 1, 2, 3, 4]
    assert lengths[worst] >= (1 - 1e-3) * max(lengths.values())
    assert max(lengths.values()) > 1.05 * min(lengths.values())


def test_too_many_joints_for_a_bad_path():
    arm = planar_arm()
    arm = dataclasses.replace(arm, links=arm.links * 7)
    query = Query(
        system=System(vehicle=BENT_THESIS, arm=arm, drive="prescribed"),
        start=(0.0,) * 14,
        goal=(0.3,) * 14,
        duration=3.0,
    )
    assert "12 joints have 4096 sets" in solve(get_planner("bad-path"), query).failure


def test_a_roadmap_reaches_every_corner():
    system = System(vehicle=BENT_THESIS, arm=six_joint_arm())
    low, high = system.arm.column("q_min"), system.arm.column("q_max")
    path = Roadmap(system, None).route(low, high)
    np.testing.assert_array_equal(path[[0, -1]], [low, high])
    assert ((path >= low) & (path <= high)).all()


def test_a_base_without_stiffness_has_no_hot_spots():
    system = System(vehicle=get_vehicle("free-flying"))
    query = Query(system=system, start=(0.0, 0, 0), goal=(0.5, 0.2, 0.3), duration=2.0)
    plan = solve(get_planner("hotspot-q"), query)
    assert plan.found is None and plan.failure.startswith("no hot spots: ")
    assert plan.failure.endswith("has no stiffness (Q = 0)")
