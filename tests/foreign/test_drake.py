"""Drake 1.51.1: arms with rotors, forward dynamics on a free base, closed loops."""

import contextlib
import dataclasses

import numpy as np
import pytest

from tests.foreign.conftest import difference
from tests.foreign.servo_loop import servo_loop
from ves_gym.mechanics.arm_files import ExportWarning
from ves_gym.mechanics.arm_library import get_arm
from ves_gym.mechanics.chain import Lump
from ves_gym.mechanics.dynamics import inertia, newton_euler
from ves_gym.mechanics.vehicle import FREE_FLOATING
from ves_gym.system.system import System

pytestmark = pytest.mark.slow


def merged(arm, body):
    """The arm whose base link is base and satellite together."""
    lump = Lump()
    lump.add_body(arm.base)
    lump.add_body(body)
    return dataclasses.replace(arm, base=lump.inertial(np.eye(3), np.zeros(3)))


def accelerations(arm, q, u, tau):
    """(6 + n,) of a free arm at attitude zero, in space: base linear, angular, joints."""
    still = {"spin": u[3:6], "turn": np.zeros(3), "accel": np.zeros(3)}
    efforts, wrench = newton_euler(arm, q, u[6:], 0 * q, **still)
    return np.linalg.solve(inertia(arm, q), np.concatenate([-wrench, tau - efforts]))


@pytest.mark.parametrize("name", ["puma560", "puma560-wrist", "ur5e", "iiwa14"])
def test_arms(foreign, tmp_path, name):
    """Tolerance 1e-6 of the largest entry; rounding for what is not integrated."""
    arm, body, rng = get_arm(name), FREE_FLOATING.body, np.random.default_rng(0)
    path = tmp_path / "arm.urdf"
    rotors = arm.column("rotor_inertia").any()
    with pytest.warns(ExportWarning) if rotors else contextlib.nullcontext():
        arm.to_urdf(path)
    q, tau = rng.uniform(-2, 2, (20, arm.n)), 10 * rng.normal(size=(20, arm.n))
    u = rng.normal(size=(20, 6 + arm.n))
    loop, ours = servo_loop(System(arm=arm, vehicle=FREE_FLOATING), seconds=4.0)
    theirs = foreign(
        "drake", "drake_arms", urdf=path.read_text(), mass=body.mass, com=body.com,
        inertia=body.inertia, q=q, u=u, tau=tau, **loop,
    )  # fmt: skip
    whole = merged(arm, body)
    expected = {
        "M": inertia(arm, q)[:, 6:, 6:],
        "a": np.array([accelerations(whole, *k) for k in zip(q, u, tau, strict=True)]),
        "path": ours,
    }
    for key, most in (("M", 1e-12), ("a", 1e-9), ("path", 1e-6)):
        found = difference(theirs[key], expected[key])
        print(f"{name} {key}: {found:.1e}")
        assert found < most
