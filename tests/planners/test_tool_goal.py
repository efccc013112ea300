"""Tool poses as goals: of the configurations that reach one, the cheapest for the base."""

from dataclasses import replace

import numpy as np
import pytest

import ves_gym as vg
from tests.arms import seven_joint_arm, six_joint_arm
from ves_gym._util.params import ParameterError
from ves_gym.mechanics.kinematics import joint_positions
from ves_gym.mechanics.tool_pose import ToolPose, pose_error, tool_pose
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.planners.obstacles import Sphere, Surroundings, collisions
from ves_gym.planners.query import Query, solve
from ves_gym.planners.registry import get_planner
from ves_gym.planners.suites import reach100
from ves_gym.planners.tool_goal import choose_goals, solve_to_tool
from ves_gym.system.system import System


def queries(arm, count=2):
    suite = reach100(
        System(vehicle=BENT_THESIS, arm=arm, drive="prescribed"),
        "bent-thesis",
        count,
        durations=(2.0,),
    )
    return [query for _, query in suite.queries]


@pytest.mark.parametrize("turn", [True, False], ids=["pose", "place"])
@pytest.mark.parametrize("make", [six_joint_arm, seven_joint_arm])
def test_it_costs_no_more_than_the_configuration_it_was_taken_from(make, turn):
    """Planned by `direct` to the pose, and to the joint angles that the pose was read from."""
    arm = make()
    for query in queries(arm):
        pose = tool_pose(arm, query.goal)
        pose = pose if turn else replace(pose, angles=None)
        plan = solve_to_tool(get_planner("direct"), query, pose)
        assert plan.feasible
        assert np.abs(pose_error(arm, pose, plan.motion.goal)).max() < 2e-6
        given = solve(get_planner("direct"), query)
        assert plan.predicted.E_mean <= 1.02 * given.predicted.E_mean
        assert plan.info["tool"]["goal"] == list(plan.query.goal)
        if arm.n == 7 or not turn:
            assert plan.predicted.E_mean < 0.85 * given.predicted.E_mean


def test_goals_inside_an_obstacle_are_left_out():
    """A ball at the elbow of one of the postures that reach a place."""
    system = System(vehicle=BENT_THESIS, drive="prescribed")
    asked = Query(system=system, start=(0.0,) * 3, goal=(0.0,) * 3, duration=4.0)
    pose = ToolPose(position=tool_pose(system.arm, (0.8, 0.6, -1.2)).position)
    goals = choose_goals(asked, pose)
    assert len(goals) >= 2
    elbow = tuple(joint_positions(system.arm, goals[0])[2].tolist())
    ball = Surroundings(obstacles=(Sphere(centre=elbow, radius=0.05),))
    checker = collisions(system, ball)
    assert not checker.is_clear(goals[0])
    left = choose_goals(replace(asked, surroundings=ball), pose)
    assert 0 < len(left) < len(goals)
    assert all(checker.is_clear(q) for q in left)
    blocked = Surroundings(obstacles=(Sphere(centre=pose.position, radius=0.2),))
    with pytest.raises(ParameterError, match="clear of the obstacles: no configuration"):
        solve_to_tool(get_planner("direct"), replace(asked, surroundings=blocked), pose)


def test_a_pose_out_of_reach_is_refused_with_how_near_it_is():
    arm = six_joint_arm()
    (query,) = queries(arm, 1)
    pose = ToolPose(position=(9.0, 0.0, 0.0))
    with pytest.raises(ParameterError, match=r"\(9\.0, 0\.0, 0\.0\) m must be within reach"):
        solve_to_tool(get_planner("straight"), query, pose)
    with pytest.raises(ParameterError, match="tries must be >= 1, got 0"):
        solve_to_tool(get_planner("straight"), query, tool_pose(arm, query.goal), tries=0)


def test_the_same_from_python():
    """The thesis's arm has two postures for a place."""
    place = tool_pose(System(vehicle=BENT_THESIS).arm, (0.8, 0.3, -0.9)).position
    plan = vg.plan((0.0, 0.0, 0.0), ToolPose(position=place), planner="straight")
    assert plan.feasible
    np.testing.assert_allclose(
        tool_pose(System(vehicle=BENT_THESIS).arm, plan.motion.goal).position, place, atol=2e-6
    )
