"""OMPL: good paths, the same ones every time, and no harm from a child that fails."""

import dataclasses
import re
import time

import numpy as np
import pytest

from tests.reach import ACROSS
from ves_gym._util.child_process import Child
from ves_gym._util.params import ParameterError
from ves_gym.mechanics.kinematics import frames
from ves_gym.mechanics.motion import quintic
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.planners import ompl_search
from ves_gym.planners.metric import Metric
from ves_gym.planners.obstacles import Box, Sphere, Surroundings
from ves_gym.planners.ompl_search import Ompl
from ves_gym.planners.paths import cruise, follow, resample
from ves_gym.planners.query import Query, solve
from ves_gym.system.system import System

BENT = System(vehicle=BENT_THESIS)

LONG = Query(system=BENT, start=(-1.0, -0.8, 1.5), goal=(1.2, 0.9, -1.4), duration=8.0)


VARIANTS = ("informed-rrtstar", "sorrtstar")  # of rrtstar, by the same code of ours


@pytest.mark.parametrize(
    ("algorithm", "objective"),
    [("bitstar", "qt"), ("rrtstar", "q")]
    + [pytest.param(k, "qt", marks=pytest.mark.slow) for k in VARIANTS],
)
def test_it_finds_a_shorter_path_than_the_straight_one(algorithm, objective):
    """In its own metric, and no longer with time. Seen: 0.94 to 0.98 and 0.78 to 0.85."""
    planner = Ompl(objective=objective, algorithm=algorithm, evaluations=20_000)
    result = planner.search(LONG, seed=0)
    metric = Metric(LONG.system, LONG.duration if objective == "qt" else None)
    assert result.cost < 0.985 * metric.lengths(*LONG.ends)
    length = metric.lengths(result.path[:-1], result.path[1:]).sum()
    assert result.cost == pytest.approx(length, rel=1e-9)
    np.testing.assert_allclose(result.path[[0, -1]], LONG.ends)
    assert result.evaluations <= 1.5 * 20_000 + 1001


@pytest.mark.parametrize(
    "algorithm",
    ["bitstar", *(pytest.param(k, marks=pytest.mark.slow) for k in ("rrtstar", *VARIANTS))],
)
def test_the_same_seed_gives_the_same_path(algorithm):
    """In a child that has searched before, and in a new one."""
    planner = Ompl(algorithm=algorithm, evaluations=3000)
    first = planner.search(ACROSS, seed=3)
    repeated = planner.search(ACROSS, seed=3)
    other = planner.search(ACROSS, seed=4)
    ompl_search.SEARCH_PROCESS.end()
    new = planner.search(ACROSS, seed=3)
    for result in (repeated, new):
        np.testing.assert_array_equal(result.path, first.path)
        assert (result.cost, result.evaluations) == (first.cost, first.evaluations)
    assert other.path.shape != first.path.shape or (other.path != first.path).any()


def test_a_path_there_is_no_time_for_gives_way_to_the_fastest():
    slow = solve(Ompl(evaluations=5000), ACROSS)
    assert slow.feasible
    fast = solve(Ompl(objective="time", evaluations=5000), ACROSS)
    assert fast.feasible and not fast.info["hurried"]
    assert slow.info["hurried"]
    longer = dataclasses.replace(ACROSS, duration=8.0)
    assert not solve(Ompl(evaluations=5000), longer).info["hurried"]


def test_a_search_that_is_proven_ends():
    """Time is a norm: the straight line's is the least, and no evaluation more is needed."""
    result = Ompl(objective="time").search(LONG, seed=0)
    assert result.cost == pytest.approx(result.bound, rel=1e-9)
    assert result.evaluations < 100


def test_a_law_that_cruises():
    u = np.linspace(0, 1, 4001)
    s = cruise(u)
    speed = np.gradient(s, u)
    assert (s[0], s[-1]) == (0.0, 1.0)
    assert (np.diff(s) >= -1e-12).all()
    assert speed.max() == pytest.approx(1.25, rel=1e-3)
    assert speed[[0, -1]] == pytest.approx(0.0, abs=1e-3)


def test_an_end_in_an_obstacle_is_no_question():
    tip = Sphere(centre=(1.1, 0.0, 0.9), radius=0.5)
    query = Query(
        system=BENT, start=(1.5, 0.0, 0.0), goal=(0.0, 0.0, 0.0),
        duration=2.0, surroundings=Surroundings(obstacles=(tip,)),
    )  # fmt: skip
    plan = solve(Ompl(), query)
    assert plan.found is None and not plan.feasible
    assert plan.failure.startswith("no motion: the goal is too near: ")
    assert "obstacle 1 (sphere)" in plan.failure


def test_where_there_is_no_way_it_says_so():
    """A block in the way of the shoulder, which only joint 1 moves, and only past it."""
    axis = frames(BENT.arm, np.zeros(3)).axis[1]
    block = Box(centre=tuple(np.array([0, 0, 0.9]) - 0.2 * axis), size=(0.05, 0.05, 0.05))
    query = dataclasses.replace(ACROSS, surroundings=Surroundings(obstacles=(block,)))
    begin = time.perf_counter()
    plan = solve(Ompl(evaluations=1500), query)
    assert re.match(r"no path found within \d+ cost evaluations and \d+ valid", plan.failure)
    assert time.perf_counter() - begin < 20


def test_seconds_end_a_search():
    planner = Ompl(evaluations=10**9, seconds=0.5)
    begin = time.perf_counter()
    result = planner.search(LONG, seed=0)
    assert time.perf_counter() - begin < 8
    assert result.path is not None


# ------------------------------------------------------------------- a child that fails

# crashes and bad costs: tests/claims/test_a_failing_search_costs_one_query.py; its process:
# tests/_util/test_child_process.py


def test_a_failure_in_the_child_is_reported(monkeypatch):
    """As that of one query: the next one gets a new child."""
    code = "import time; w.search = lambda request: time.sleep(60)"
    child = Child(f"from ves_gym.planners import ompl_search as w\n{code}\nw.serve()")
    monkeypatch.setattr(ompl_search, "SEARCH_PROCESS", child)
    monkeypatch.setattr(ompl_search, "_GRACE", 0.5)
    patient = Ompl(algorithm="rrtstar", evaluations=500, seconds=20.0)
    for _ in range(2):
        plan = solve(dataclasses.replace(patient, seconds=0.5), LONG)
        assert "the search did not answer within 1 s" in plan.failure
        assert plan.found is None
    monkeypatch.undo()
    assert solve(patient, LONG).found is not None


# ------------------------------------------------------------------------------ options


def test_an_algorithm_that_is_none():
    with pytest.raises(ParameterError, match=r"Ompl\.algorithm must be one of rrtstar, "):
        Ompl(algorithm="prm")


def test_a_motion_that_has_to_stay_on_its_polyline():
    path = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0]])
    fine = resample(path, 201)
    gaps = [
        np.linalg.norm(
            follow(path, 2.0, np.ones(3), n, quintic).at(np.linspace(0, 2, 301)).q[:, None]
            - fine,
            axis=-1,
        )
        .min(axis=1)
        .max()
        for n in (24, 96)
    ]
    assert gaps[1] < gaps[0] < 0.1
    assert gaps[1] < 0.02
