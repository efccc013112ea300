"""Refinement: from any motion, around obstacles, at any duration; never outside a limit."""

import dataclasses
import re
import time

import numpy as np
import pytest

from tests.arms import seven_joint_arm
from tests.reach import ACROSS
from ves_gym.mechanics.limits import limit_ratios
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.planners import refine as refine_module
from ves_gym.planners import sequential
from ves_gym.planners.motion_problem import MotionProblem
from ves_gym.planners.obstacles import collisions
from ves_gym.planners.prediction import predict
from ves_gym.planners.query import first_violation, solve
from ves_gym.planners.refine import Refined
from ves_gym.planners.registry import get_planner
from ves_gym.planners.suites import reach100
from ves_gym.system.system import System

BENT = System(vehicle=BENT_THESIS)

QUERIES = {q.name: q for _, q in reach100(BENT, "bent-thesis", 3).queries}


def energy(query, motion):
    return predict(query.system, motion, query.servo).E_mean


@pytest.mark.parametrize("name", ["reach-0.5s-000", "reach-2s-000"])
def test_it_is_no_worse_than_direct(name):
    """More control points and more starts; 0.5 % for where an optimiser stops."""
    query = QUERIES[name]
    plan = solve(Refined(), query)
    assert plan.feasible
    direct = solve(get_planner("direct"), query)
    assert plan.predicted.E_mean <= 1.005 * direct.predicted.E_mean
    assert plan.info["starts"] == 5


def test_limits_hold_between_samples():
    query = dataclasses.replace(QUERIES["reach-1s-001"], a_max=(12.0, 16.0, 45.0))
    plan = solve(Refined(), query)
    assert plan.feasible
    s = plan.motion.at(np.linspace(0, query.duration, 20_001))
    assert (np.abs(s.v).max(axis=0) <= np.array(query.v_max) * (1 + 1e-6)).all()
    assert (np.abs(s.a).max(axis=0) <= np.array(query.a_max) * (1 + 1e-6)).all()
    ratios = limit_ratios(query.system.arm, plan.motion, samples=20_001)
    assert ratios["torque"].max() <= 1 + 1e-2


def test_it_goes_around_obstacles():
    assert "obstacle 1 (box)" in first_violation(ACROSS, ACROSS.straight)
    plan = solve(Refined(), ACROSS)
    assert plan.feasible
    checker = collisions(BENT, ACROSS.surroundings)
    assert checker.first_contact(plan.motion.at(np.linspace(0, 4.0, 4001)).q) is None
    rough = solve(get_planner("ompl-qt"), ACROSS)
    assert plan.predicted.E_mean < rough.predicted.E_mean


@pytest.mark.parametrize(
    ("duration", "message"),
    [
        (
            0.4,
            "no motion: joint 1 needs 1.4 s at its speed limit, there are 0.4 s for the",
        ),
        (1.42, "of its limit"),  # hardly time to speed up, on the straight way
    ],
)
def test_no_time_is_said(duration, message):
    plan = solve(Refined(), dataclasses.replace(ACROSS, duration=duration))
    assert not plan.feasible
    assert message in plan.failure


def test_what_torque_cannot_do_is_soon_given_up():
    """Two radians in 0.1 s: fifty times the torque there is. The time it takes is possible."""
    hurried = dataclasses.replace(ACROSS, duration=0.1, v_max=None, surroundings=None)
    begin = time.process_time()
    plan = solve(Refined(), hurried)
    assert time.process_time() - begin < 2.0  # s, of a first look at one start: measured 0.1
    said = re.fullmatch(
        r"no motion: 0\.1 s are too short for speeds and torques of puma560, the shortest"
        r" motion found that keeps its limits takes ([\d.]+) s",
        plan.failure,
    )
    enough = dataclasses.replace(hurried, duration=float(said[1]))
    assert solve(Refined(), enough).feasible
    assert not solve(
        Refined(), dataclasses.replace(hurried, duration=0.6 * float(said[1]))
    ).feasible


def test_torque_is_kept_on_a_base_that_gives_way_at_once():
    """The base's acceleration, an answer to the motion itself, is part of the optimisation.

    As a load taken from the motion before, it grew from round to round until the straight line
    (0.325 J) was the answer, after 47 iterations of each start.
    """
    query = next(q for _, q in reach100(System(), "bent", 7, durations=(1.0,)).queries[6:])
    plan = solve(Refined(), query)
    assert plan.feasible and plan.predicted.E_mean < 0.15
    assert not plan.info["message"].startswith("not refined")


def test_the_torque_against_the_base_has_its_derivative():
    """Central differences along three directions, a step away from the motion it is about."""
    query = reach100(System(), "bent", 1, durations=(1.0,)).queries[0][1]
    problem = MotionProblem(query, 6, nodes=24)
    problem.load(query.straight)
    rng, h = np.random.default_rng(0), 1e-6
    x = problem.straight + 0.05 * rng.normal(size=problem.straight.size)
    _, slope = problem.limits(x)
    for way in rng.normal(size=(3, x.size)):
        ahead, back = (problem.limits(x + s * h * way)[0] for s in (1, -1))
        assert slope @ way == pytest.approx((ahead - back) / (2 * h), abs=1e-6)


@pytest.mark.slow
def test_of_many_joints_starts_are_compared_with_fewer_points(monkeypatch):
    """Seven joints have 168 variables: five starts of 84, one optimisation of all.

    Within 1 % of what comparing them with all points finds.
    """
    system = System(vehicle=BENT_THESIS, arm=seven_joint_arm(), drive="prescribed")
    ((_, query),) = reach100(system, "bent-thesis", 1, durations=(2.0,)).queries
    plan, sizes = solve(Refined(), query), []

    def minimise(problem, x, *args, **options):
        sizes.append(x.size)
        return sequential.minimise(problem, x, *args, **options)

    monkeypatch.setattr(refine_module, "minimise", minimise)
    again = solve(Refined(), query)
    assert again.motion == plan.motion
    assert sizes == [84] * 5 + [168]
    monkeypatch.setattr(refine_module, "_LARGE", 1000)
    sizes.clear()
    long = solve(Refined(), query)
    assert sizes == [168] * 6
    assert plan.predicted.E_mean <= 1.01 * long.predicted.E_mean
    assert plan.feasible and plan.predicted.E_mean < 0.5 * energy(query, query.straight)


def test_a_decision_is_read_off_a_motion():
    problem = MotionProblem(QUERIES["reach-2s-000"], 12)
    motion = Motion.through(
        [problem.start, (problem.start + problem.goal) / 2 + 0.2, problem.goal], 3.0
    )
    t = np.linspace(0, 1, 101)
    fitted = problem.motion(problem.of(motion)).at(2.0 * t).q
    np.testing.assert_allclose(fitted, motion.at(3.0 * t).q, atol=2e-3)
