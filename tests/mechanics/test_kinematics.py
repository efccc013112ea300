"""Jacobian of the tool and the way back from points to joint angles."""

import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.kinematics import dexterity, joint_positions, tool_jacobian
from ves_gym.mechanics.tool_pose import every_joints_for, joints_for

LOW, HIGH = PUMA_560.column("q_min"), PUMA_560.column("q_max")


def angles(count, seed=0):
    return np.random.default_rng(seed).uniform(LOW, HIGH, (count, 3))


def tool(q):
    return joint_positions(PUMA_560, q)[..., -1, :]


def test_jacobian_is_the_derivative_of_the_tool():
    """Central differences of 1e-6 rad: rounding of 1e-9."""
    q, h = angles(50).reshape(5, 10, 3), 1e-6
    J = tool_jacobian(PUMA_560, q)
    for j, step in enumerate(h * np.eye(3)):
        slope = (tool(q + step) - tool(q - step)) / (2 * h)
        np.testing.assert_allclose(J[..., j], slope, atol=1e-8)


def test_jacobian_wants_joint_angles():
    with pytest.raises(ParameterError, match=r"q must have shape \(..., 3\), got \(2,\)"):
        tool_jacobian(PUMA_560, [0.0, 0.0])


def test_dexterity_follows_the_singular_values():
    """(sum of s^-2)^-1/2: between 1/sqrt(3) of the smallest and the smallest."""
    q = angles(200)
    values = np.linalg.svd(tool_jacobian(PUMA_560, q), compute_uv=False)
    expected = (1 / values**2).sum(axis=1) ** -0.5
    np.testing.assert_allclose(dexterity(PUMA_560, q), expected, rtol=1e-6, atol=1e-7)
    assert dexterity(PUMA_560, [0.3, 0.4, 0.0]) < 1e-7  # the elbow stretched out


def test_joints_for_finds_what_can_be_reached():
    """A thousand points that the arm reaches: every one found, within the limits."""
    points = tool(angles(1000))
    q, miss = joints_for(PUMA_560, points, angles(1000, 1))
    assert ((q >= LOW) & (q <= HIGH)).all()
    np.testing.assert_allclose(np.linalg.norm(tool(q) - points, axis=1), miss, atol=1e-12)
    print(f"largest miss {miss.max():.2g} m")
    assert miss.max() < 1e-4


def test_joints_for_takes_the_solution_nearby():
    q = angles(50)[dexterity(PUMA_560, angles(50)) > 0.2]
    found, miss = joints_for(PUMA_560, tool(q), q + 0.02)
    assert miss.max() < 1e-6
    np.testing.assert_allclose(found, q, atol=1e-5)


def test_joints_for_comes_close_to_what_is_out_of_reach():
    """Within a centimetre of the closest place, the arm stretched out towards it."""
    shoulder, far = np.array([0.0, 0.0, 0.90044]), np.array([[5.0, 0.0, 0.90044]])
    _, miss = joints_for(PUMA_560, far, np.zeros((1, 3)))
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
    beyond = every_joints_for(arm, [[5.0, 0.0, 0.0]], near[:1])
    assert (~np.isnan(beyond[..., 0])).sum() == 1
