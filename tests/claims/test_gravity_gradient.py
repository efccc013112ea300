"""Claim: on an orbit satellites drift and turn as Clohessy, Wiltshire and Hughes say.

References: the drift of the centre of mass in closed form (Clohessy and Wiltshire 1960); the
pitch libration of a gravity-gradient stabilised body at n sqrt(3 (I_roll - I_yaw) / I_pitch)
(Hughes 1986, chapter 9); the forces on arm, wheels and appendages by differences of the
potential energy of all bodies as MuJoCo places them; the energy account with the gradient's
work. Basilisk's effector judges in tests/foreign.

Tolerances: 1e-7 of the drift over a third of an orbit, 1e-5 of the frequency (amplitude
1e-3 rad squared), 1e-7 of the forces (differences), 1e-6 of the account.
"""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

import ves_gym as vg
from ves_gym.engine.backends.kernel import KernelBackend
from ves_gym.engine.backends.mujoco import compile_model
from ves_gym.engine.mjcf import TO_Y
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.link import Inertial, diagonal
from ves_gym.mechanics.payload import Payload
from ves_gym.mechanics.spatial import rotation, twist
from ves_gym.mechanics.vehicle import FREE_FLOATING, SERVICER_FLEXIBLE, Orbit, Satellite
from ves_gym.simulation import machines
from ves_gym.simulation.playback import play_motions
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.system import System

ORBIT = Orbit(altitude=400e3, radial=(0.0, 0.0, 1.0), along=(1.0, 0.0, 0.0))


def on_orbit(vehicle: Satellite = FREE_FLOATING, orbit: Orbit = ORBIT, **changes) -> System:
    return System(vehicle=replace(vehicle, orbit=orbit), **changes)


def slow(vehicle: Satellite, dt: float, **changes) -> System:
    """Joints held, steps that suit an orbit."""
    return on_orbit(vehicle, drive="prescribed", physics_dt=dt, control_dt=dt, **changes)


def centre(system: System, state) -> tuple[np.ndarray, np.ndarray]:
    """Place and velocity of the centre of mass (3,) in space."""
    H = inertia(system.arm, state.q[0])[:6, :6] + system.base.rigid()
    c = np.array([H[5, 1], H[3, 2], H[4, 0]]) / H[0, 0]
    R, v = rotation(state.y)[0], twist(state.y, state.yd)[0]
    return state.y[0, :3] + R @ c, R @ (v[:3] + np.cross(v[3:], c))


