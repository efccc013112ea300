"""The Stewart platform: legs from poses, poses from legs, limits, files."""

import dataclasses

import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.hardware.stewart import VES

TABLE_5_2 = np.array([0.2, -0.2, 0.1, *np.deg2rad([10, -10, 20])])
NO_POSE = np.full(6, np.nan)


def poses(n: int = 200, scale: float = 1.0) -> np.ndarray:
    size = np.array([0.3, 0.3, 0.25, 0.35, 0.35, 0.5]) * scale
    y = np.random.default_rng(0).uniform(-size, size, (4 * n, 6))
    return y[~VES.beyond(VES.leg_lengths(y))[0]][:n]


def test_home_is_level_and_half_extended():
    np.testing.assert_allclose(VES.home_lengths, 1.5, rtol=1e-14)
    joints = np.array(VES.top)
    assert np.ptp(joints[:, 2]) == 0
    assert np.linalg.norm(joints[:, :2], axis=1) == pytest.approx(np.full(6, 0.7))


def test_leg_lengths_are_distances_between_joints():
    """Reference: Z-Y-X rotation built from three elementary ones; rounding only."""
    for y in poses(20):
        (cx, cy, cz), (sx, sy, sz) = np.cos(y[3:]), np.sin(y[3:])
        R = (
            np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
            @ np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
            @ np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
        )
        top = np.array(VES.top) @ R.T + y[:3] + [0, 0, VES.home_height]
        distance = np.linalg.norm(top - np.array(VES.base), axis=1)
        np.testing.assert_allclose(VES.leg_lengths(y), distance, rtol=1e-14)


def test_forward_inverts_the_leg_lengths_over_the_workspace():
    """From the home pose, not only from nearby. Tolerance: 1e-12 m of leg over |J^-1|."""
    y = poses()
    assert len(y) == 200
    found = VES.forward(VES.leg_lengths(y), np.zeros_like(y))
    np.testing.assert_allclose(found, y, atol=2e-11)


def test_jacobian_matches_differences():
    """Tolerance: central differences of step 1e-6 err by about 1e-10."""
    y, h = poses(20), 1e-6
    for j, e in enumerate(np.eye(6) * h):
        slope = (VES.leg_lengths(y + e) - VES.leg_lengths(y - e)) / (2 * h)
        np.testing.assert_allclose(VES.jacobian(y)[..., j], slope, atol=2e-9)


def test_motion_matches_differences_of_a_moving_platform():
    """Leg speed and acceleration of a known motion give back its Y' and Y''."""
    rng, h = np.random.default_rng(1), 1e-4
    a, b, c = poses(20), rng.normal(size=(20, 6)), rng.normal(size=(20, 6))
    minus, now, plus = (VES.leg_lengths(a + b * t + c * t**2 / 2) for t in (-h, 0, h))
    yd, ydd = VES.motion(a, (plus - minus) / (2 * h), (plus - 2 * now + minus) / h**2)
    np.testing.assert_allclose(yd, b, atol=1e-6)
    np.testing.assert_allclose(ydd, c, atol=1e-5)  # rounding 1e-16 m / h^2, and h^2


def test_forward_says_where_it_found_no_pose():
    lengths = np.tile(VES.home_lengths, (4, 1))
    lengths[1] = [0.1, 3.0] * 3  # cannot close
    lengths[2, 0] = np.nan
    start = np.zeros((4, 6))
    start[3] = np.nan
    found = VES.forward(lengths, start)
    np.testing.assert_array_equal(np.isnan(found).all(axis=1), [False, True, True, True])
    np.testing.assert_allclose(found[0], 0, atol=1e-12)


def test_limits_stay_quiet_inside():
    """The release of Table 5-2, 0.3 m and 20 deg one axis at a time."""
    single = np.concatenate([s * np.diag([0.3] * 3 + [np.deg2rad(20)] * 3) for s in (1, -1)])
    y = np.vstack([TABLE_5_2, single])
    lengths = VES.leg_lengths(y)
    assert not VES.beyond(lengths)[0].any()
    assert not VES.too_fast(lengths, lengths, 0.0125)[0].any()


def test_limits_name_the_leg_and_its_length():
    lengths = VES.leg_lengths(np.array([[0.0] * 6, [0.9, 0, 0, 0, 0, 0], NO_POSE]))
    out, leg, length = VES.beyond(lengths)
    np.testing.assert_array_equal(out, [False, True, True])
    assert length[1] == lengths[1, leg[1]] == lengths[1].max() > VES.length_max


def test_speed_limit_names_the_leg_and_its_speed():
    """1 and 2 m/s upwards; a NaN is too fast."""
    dt = 1e-3
    moved = np.array([[0, 0, 1.0, 0, 0, 0], [0, 0, 2, 0, 0, 0], [np.nan] * 6]) * dt
    home = VES.leg_lengths(np.zeros((3, 6)))
    fast, leg, speed = VES.too_fast(home, VES.leg_lengths(moved), dt)
    np.testing.assert_array_equal(fast, [False, True, True])
    assert speed[1] == pytest.approx(2 * VES.jacobian(np.zeros(6))[leg[1], 2], rel=1e-3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"length_min": 2.0}, "length_min must be < length_max"),
        ({"length_max": 1.2}, "home pose needs leg lengths"),
        ({"speed_max": 0.0}, "speed_max must be > 0"),
        ({"base": ((0.0, 0.0, 0.0),) * 5}, r"base must have shape \(6, 3\)"),
        ({"home_height": -1.0}, "home_height must be > 0"),
    ],
)
def test_absurd_numbers_are_refused(change, message):
    with pytest.raises(ParameterError, match=message):
        dataclasses.replace(VES, **change)


def test_geometry_that_does_not_hold_is_refused():
    """Equal hexagons with parallel legs swing freely."""
    base = np.array(VES.base)
    with pytest.raises(ParameterError, match="do not hold"):
        dataclasses.replace(
            VES, top=tuple(map(tuple, base)), home_height=1.5, base=tuple(map(tuple, base))
        )
