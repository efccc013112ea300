"""The regressor of the inertial numbers, against Pinocchio's own."""

import numpy as np
import pytest

from tests.arms import planar_arm, six_joint_arm
from tests.mechanics.test_gravity import random_arm
from ves_gym._util.params import ParameterError
from ves_gym.engine.kernel.maps import inertia_regressor
from ves_gym.engine.mjcf import TO_Y
from ves_gym.mechanics.arm_files import pinocchio_model
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.body_numbers import numbers_of_body
from ves_gym.mechanics.vehicle import BENT_THESIS

ARMS = {
    "puma": PUMA_560,
    "planar": planar_arm(),
    "wrist": six_joint_arm(),
    **{f"random-{seed}": random_arm(seed) for seed in range(1)},
}
each_arm = pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS.keys())


def motion(arm, count):
    """q, v, a of the joints."""
    return np.random.default_rng(0).uniform(-3, 3, (3, count, arm.n))


@each_arm
def test_every_body_carries_what_pinocchio_says(arm):
    """Body by body: Pinocchio gives links' numbers about their joints, we about their ends.

    Tolerance: rounding of some kN.
    """
    pin = pytest.importorskip("pinocchio")
    q, v, a = motion(arm, 20)
    ours, still = inertia_regressor(arm, q, v, a), np.zeros(6)
    bodies = (arm.base, *(link.inertial for link in arm.links))
    numbers = np.concatenate([*map(numbers_of_body, bodies)])

    model = pinocchio_model(arm, BENT_THESIS.base_model())
    data = model.createData()
    for k in range(len(q)):
        state = (np.r_[still, x[k]] for x in (q, v, a))
        Y = pin.computeJointTorqueRegressor(model, data, *state)
        for body in range(arm.n + 1):
            here = slice(10 * body, 10 * body + 10)
            joint = 6 + body  # 0 is the world, 6 the last of the base
            there = slice(10 * (joint - 1), 10 * joint)
            found = ours[k][:, here] @ numbers[here]
            force = Y[:, there] @ model.inertias[joint].toDynamicParameters()
            expected = np.r_[-force[:6][TO_Y], force[6:]]
            np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-9)
            if body == 0:  # the same frame: column by column
                columns = np.vstack([-Y[:6, there][TO_Y], Y[6:, there]])
                np.testing.assert_allclose(ours[k][:, here], columns, atol=1e-12)


def test_rotors_come_last():
    q, v, a = motion(PUMA_560, 4)
    columns = inertia_regressor(PUMA_560, q, v, a)[:, :, 40:]
    np.testing.assert_array_equal(columns[:, :6], 0)
    np.testing.assert_array_equal(columns[:, 6:], a[:, :, None] * np.eye(3))


@pytest.mark.parametrize("shape", [(), (5,), (2, 3), (0,)])
def test_batch_shapes(shape):
    q = np.random.default_rng(1).uniform(-2, 2, (*shape, 3))
    assert inertia_regressor(PUMA_560, q, 0.0, 0.0).shape == (*shape, 9, 43)
    if shape == (2, 3):
        one = inertia_regressor(PUMA_560, q[1, 2], 0.1, 0.2)
        np.testing.assert_array_equal(one, inertia_regressor(PUMA_560, q, 0.1, 0.2)[1, 2])


def test_wrong_arguments_are_refused():
    with pytest.raises(ParameterError, match=r"v must have shape \(\.\.\., 3\), got \(2,\)"):
        inertia_regressor(PUMA_560, np.zeros(3), np.zeros(2), np.zeros(3))
    with pytest.raises(ParameterError, match=r"must broadcast, got q \(2, 3\), v \(4, 3\)"):
        inertia_regressor(PUMA_560, np.zeros((2, 3)), np.zeros((4, 3)), 0.0)
    with pytest.raises(ParameterError, match="a must be finite"):
        inertia_regressor(PUMA_560, 0.0, 0.0, [0, 0, np.inf])
