"""Base pose and rates: against finite differences of the rotation and of momentum."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from ves_gym.mechanics.link import Inertial, matrix
from ves_gym.mechanics.spatial import (
    body_wrench,
    rate_matrix,
    rotation,
    skew,
    twist,
    twist_rate,
)

tilt = st.floats(-1.4, 1.4)
turn = st.floats(-3.1, 3.1)
rate = st.floats(-2, 2)
six = st.tuples(*[rate] * 6).map(np.array)
poses = st.tuples(rate, rate, rate, turn, tilt, turn).map(np.array)
H = 1e-6  # step of central differences: error H^2 of the third derivative, rounding 1e-16 / H


def along(y, yd, ydd, t):
    """A pose that passes y with these rates: quadratic in time."""
    return y + yd * t + ydd * t**2 / 2, yd + ydd * t


def test_rotation_turns_about_z_then_y_then_x():
    """Craig's Z-Y-X: R = Rz Ry Rx, and each angle alone is its elementary rotation."""
    cases = {3: [0, 1, 0], 4: [0, 0, 1], 5: [1, 0, 0]}  # which unit vector to turn
    images = {3: [0, 0, 1], 4: [1, 0, 0], 5: [0, 1, 0]}  # to which, by +90 deg
    parts = []
    for k, vector in cases.items():
        y = np.zeros(6)
        y[k] = np.pi / 2
        np.testing.assert_allclose(rotation(y) @ vector, images[k], atol=1e-15)
        y[k] = 0.1 * k
        parts.append(rotation(y))
    x, y, z = parts
    np.testing.assert_allclose(rotation([9, 9, 9, 0.3, 0.4, 0.5]), z @ y @ x, atol=1e-15)


@settings(max_examples=50, deadline=None)
@given(y=poses, yd=six)
def test_the_rate_matrix_is_the_derivative_of_the_pose(y, yd):
    """Angular part: R^T dR/dt is skew(omega). Linear part: R^T dp/dt."""
    R = rotation(y)
    dR = (rotation(y + H * yd) - rotation(y - H * yd)) / (2 * H)
    v = twist(y, yd)
    np.testing.assert_allclose(R.T @ dR, skew(v[3:]), atol=1e-8)
    np.testing.assert_allclose(v[:3], R.T @ yd[:3], atol=1e-14)
    np.testing.assert_array_equal(v, rate_matrix(y) @ yd)


@settings(max_examples=50, deadline=None)
@given(y=poses, yd=six, ydd=six)
def test_the_twist_rate_is_the_derivative_of_the_twist(y, yd, ydd):
    ahead = twist(*along(y, yd, ydd, H))
    back = twist(*along(y, yd, ydd, -H))
    np.testing.assert_allclose(twist_rate(y, yd, ydd), (ahead - back) / (2 * H), atol=1e-7)


def body():
    moments = np.array([[3.0, 0.4, -0.3], [0.4, 4.0, 0.2], [-0.3, 0.2, 5.0]])
    return Inertial(mass=20.0, com=(0.3, -0.2, 0.5), inertia=matrix(moments))


@settings(max_examples=50, deadline=None)
@given(y=poses, yd=six, ydd=six)
def test_the_body_wrench_is_the_derivative_of_momentum(y, yd, ydd):
    """Linear momentum and angular momentum about a fixed point, in inertial axes.

    Computed from the motion of the centre of mass and the spin, not from `spatial`.
    """
    b = body()

    def momentum(t):
        pose, rates = along(y, yd, ydd, t)
        R, v = rotation(pose), twist(pose, rates)
        com = pose[:3] + R @ np.array(b.com)
        p = b.mass * (rates[:3] + R @ np.cross(v[3:], b.com))
        return np.r_[p, R @ np.array(b.inertia) @ v[3:] + np.cross(com, p)]

    rate_of_change = (momentum(H) - momentum(-H)) / (2 * H)
    wrench = body_wrench(b.spatial(), y, yd, ydd)
    R = rotation(y)
    force = R @ wrench[:3]
    moment = R @ wrench[3:] + np.cross(y[:3], force)
    np.testing.assert_allclose(np.r_[force, moment], rate_of_change, atol=3e-6)
