"""Drake 1.51.1: arms with rotors, forward dynamics on a free base, closed loops."""

import contextlib
import dataclasses

import numpy as np
import pytest

from tests.foreign.conftest import difference
from ves_gym.mechanics.arm_files import ExportWarning
from ves_gym.mechanics.arm_library import get_arm
from ves_gym.mechanics.chain import Lump
from ves_gym.mechanics.dynamics import inertia, newton_euler
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.vehicle import FREE_FLOATING
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.system import System

pytestmark = pytest.mark.slow
SECONDS, START = 4.0, np.array([0.01, -0.02, 0.03, 0.02, -0.03, 0.05])  # s; m/s, rad/s


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


def closed_loop(arm):
    """The servo's gains and commands, and the path of joints, position and quaternion."""
    system = System(arm=arm, vehicle=FREE_FLOATING)
    sim = Simulator(system)
    low, high = arm.column("q_min"), arm.column("q_max")
    middle, reach = (low + high) / 2, np.minimum(0.4, (high - low) / 4)
    motion = Motion.straight(middle - reach, middle + reach, duration=SECONDS)
    times = np.arange(round(SECONDS / system.control_dt)) * system.control_dt
    wanted = motion.at(times)
    commands = sim.servo_command(wanted.q[None], wanted.v[None])[0]
    first = sim.reset(q=wanted.q[0], v=wanted.v[0], yd=START)
    out = []
    for command in commands:
        state = sim.step(command[None])
        out.append(np.concatenate([state.q[0], state.y[0, :3], state.attitude[0]]))
    return {
        "kp": sim.servo.kp, "kd": sim.servo.kd, "command": commands,
        "period": system.control_dt, "start_q": first.q[0],
        "start_u": np.concatenate([first.yd[0], first.v[0]]),
    }, np.array(out)  # fmt: skip


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
    loop, ours = closed_loop(arm)
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
