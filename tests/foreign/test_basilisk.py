"""Basilisk 2.12.1: wheels, jets, arrays and slosh of a satellite, an arm moving on it."""

from dataclasses import replace

import numpy as np
import pytest

from tests.foreign.conftest import difference
from tests.foreign.servo_loop import servo_loop
from ves_gym.mechanics.arm_library import get_arm
from ves_gym.mechanics.pointing import allocated, wrench_matrix
from ves_gym.mechanics.vehicle import SERVICER_FLEXIBLE
from ves_gym.system.system import System

pytestmark = pytest.mark.slow
SECONDS = 8.0


def row(body):
    return np.concatenate([[body.mass], body.com, np.ravel(body.inertia)])


def physics(system):
    """The servicer and its arm as rows of numbers, see basilisk_servicer.py."""
    vehicle, arm = system.vehicle, system.arm
    hinges = [k for k in vehicle.appendages if k.joint == "hinge"]
    slides = [k for k in vehicle.appendages if k.joint == "slide"]
    links = [
        np.concatenate([R.ravel(), p, row(link.inertial_at_joint)])
        for (R, p), link in zip(arm.placements, arm.links, strict=False)
    ]
    return {
        "hub": [row(vehicle.body), row(arm.base)],
        "links": links,
        "wheels": [[*k.axis, k.inertia, k.viscous, k.coulomb] for k in vehicle.wheels],
        "panels": [[*k.point, *k.axis, k.stiffness, k.damping, *row(k.body)] for k in hinges],
        "slosh": [[*k.axis, k.body.mass, *k.body.com, k.stiffness, k.damping] for k in slides],
        "jets": [[*k.position, *k.direction, k.thrust] for k in vehicle.jets],
    }


def test_a_servicer_that_acts_while_its_arm_moves(foreign):
    """Tolerance: 1e-6 of the largest entry of each kind."""
    vehicle = replace(SERVICER_FLEXIBLE, pointing=None)
    system = System(arm=get_arm("ur5e"), vehicle=vehicle)
    count = round(SECONDS / system.control_dt)
    time = np.arange(count) * system.control_dt
    torque = np.array([0.1, -0.05, 0.08, 0.15]) * np.sin(0.9 * time)[:, None] + 0.02
    speeds = np.array([100.0, -120.0, 80.0, 150.0])  # rad/s, far from where they would stick
    on = np.zeros((count, len(vehicle.jets)), bool)
    on[80:160, [0, 1]] = True  # a force along x, 1 s
    on[320:360, [4, 7]] = True  # a couple, 0.5 s
    thrust = np.array([k.thrust for k in vehicle.jets])
    wrench = (thrust * on) @ wrench_matrix(vehicle.jets).T
    np.testing.assert_allclose(allocated(vehicle.jets, wrench), thrust * on, atol=1e-2)
    loop, ours = servo_loop(
        system,
        SECONDS,
        lambda k: {"base_wrench": wrench[k], "wheel_torque": torque[k]},
        wheel_speed=speeds,
    )
    theirs = foreign(
        "basilisk",
        "basilisk_servicer",
        **physics(system),
        **loop,
        wheel_torque=torque,
        on=on,
        wheel_speed=speeds,
    )["path"]
    kinds = {"joints": 6, "position": 3, "quaternion": 4, "wheels": 4, "arrays": 2, "slosh": 2}
    ends = np.cumsum(list(kinds.values()))
    for name, a, b in zip(
        kinds, np.split(theirs, ends, 1), np.split(ours, ends, 1), strict=False
    ):
        print(f"{name}: {difference(a, b):.1e}")
        assert difference(a, b) < 1e-6
