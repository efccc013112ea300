"""Unit quaternions against SciPy's rotations, and a free body against Jacobi's closed form."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.free_bodies import free_body
from ves_gym.mechanics import attitude
from ves_gym.mechanics.spatial import rotation, twist

near = st.floats(-3, 3)
turns = st.tuples(near, near, near).map(np.array)  # rotation vectors, up to 5 rad
quaternions = turns.map(attitude.exp)
ROUNDING = {"rtol": 0, "atol": 1e-12}


def scipy_of(q):
    return Rotation.from_quat(np.roll(q, -1, axis=-1))  # scalar last there


@settings(max_examples=50, deadline=None)
@given(p=quaternions, q=quaternions)
def test_products_chain_rotations(p, q):
    R = attitude.to_matrix(p) @ attitude.to_matrix(q)
    np.testing.assert_allclose(attitude.to_matrix(attitude.product(p, q)), R, **ROUNDING)
    np.testing.assert_allclose((scipy_of(p) * scipy_of(q)).as_matrix(), R, **ROUNDING)
    back = attitude.product(attitude.conjugate(q), q)
    np.testing.assert_allclose(back, attitude.IDENTITY, **ROUNDING)


@settings(max_examples=50, deadline=None)
@given(turn=turns)
def test_exponential_and_logarithm_are_scipys(turn):
    q = attitude.exp(turn)
    np.testing.assert_allclose(
        attitude.to_matrix(q), Rotation.from_rotvec(turn).as_matrix(), **ROUNDING
    )
    np.testing.assert_allclose(attitude.exp(attitude.log(q)), q * np.sign(q[0] or 1), atol=1e-8)
    np.testing.assert_allclose(
        np.abs(np.sum(attitude.from_matrix(attitude.to_matrix(q)) * q)), 1
    )


@pytest.mark.parametrize(
    "angle", [0.0, 1e-12, 1e-6, 0.99e-4, 1.01e-4, 1.0, np.pi - 1e-9, np.pi]
)
def test_logarithm_keeps_its_digits_at_every_angle(angle):
    turn = angle * np.array([2.0, -3.0, 6.0]) / 7
    np.testing.assert_allclose(attitude.log(attitude.exp(turn)), turn, rtol=1e-9, atol=1e-300)


@settings(max_examples=50, deadline=None)
@given(phi=turns)
def test_angles_are_those_of_the_base_pose(phi):
    q = attitude.from_angles(phi)
    R = rotation(np.r_[0, 0, 0, phi])
    np.testing.assert_allclose(attitude.to_matrix(q), R, **ROUNDING)
    angles = attitude.to_angles(q)
    np.testing.assert_allclose(rotation(np.r_[0, 0, 0, angles]), R, atol=1e-7)
    assert np.abs(angles[1]) <= np.pi / 2


@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2])
def test_angles_at_the_singularity_are_the_same_attitude(pitch):
    R = rotation(np.array([0, 0, 0, 0.3, pitch, -0.8]))
    angles = attitude.to_angles(attitude.from_matrix(R))
    np.testing.assert_allclose(rotation(np.r_[0, 0, 0, angles]), R, atol=1e-7)


@settings(max_examples=50, deadline=None)
@given(phi=turns, rates=turns)
def test_rates_are_those_of_the_base_pose(phi, rates):
    """Reference: the lower block of `spatial.rate_matrix`."""
    w = twist(np.r_[0, 0, 0, phi], np.r_[0, 0, 0, rates])[3:]
    if np.abs(np.cos(phi[1])) > 0.01:
        np.testing.assert_allclose(attitude.angle_rates(phi, w), rates, atol=1e-9)


@settings(max_examples=50, deadline=None)
@given(p=quaternions, q=quaternions)
def test_the_difference_turns_one_attitude_into_the_other(p, q):
    turn = attitude.difference(p, q)
    assert np.linalg.norm(turn) <= np.pi + 1e-9
    reached = attitude.to_matrix(attitude.product(q, attitude.exp(turn)))
    np.testing.assert_allclose(reached, attitude.to_matrix(p), atol=1e-9)


def test_a_free_body_follows_jacobis_elliptic_functions():
    """10 s of a tumbling body: angular velocity in closed form; momentum in inertial axes."""
    inertia, w0 = np.array([90.0, 60.0, 40.0]), np.array([1.0, 0.1, -0.6])
    J, h = np.diag(inertia), 0.005
    q, w = attitude.exp([2.0, -1.0, 0.5]), w0
    momentum = attitude.rotate(q, J @ w)
    for _ in range(2000):
        q, w = attitude.torque_free_step(q, w, J, h)
    reference = free_body(inertia, w0, np.array([10.0]))[0]
    np.testing.assert_allclose(free_body(inertia, w0, np.zeros(1))[0], w0, atol=1e-12)
    np.testing.assert_allclose(w, reference, atol=1e-9)
    np.testing.assert_allclose(attitude.rotate(q, J @ w), momentum, rtol=1e-12)
