"""What a measured motion takes, with payloads: Newton-Euler's and Pinocchio's."""

import numpy as np
import pytest

from tests.arms import planar_arm, six_joint_arm
from tests.simulation.test_emulation_loop import rnea
from ves_gym.diagnosis.data.measured_run import Kinematics
from ves_gym.diagnosis.machines.arm_load import (
    MeasuredMotion,
    base_motion,
    motion_load,
    weight_torque,
)
from ves_gym.effects import PayloadBody, PayloadMass
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.gravity import gravity_vector

PAYLOADS = {
    "mass": PayloadMass(mass=2.0, position=(0.1, -0.2, 0.3)),
    "body": PayloadBody(mass=1.5, moment=(0.1, 0.0, 0.2), inertia=(0.2, 0, 0.3, 0, 0, 0.25)),
    "extent": PayloadMass.forms[5](PayloadMass(mass=2.0)),
}


def motion(arm, seed=0):
    """Joints (3, 40, n), and a base (3, 40, 6) that turns fast."""
    rng = np.random.default_rng(seed)
    joints = Kinematics(*rng.normal(size=(3, 3, 40, arm.n)))
    return joints, Kinematics(*(0.3 * rng.normal(size=(3, 3, 40, 6))))


@pytest.mark.parametrize("balanced", [True, False], ids=["balanced", "unbalanced"])
@pytest.mark.parametrize("payload", PAYLOADS.values(), ids=PAYLOADS.keys())
@pytest.mark.parametrize(
    "arm", [PUMA_560, planar_arm(), six_joint_arm()], ids=["puma", "planar", "wrist"]
)
def test_an_arm_with_a_payload_takes_what_the_laws_of_motion_say(arm, payload, balanced):
    joints, base = motion(arm)
    measured = MeasuredMotion(joints, base.x, base_motion(base), True, balanced)
    loaded = payload.arm(arm)
    found = measured.load(loaded)
    tau, wrench = motion_load(loaded, joints, base_motion(base), gravity_vector(base.x))
    if balanced:
        tau = tau - weight_torque(loaded, joints.x, base.x)
    np.testing.assert_allclose(found[0], tau, rtol=0, atol=1e-12 * np.abs(tau).max())
    np.testing.assert_allclose(found[1], wrench, rtol=0, atol=1e-12 * np.abs(wrench).max())
    for i in (0, 17, 39):
        at = (0, i)
        theirs = rnea(loaded, *(x[at] for x in base), *(x[at] for x in joints))
        np.testing.assert_allclose(found[1][at], theirs, rtol=0, atol=1e-9)
