"""An arm beside the one that works is free to move, and leaves the base at rest."""

import numpy as np
import pytest

import ves_gym as vg
from ves_gym._util.params import ParameterError
from ves_gym.mechanics.arm_library import get_arm
from ves_gym.mechanics.kinematics import ToolPose, tool_frame
from ves_gym.mechanics.vehicle import BENT, Satellite, get_vehicle
from ves_gym.planners.case import Case, Query
from ves_gym.planners.motion_problem import MotionProblem
from ves_gym.planners.query import first_violation
from ves_gym.system.system import System

UR5E = get_arm("ur5e")
ARMS = [UR5E.at((0.0, 0.5, 0.0)), UR5E.at((0.0, -0.5, 0.0))]
ON_BENT = System(arms=ARMS, vehicle=BENT)
START = np.tile([0.3, -1.3, 0.8, -0.4, 0.5, 0.2], 2)
GOAL = np.array([-0.6, -0.8, 1.3, 0.4, -0.2, 0.9])


def left_over(system: System, plan: vg.Plan) -> float:
    return vg.energy(vg.simulate(plan, system)).E_mean


@pytest.mark.parametrize("planner", ["direct", "refined"])
def test_the_other_arm_takes_the_energy_out_of_the_beam(planner):
    free = vg.plan(START, GOAL, system=ON_BENT, planner=planner)
    held = vg.plan(START, np.r_[START[:6], GOAL], system=ON_BENT, planner=planner)
    assert free.feasible and held.feasible, (free, held)
    assert free.found is not None and held.found is not None
    np.testing.assert_allclose(free.motion.goal[6:], GOAL, rtol=0, atol=1e-12)
    assert np.abs(free.motion.goal[:6] - START[:6]).max() > 0.05  # at rest elsewhere
    np.testing.assert_array_equal(held.motion.goal[:6], START[:6])
    assert np.array(free.query.goal) == pytest.approx(free.motion.goal)
    assert left_over(ON_BENT, free) <= 0.1 * left_over(ON_BENT, held)


@pytest.mark.slow
def test_a_tool_pose_leaves_the_other_arm_free():
    place, _ = tool_frame(ON_BENT.arm, np.r_[START[:6], GOAL])
    pose = ToolPose(position=tuple(place.tolist()))
    plan = vg.plan(START, pose, system=ON_BENT)
    assert plan.feasible, plan.failure
    reached, _ = tool_frame(ON_BENT.arm, plan.motion.goal)
    np.testing.assert_allclose(reached, place, rtol=0, atol=1e-6)
    assert np.abs(plan.motion.goal[:6] - START[:6]).max() > 0.05


def test_a_planner_that_knows_no_free_joints_holds_them():
    plan = vg.plan(START, GOAL, system=ON_BENT, planner="straight")
    assert plan.feasible
    np.testing.assert_allclose(plan.motion.goal, np.r_[START[:6], GOAL])


def test_the_limits_derivatives_know_the_free_end():
    query = Query(
        system=System(arms=ARMS, vehicle=Satellite(body=get_vehicle("servicer").body)),
        start=tuple(START), goal=tuple(np.r_[START[:6], GOAL]), duration=2.0,
        v_max=(3.0,) * 12, a_max=(10.0,) * 12, free_joints=(0, 1, 2, 3, 4, 5),
    )  # fmt: skip
    problem = MotionProblem(query, 4)
    rng = np.random.default_rng(0)
    x = problem.straight + 0.1 * rng.normal(size=problem.straight.size)
    step = 1e-6 * rng.normal(size=x.size)
    for function in (problem.momentum, problem.limits):
        ahead, back = function(x + step)[0], function(x - step)[0]
        slope = function(x)[1] @ step
        np.testing.assert_allclose((ahead - back) / 2, slope, rtol=0, atol=1e-10)
    # the control polygon's speed limits hold for the whole motion, its free end included
    motion = problem.motion(x)
    assert first_violation(query, motion) != "the motion does not join the ends of the query"


def test_free_joints_are_named_and_kept(tmp_path):
    parts = {"system": ON_BENT, "start": tuple(START), "goal": tuple(START), "duration": 2.0}
    for wrong in ((0, 0), (12,), (-1,)):
        with pytest.raises(ParameterError, match="free_joints must be different ones of 0 to"):
            Query(**parts, free_joints=wrong)
    query = Query(**parts, free_joints=(0, 1))
    case = Case(system=ON_BENT, query=query, servo=query.servo)
    case.save(tmp_path / "case.toml")
    assert vg.load_case(tmp_path / "case.toml").query.free_joints == (0, 1)
