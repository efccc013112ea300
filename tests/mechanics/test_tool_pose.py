"""Tool poses: the tool's place and turn, and the configurations that give them."""

import mujoco
import numpy as np
import pytest

from tests.arms import planar_arm, seven_joint_arm, six_joint_arm
from ves_gym._util.params import ParameterError
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.kinematics import joint_positions, tool_frame, tool_twists
from ves_gym.mechanics.spatial import rotation
from ves_gym.mechanics.tool_pose import (
    ToolPose,
    configurations_at,
    pose_error,
    tool_pose,
    towards_pose,
)

ARMS = [PUMA_560, planar_arm(), six_joint_arm(), seven_joint_arm()]


@pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
def test_twists_are_the_derivative_of_the_pose(arm):
    q, h = np.linspace(0.4, -0.7, arm.n), 1e-6
    J = tool_twists(arm, q)
    for k, axis in enumerate(np.eye(arm.n)):
        change = pose_error(arm, tool_pose(arm, q + h * axis), q - h * axis) / (2 * h)
        np.testing.assert_allclose(change, J[:, k], atol=1e-8)


@pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
def test_the_frame_is_where_the_last_link_ends(arm):
    q = np.linspace(0.4, -0.7, arm.n)
    place, turn = tool_frame(arm, q)
    np.testing.assert_allclose(place, joint_positions(arm, q)[-1], atol=1e-14)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-14)
    pose = tool_pose(arm, q)
    np.testing.assert_allclose(pose.rotation, turn, atol=1e-12)
    quaternion, matrix = np.empty(4), np.empty(9)  # the same angles, by MuJoCo
    mujoco.mju_euler2Quat(quaternion, np.array(pose.angles), "XYZ")
    mujoco.mju_quat2Mat(matrix, quaternion)
    np.testing.assert_allclose(matrix.reshape(3, 3), turn, atol=1e-12)
    np.testing.assert_allclose(rotation([0, 0, 0, *pose.angles]), turn, atol=1e-12)


@pytest.mark.parametrize("arm", [six_joint_arm(), seven_joint_arm()], ids=lambda a: a.name)
def test_configurations_reach_the_pose_inside_the_limits(arm):
    goal = 0.7 * np.linspace(-1.0, 1.2, arm.n)
    pose = tool_pose(arm, goal)
    found = configurations_at(arm, pose)
    assert len(found) >= (1 if arm.n == 6 else 10)  # postures; a curve of them
    assert np.abs(pose_error(arm, pose, found)).max() < 2e-6
    assert (found >= arm.column("q_min")).all() and (found <= arm.column("q_max")).all()
    apart = np.linalg.norm(found[:, None] - found, axis=-1) + np.eye(len(found))
    assert apart.min() >= 0.05
    nearest = configurations_at(arm, pose, near=goal)[0]
    np.testing.assert_allclose(nearest, goal, atol=1e-9)


def test_a_place_alone_leaves_more_freedom():
    arm = six_joint_arm()
    pose = ToolPose(position=tool_pose(arm, np.full(6, 0.3)).position)
    found = configurations_at(arm, pose)
    assert pose.size == 3 and pose.rotation is None
    assert len(found) > 30
    turns = tool_frame(arm, found)[1][:, :, 2]
    assert (turns @ turns.T).min() < 0  # the tool points all over


def test_what_is_out_of_reach_is_approached():
    arm = PUMA_560
    pose = ToolPose(position=(5.0, 0.0, 0.9))
    assert configurations_at(arm, pose).shape == (0, 3)
    q, miss = towards_pose(arm, pose, np.full((1, 3), 0.1))
    length = 5.0 - np.hypot(0.4318 + 0.4331, -0.2435 + 0.098)
    assert miss[0] == pytest.approx(length, abs=0.02)
    assert (np.abs(q) <= arm.column("q_max")).all()


def test_bad_poses_are_refused():
    with pytest.raises(ParameterError, match=r"ToolPose\.position must have shape \(3,\)"):
        ToolPose(position=(1.0, 2.0))
    with pytest.raises(ParameterError, match=r"ToolPose\.angles must be finite"):
        ToolPose(position=(1.0, 0.0, 0.0), angles=(0.0, np.nan, 0.0))
    with pytest.raises(ParameterError, match="starts must be >= 1, got 0"):
        configurations_at(PUMA_560, ToolPose(position=(0.5, 0.0, 1.0)), starts=0)
