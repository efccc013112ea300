"""Joint angles in closed form: against forward kinematics and against least squares."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from tests.arms import seven_joint_arm
from ves_gym._util.params import ParameterError
from ves_gym.mechanics.arm_library import get_arm
from ves_gym.mechanics.kinematics import tool_frame
from ves_gym.mechanics.link import Mount
from ves_gym.mechanics.spherical_wrist import has_spherical_wrist, shortest_way
from ves_gym.mechanics.tool_pose import configurations_at_each

PUMA = get_arm("puma560-wrist")
SPAN = np.deg2rad([120.0, 60.0, 120.0, 90.0, 80.0, 120.0])


def towards(arm, q, place, turn):
    """Joint angles (k, 6) at poses (k, 3) and (k, 3, 3), the nearest to q."""
    return q + shortest_way(arm, q, place, turn)


def drawn(count, seed=0):
    return np.random.default_rng(seed).uniform(-SPAN, SPAN, (2, count, 6))


def like_the_puma(*signs):
    """An arm whose axes turn the other way where a sign is -1, on a mount, its tool turned."""
    links = list(PUMA.links)
    for i, sign in zip((0, 2, 3, 4), signs, strict=True):
        links[i] = replace(links[i], alpha=sign * np.pi / 2)
    mount = Mount(position=(0.1, -0.2, 0.3), angles=(0.3, -0.5, 0.8))
    return replace(PUMA, links=tuple(links), mount=mount, tool_angle=0.7)


@pytest.mark.parametrize("signs", list(itertools.product((1, -1), repeat=4)))
def test_the_tool_gets_to_the_pose(signs):
    """Whichever of the eight configurations is the nearest. Tolerance: rounding."""
    arm = like_the_puma(*signs)
    q, goal = drawn(100)
    place, turn = tool_frame(arm, goal)
    end = towards(arm, q, place, turn)
    at, turned = tool_frame(arm, end)
    np.testing.assert_allclose(at, place, atol=1e-9)
    np.testing.assert_allclose(turned, turn, atol=1e-9)
    assert (end >= arm.column("q_min")).all() and (end <= arm.column("q_max")).all()


def test_no_configuration_is_nearer():
    """Of those that least squares give from 32 starts, inside the limits by the margin."""
    q, goal = drawn(60, seed=1)
    place, turn = tool_frame(PUMA, goal)
    fast = PUMA.column("v_max")
    far = np.linalg.norm((towards(PUMA, q, place, turn) - q) / fast, axis=1)
    low, high = PUMA.column("q_min") + 0.05, PUMA.column("q_max") - 0.05
    seen = 0
    for i, ends in enumerate(configurations_at_each(PUMA, place, turn, q, 32)):
        inside = ends[((ends > low) & (ends < high)).all(axis=1)]
        others = np.linalg.norm((inside - q[i]) / fast, axis=1)
        seen += len(others)
        assert (others >= far[i] - 1e-6).all()
    assert seen > 150


def test_from_the_pose_there_is_no_way():
    q, _ = drawn(50, seed=2)
    np.testing.assert_allclose(towards(PUMA, q, *tool_frame(PUMA, q)), q, atol=1e-7)


def test_out_of_reach_it_points_there():
    """Two metres away the arm is straight: elbow and tool on one side, towards the place."""
    q = np.zeros((1, 6))
    turn = tool_frame(PUMA, q)[1]
    for place in ([[2.0, 0.3, 1.0]], [[0.0, 0.0, 0.9]], [[0.0, 0.0, 5.0]]):
        end = towards(PUMA, q, np.array(place), turn)
        assert np.isfinite(end).all()
    end = towards(PUMA, q, np.array([[2.0, 0.3, 1.0]]), turn)
    at = tool_frame(PUMA, end)[0][0]
    assert at[0] > 0.7 and abs(np.arctan2(at[1], at[0]) - np.arctan2(0.3, 2.0)) < 0.1


def test_other_arms_are_refused():
    assert has_spherical_wrist(PUMA)
    for arm in (get_arm("ur5e"), get_arm("iiwa14"), seven_joint_arm()):
        assert not has_spherical_wrist(arm)
    links = [*PUMA.links[:4], replace(PUMA.links[4], d=0.1), PUMA.links[5]]
    with pytest.raises(ParameterError, match="need an arm with a spherical wrist, got puma"):
        towards(
            replace(PUMA, links=tuple(links)), *drawn(1)[:1], *tool_frame(PUMA, drawn(1)[1])
        )
