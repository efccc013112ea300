"""Claim: joints that follow their command do so exactly, however heavy the arm is.

Canadarm2 with 20 t in its hand on a free-floating satellite, accelerations told anew every
0.1 s for 16 s. References: the joints' motion in closed form; the base's six coordinates by
SciPy's DOP853 of Pinocchio's equations with the joints' motion imposed; MuJoCo, whose joints
follow by an inertia of their own. Energy: what the drives give is the change of the kinetic
energy that Pinocchio finds.

Tolerances: 1e-12 rad for joints (rounding), 1e-11 of m and rad for the base,
1e-9 on MuJoCo. With 1e8 kg m^2 in place of the constraint the joints are off by 1e-3 rad.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp

from ves_gym.engine.mjcf import TO_Y
from ves_gym.mechanics.arm_files import pinocchio_model
from ves_gym.mechanics.arm_library import get_arm
from ves_gym.mechanics.dynamics import merged
from ves_gym.mechanics.link import Inertial, diagonal
from ves_gym.mechanics.payload import numbers_of
from ves_gym.mechanics.vehicle import Satellite
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.system import System

STEP, PERIODS = 0.1, 160


@cache
def system() -> System:
    """The arm with its load welded to the last link, on 50 t."""
    arm = get_arm("canadarm2")
    load = np.array(20e3), np.array([0.0, 0.0, 2.0]), 3e4 * np.eye(3)
    last = arm.links[-1]
    parts = [np.squeeze(k) for k in numbers_of(last.inertial)]
    mass, com, inertia = merged([parts, load])
    heavy = Inertial(
        mass=float(mass), com=tuple(com.tolist()), inertia=tuple(map(tuple, inertia.tolist()))
    )
    arm = replace(arm, links=(*arm.links[:-1], replace(last, inertial=heavy)))
    body = Inertial(mass=5e4, com=(0.0, 0.0, -2.0), inertia=diagonal(1e5, 2e5, 3e5))
    return System(
        arm=arm,
        vehicle=Satellite(body=body),
        drive="prescribed",
        physics_dt=0.0125,
        control_dt=STEP,
    )


@cache
def commands() -> np.ndarray:
    """(PERIODS, n) accelerations [rad/s^2]."""
    rng = np.random.default_rng(0)
    size, speed = rng.uniform(-0.02, 0.02, system().arm.n), 0.3
    return size * np.cos(speed * STEP * np.arange(PERIODS)[:, None])


def imposed() -> tuple[np.ndarray, np.ndarray]:
    """(PERIODS + 1, n) angles and rates of the joints, in closed form."""
    a = commands()
    v = STEP * np.vstack([0 * a[:1], np.cumsum(a, axis=0)])
    steps = STEP * v[:-1] + STEP**2 / 2 * a
    return np.vstack([0 * a[:1], np.cumsum(steps, axis=0)]), v


@cache
def simulated(backend: str):
    sim = Simulator(system(), backend=backend)
    sim.reset(q=np.zeros(system().arm.n))
    rows, power = [sim.state], []
    for a in commands():
        before = np.sum(sim.evaluate(a)[0] * sim.state.v)
        rows.append(sim.step(a))
        power.append((before, np.sum(sim.evaluate(a)[0] * rows[-1].v)))
    return rows, np.array(power)


@cache
def reference() -> np.ndarray:
    """(12,) Y and Y' of the base at the end, by Pinocchio and SciPy."""
    s, (q, v) = system(), imposed()
    model = pinocchio_model(s.arm, s.base)
    data = model.createData()
    state = np.zeros(12)
    for k, a in enumerate(commands()):

        def rate(t, x, k=k, a=a):
            z = np.r_[x[:6], q[k] + t * v[k] + t * t / 2 * a]
            zd = np.r_[x[6:], v[k] + t * a]
            M = pin.crba(model, data, z)
            M = np.triu(M) + np.triu(M, 1).T
            loads = -pin.nonLinearEffects(model, data, z, zd)[:6] - M[:6, 6:] @ a
            return np.r_[x[6:], np.linalg.solve(M[:6, :6], loads)]

        state = solve_ivp(rate, (0, STEP), state, "DOP853", rtol=1e-11, atol=1e-13).y[:, -1]
    return np.r_[state[:6][TO_Y], state[6:][TO_Y]]


def test_joints_go_where_they_are_told():
    rows, _ = simulated("kernel")
    q, v = imposed()
    for k, state in enumerate(rows):
        np.testing.assert_allclose(state.q[0], q[k], atol=1e-12)
        np.testing.assert_allclose(state.v[0], v[k], atol=1e-12)


@pytest.mark.parametrize(("backend", "most"), [("kernel", 1e-11), ("mujoco", 1e-9)])
def test_the_base_answers_as_another_program_says(backend, most):
    rows, _ = simulated(backend)
    found = np.r_[rows[-1].y[0], rows[-1].yd[0]]

    np.testing.assert_allclose(found, reference(), atol=most)
    assert np.abs(reference()[:6]).max() > 0.05  # it moved


def test_drives_do_the_work():
    """Tolerance: the trapezoid's, of a smooth power over steps of 0.1 s."""
    rows, power = simulated("kernel")
    model = pinocchio_model(system().arm, system().base)
    z, zd = (
        np.r_[parts[0][0][TO_Y], parts[1][0]]
        for parts in ((rows[-1].y, rows[-1].q), (rows[-1].yd, rows[-1].v))
    )
    kinetic = pin.computeKineticEnergy(model, model.createData(), z, zd)
    kinetic += 0.5 * np.sum(model.armature * zd**2)
    assert power.mean(axis=1).sum() * STEP == pytest.approx(kinetic, rel=2e-3)
    assert kinetic > 1.0