def clohessy_wiltshire(n: float, t: float, x: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Radial, along-track and cross-track place (3,) of a point after t, in turning axes."""
    s, c = np.sin(n * t), np.cos(n * t)
    return np.array(
        [
            (4 - 3 * c) * x[0] + s / n * v[0] + 2 / n * (1 - c) * v[1],
            6 * (s - n * t) * x[0]
            + x[1]
            - 2 / n * (1 - c) * v[0]
            + (4 * s - 3 * n * t) / n * v[1],
            c * x[2] + s / n * v[2],
        ]
    )


def test_a_point_drifts_as_clohessy_and_wiltshire_say():
    system = slow(FREE_FLOATING, 0.5)
    n, sim = ORBIT.rate, Simulator(system)
    axes = np.array([ORBIT.radial, ORBIT.along, np.cross(ORBIT.radial, ORBIT.along)])
    sim.reset(y=[3.0, -5.0, 8.0, 0.2, 0.1, -0.3], yd=[0.01, -0.005, 0.02, 0.001, 0.002, 0.0])
    x, v = (axes @ k for k in centre(system, sim.state))
    v = v - np.cross([0, 0, n], x)  # as the turning axes see it
    for _ in range(3600):
        sim.step()
    t = float(sim.state.time[0])
    turn = np.array(
        [[np.cos(n * t), np.sin(n * t), 0], [-np.sin(n * t), np.cos(n * t), 0], [0, 0, 1]]
    )
    found = turn @ axes @ centre(system, sim.state)[0]
    expected = clohessy_wiltshire(n, t, x, v)
    assert np.abs(expected - x).max() > 10.0  # it drifted
    assert np.abs(found - expected).max() <= 1e-7 * np.abs(expected).max()


def test_a_stabilised_body_librates_at_the_published_frequency():
    """Roll axis along the orbit, pitch across it, yaw towards the Earth; a weightless arm."""
    roll, pitch, yaw = 900.0, 1000.0, 300.0
    links = tuple(
        replace(k, inertial=scaled(k.inertial), rotor_inertia=0.0) for k in PUMA_560.links
    )
    arm = replace(PUMA_560, links=links, base=scaled(PUMA_560.base))
    body = Inertial(mass=500.0, com=(0.0, 0.0, 0.0), inertia=diagonal(roll, pitch, yaw))
    system = slow(Satellite(body=body), 0.25, arm=arm)
    n, sim, size = ORBIT.rate, Simulator(system), 1e-3
    omega = n * np.sqrt(3 * (roll - yaw) / pitch)
    # the pitch axis is +y here, about which the orbit turns from +z to +x
    sim.reset(y=[0, 0, 0, 0, size, 0], yd=[0, 0, 0, 0, n, 0])
    for k in range(8000):
        state = sim.step()
        if k % 1000 == 999:
            t = float(state.time[0])
            attitude = rotation(state.y)[0]
            angle = np.arctan2(attitude[0, 2], attitude[2, 2]) - n * t
            angle = (angle + np.pi) % (2 * np.pi) - np.pi
            assert angle == pytest.approx(size * np.cos(omega * t), abs=1e-5 * size)


def scaled(body: Inertial) -> Inertial:
    """A body without weight to speak of."""
    moments = np.array(body.inertia) * 1e-9
    return replace(body, mass=body.mass * 1e-9, inertia=tuple(map(tuple, moments.tolist())))


def potential(system: System, model: mujoco.MjModel, z: np.ndarray, time: float) -> float:
    """Of the gravity gradient [J], bodies where MuJoCo has them."""
    orbit = system.vehicle.orbit
    data = mujoco.MjData(model)
    data.qpos[:] = z
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    up = orbit.up(np.array(time))
    G = orbit.rate**2 * (3 * np.outer(up, up) - np.eye(3))
    out = 0.0
    for i in range(1, model.nbody):
        x, R = data.xipos[i], data.ximat[i].reshape(3, 3)
        moments = R @ np.diag(model.body_inertia[i]) @ R.T
        second = np.trace(moments) / 2 * np.eye(3) - moments
        out -= 0.5 * (model.body_mass[i] * x @ G @ x + np.trace(G @ second))
    return out


def test_forces_are_those_of_the_potential():
    """A bare arm on a satellite with wheels, arrays and slosh: what the gradient adds."""
    quiet = replace(SERVICER_FLEXIBLE, pointing=None, jets=None)
    system, plain = on_orbit(quiet), System(vehicle=quiet)
    rng, k = np.random.default_rng(0), len(quiet.base_model().carried)
    z = rng.uniform(-0.4, 0.4, 9 + k)
    z[:3] *= 20
    engine, time = KernelBackend(system, 1, 1), 700.0
    at = np.r_[z[TO_Y], z[6:]]
    x = np.r_[at, 0 * at][None]
    engine.set_tide(np.arange(1), ORBIT.up(np.array([time])), np.zeros((1, 3)))
    engine._put(np.arange(1), slice(0, x.shape[1]), x)
    other = KernelBackend(plain, 1, 1)
    other._put(np.arange(1), slice(0, x.shape[1]), x)
    gained = [b.evaluate(np.zeros((1, 3)))[1][0] for b in (engine, other)]
    model = compile_model(plain)
    data = mujoco.MjData(model)
    data.qpos[:] = z
    mujoco.mj_forward(model, data)
    M = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, M)
    force = np.array(
        [
            -(potential(system, model, z + d, time) - potential(system, model, z - d, time))
            / 2e-4
            for d in 1e-4 * np.eye(len(z))
        ]
    )
    expected = np.linalg.solve(M, force)
    expected = np.r_[expected[TO_Y], expected[6:9]]
    size = np.abs(expected).max()
    assert np.abs(gained[0] - gained[1] - expected).max() <= 1e-7 * size
    assert size > 1e-6


def test_the_energy_account_closes():
    motion = vg.Motion.straight([0, 0, 0], [0.6, -0.4, 0.5], 8.0)
    for orbit in (ORBIT, replace(ORBIT, altitude=None, mean_motion=0.05)):
        vehicle = replace(SERVICER_FLEXIBLE, pointing=None, jets=None, orbit=orbit)
        system = System(vehicle=vehicle)
        run = play_motions(system, [motion], settle=10.0, record_dt=system.physics_dt)
        log = run.log(0)
        assert vg.EnergyBalance.of(log).relative <= 1e-6


def test_it_is_the_same_in_another_chart(monkeypatch):
    """A body that tumbles past 0.5 rad, integrated in the world and in frames of its own."""
    poses = []
    for leave in (1.5, 0.5):
        monkeypatch.setattr(machines, "LEAVE", leave)
        sim = Simulator(on_orbit(orbit=Orbit(mean_motion=0.05)))
        sim.reset(y=[5, 3, 1, 0, 1.2, 0], yd=[0, 0, 0, 0.1, 0.3, 0])
        for _ in range(60):
            state = sim.step()
        poses.append(np.r_[state.y[0], state.q[0]])
        assert sim.machines.charts.elsewhere[0] == (leave < 1)
    np.testing.assert_allclose(*poses, atol=1e-10)


def test_a_plan_says_that_it_is_left_out():
    plan = vg.plan(
        [0, 0, 0], [0.3, -0.2, 0.2], duration=2.0, planner="straight", system=on_orbit()
    )
    assert any("gravity gradient" in note for note in plan.notes)
    plan = vg.plan(
        [0, 0, 0],
        [0.3, -0.2, 0.2],
        duration=2.0,
        planner="straight",
        system=System(vehicle=FREE_FLOATING),
    )
    assert not any("gravity" in note for note in plan.notes)


def test_what_an_orbit_refuses():
    with pytest.raises(vg.ParameterError, match="Orbit takes altitude"):
        Orbit()
    with pytest.raises(vg.ParameterError, match="square to radial"):
        Orbit(altitude=4e5, along=(1.0, 0.0, 0.0))
    with pytest.raises(vg.ParameterError, match="backend mujoco has no gravity gradient"):
        Simulator(on_orbit(), backend="mujoco")
    with pytest.raises(vg.ParameterError, match="not its orbit"):
        on_orbit(mode="emulated")
    with pytest.raises(vg.ParameterError, match="a free payload feels no gravity gradient"):
        on_orbit(payload=Payload(inertial=FREE_FLOATING.body))


def test_an_orbit_is_written_read_and_told(tmp_path):
    system = on_orbit()
    system.save(tmp_path / "system.toml")
    assert System.load(tmp_path / "system.toml") == system
    assert "orbit of 0.001131 rad/s (92.56 min)" in repr(system)
