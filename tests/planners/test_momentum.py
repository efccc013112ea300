"""Compiled momentum and torque: the values of `mechanics/dynamics.py`, exact derivatives."""

import numpy as np
import pytest

from tests.arms import planar_arm, six_joint_arm
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.dynamics import inertia, inverse_dynamics
from ves_gym.planners.momentum import momentum, torque

ARMS = {"puma": PUMA_560, "planar": planar_arm(), "six joints": six_joint_arm()}
H = 1e-6  # of central differences


@pytest.fixture(params=ARMS)
def arm(request):
    return ARMS[request.param]


def states(arm, count=5):
    return np.random.default_rng(0).normal(size=(3, count, arm.n))


def test_momentum_and_its_derivatives(arm):
    q, v, _ = states(arm)
    sample = momentum(arm, q, v)
    Hbm = inertia(arm, q)[..., :6, 6:]
    np.testing.assert_allclose(sample.by_v, Hbm, atol=1e-12)
    np.testing.assert_allclose(sample.u, np.einsum("kij,kj->ki", Hbm, v), atol=1e-11)
    for j, e in enumerate(np.eye(arm.n)):
        change = (momentum(arm, q + H * e, v).u - momentum(arm, q - H * e, v).u) / (2 * H)
        np.testing.assert_allclose(sample.by_q[..., j], change, atol=1e-7)


def test_torque_and_its_derivatives(arm):
    s = list(states(arm))
    dynamics = torque(arm, *s)
    np.testing.assert_allclose(dynamics.tau, inverse_dynamics(arm, *s)[0], atol=1e-11)
    for k in range(3):
        for j, e in enumerate(np.eye(arm.n)):
            ahead, behind = list(s), list(s)
            ahead[k], behind[k] = s[k] + H * e, s[k] - H * e
            change = (torque(arm, *ahead).tau - torque(arm, *behind).tau) / (2 * H)
            np.testing.assert_allclose(dynamics.by[:, k, :, j], change, atol=1e-6)


def test_leading_axes():
    q, v, a = states(PUMA_560, 6)
    flat = momentum(PUMA_560, q, v)
    stacked = momentum(PUMA_560, q.reshape(2, 3, 3), v.reshape(2, 3, 3))
    np.testing.assert_array_equal(stacked.by_q.reshape(6, 6, 3), flat.by_q)
    by = torque(PUMA_560, *(k.reshape(2, 3, 3) for k in (q, v, a))).by
    assert by.shape == (2, 3, 3, 3, 3)
