"""The tool: its Jacobian, and the joint angles that bring it to a place or a pose."""

import mujoco
import numpy as np
import pytest

from tests.arms import planar_arm, pose_error, seven_joint_arm, six_joint_arm, tool_pose
from ves_gym._util.params import ParameterError
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.kinematics import (
    ToolPose,
    dexterity,
    joint_positions,
    tool_frame,
    tool_jacobian,
    tool_speeds,
    tool_state,
    tool_twists,
)
from ves_gym.mechanics.spatial import rotation, twist
from ves_gym.mechanics.tool_pose import (
    configurations_at,
    every_joints_for,
    joints_for,
    towards_pose,
)

LOW, HIGH = PUMA_560.column("q_min"), PUMA_560.column("q_max")


def angles(count, seed=0):
    return np.random.default_rng(seed).uniform(LOW, HIGH, (count, 3))


def tool(q):
    return joint_positions(PUMA_560, q)[..., -1, :]


def test_dexterity_follows_the_singular_values():
    """(sum of s^-2)^-1/2: between 1/sqrt(3) of the smallest and the smallest."""
    q = angles(200)
    values = np.linalg.svd(tool_jacobian(PUMA_560, q), compute_uv=False)
    expected = (1 / values**2).sum(axis=1) ** -0.5
    np.testing.assert_allclose(dexterity(PUMA_560, q), expected, rtol=1e-6, atol=1e-7)
    assert dexterity(PUMA_560, [0.3, 0.4, 0.0]) < 1e-7  # the elbow stretched out


def test_joints_for_comes_close_to_what_is_out_of_reach():
    """Within a centimetre of the closest place, the arm stretched out towards it."""
    shoulder, far = np.array([0.0, 0.0, 0.90044]), np.array([[5.0, 0.0, 0.90044]])
    _, miss = joints_for(PUMA_560, far, np.zeros((1, 3)))
    assert configurations_at(PUMA_560, ToolPose(position=tuple(far[0]))).shape == (0, 3)
    ends, lacks = towards_pose(PUMA_560, ToolPose(position=tuple(far[0])), np.full((1, 3), 0.1))
    assert (np.abs(ends) <= HIGH).all() and lacks[0] >= miss[0] - 1e-9
    reach = np.linalg.norm(tool(np.zeros(3)) - shoulder)
    assert miss[0] == pytest.approx(5.0 - reach, abs=1e-2)


def test_every_configuration_of_a_place():
    """The PUMA has two elbows and two shoulders: up to four, less what the limits forbid."""
    arm = PUMA_560
    draw = np.random.default_rng(4)
    q = draw.uniform(-1.0, 1.0, (30, arm.n))
    near = draw.uniform(-1.0, 1.0, (30, arm.n))
    points = joint_positions(arm, q)[:, -1]
    found = every_joints_for(arm, points, near)
    counts = (~np.isnan(found[..., 0])).sum(axis=1)
    assert counts.min() >= 1 and counts.max() in (2, 3, 4)
    nearest, _ = joints_for(arm, points, near)
    np.testing.assert_allclose(found[:, 0], nearest, atol=1e-6)
    for i, count in enumerate(counts):
        ends = found[i, :count]
        places = joint_positions(arm, ends)[:, -1]
        np.testing.assert_allclose(places, np.tile(points[i], (count, 1)), atol=2e-6)
        apart = np.abs(ends[:, None] - ends).max(axis=-1) + np.eye(count)
        assert apart.min() > 1e-3
        assert np.abs(ends - q[i]).max(axis=1).min() < 1e-3  # the one it was made from
        seconds = (np.abs(ends - near[i]) / arm.column("v_max")).max(axis=1)
        assert (np.diff(seconds) > -1e-5).all()  # soonest reached first
    beyond = every_joints_for(arm, [[5.0, 0.0, 0.0]], near[:1])
    assert (~np.isnan(beyond[..., 0])).sum() == 1


# -------------------------------------------------------------------------- poses

ARMS = [PUMA_560, planar_arm(), six_joint_arm(), seven_joint_arm()]


@pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
def test_twists_are_the_derivative_of_the_pose(arm):
    q, h = np.linspace(0.4, -0.7, arm.n), 1e-6
    J = tool_twists(arm, q)
    np.testing.assert_array_equal(tool_jacobian(arm, q), J[:3])
    for k, axis in enumerate(np.eye(arm.n)):
        change = pose_error(arm, tool_pose(arm, q + h * axis), q - h * axis) / (2 * h)
        np.testing.assert_allclose(change, J[:, k], atol=1e-8)


def test_twists_on_a_moving_base_are_the_derivative_of_the_place():
    arm, h = six_joint_arm(), 1e-6
    q, v, y, yd = np.random.default_rng(0).uniform(-1, 1, 24).reshape(4, 6)

    def place(t):
        return y[:3] + yd[:3] * t + rotation(y + yd * t) @ tool_frame(arm, q + v * t)[0]

    state = tool_state(arm, q, v, twist(y, yd))
    speed = rotation(y).T @ (place(h) - place(-h)) / (2 * h)
    np.testing.assert_allclose(state.twist[:3], speed, atol=1e-8)
    squares = [speed @ speed, state.twist[3:] @ state.twist[3:]]
    np.testing.assert_allclose(tool_speeds(arm, q, v, twist(y, yd)), squares, atol=1e-7)


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


def test_bad_poses_are_refused():
    with pytest.raises(ParameterError, match=r"ToolPose\.position must have shape \(3,\)"):
        ToolPose(position=(1.0, 2.0))
    with pytest.raises(ParameterError, match=r"q must have shape \(..., 3\), got \(2,\)"):
        tool_jacobian(PUMA_560, [0.0, 0.0])
    with pytest.raises(ParameterError, match="starts must be >= 1, got 0"):
        configurations_at(PUMA_560, ToolPose(position=(0.5, 0.0, 1.0)), starts=0)
