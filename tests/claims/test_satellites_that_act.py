"""Claim: wheels, jets and appendages move a satellite as MuJoCo's own bodies do.

Besides the engine `mujoco`, whose base has the six axes of ours, a model written down here: a
free joint (MuJoCo's own quaternion), wheels as heavy rotors on hinges beside the centre, their
mass taken out of the satellite's body. Nothing of ours made it but the numbers.
"""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from tests.free_bodies import NO_ARM, TARGET, momentum
from ves_gym._util.params import ParameterError
from ves_gym.engine.backends.mujoco import compile_model
from ves_gym.engine.mjcf import TO_Y
from ves_gym.mechanics import attitude
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.spatial import rotation
from ves_gym.mechanics.vehicle import SERVICER, SERVICER_FLEXIBLE, Satellite, get_vehicle
from ves_gym.simulation.playback import play_motions
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.energy_balance import EnergyBalance
from ves_gym.system.runlog import RunLog
from ves_gym.system.system import System

FREE = replace(SERVICER_FLEXIBLE, pointing=None)
TUMBLING = np.array([0.1, 0.0, 0.02, 0.2, 1.5, 0.1])
MOTION = Motion.straight(np.deg2rad([-40, -20, 0]), np.deg2rad([-32, -14, -5]), 0.5)
SPEEDS = [100.0, -50.0, 30.0, 200.0]


def test_the_engines_agree_with_wheels_jets_and_appendages():
    """2 s of random torques, wrenches and wheels while the base tumbles at 1.5 rad/s."""
    ends = []
    for backend in ("kernel", "mujoco"):
        rng, sim = np.random.default_rng(0), Simulator(System(vehicle=FREE), backend=backend)
        sim.reset(q=[0, 0.5, -1], yd=TUMBLING, wheel_speed=SPEEDS)
        for _ in range(160):
            sim.step(
                rng.normal(0, 10, 3),
                base_wrench=rng.normal(0, 5, 6),
                wheel_torque=rng.normal(0, 0.2, 4),
            )
        acts = sim.base_actuators
        ends.append([*sim.state, *sim.internal_state, *sim.evaluate(0.0), acts.propellant])
    assert ends[0][-1] > 0
    worst = max(
        np.abs(a - b).max() / max(np.abs(b).max(), 1) for a, b in zip(*ends, strict=True)
    )
    print(f"kernel against mujoco: {worst:.1e}")
    assert worst <= 1e-9


def free_joint_model(vehicle, dt):
    """The satellite on a free joint; its wheels as 3 kg rotors 0.2 m from the origin."""
    mass, J = vehicle.body.mass, np.array(vehicle.body.inertia)
    com, rotors = np.array(vehicle.body.com), []
    first, second = mass * com, J + mass * (com @ com * np.eye(3) - np.outer(com, com))
    for wheel in vehicle.wheels:
        a = np.array(wheel.axis)
        at, m = 0.2 * a, 3.0
        I = 0.7 * wheel.inertia * (np.eye(3) - np.outer(a, a)) + wheel.inertia * np.outer(a, a)
        rotors.append((a, at, m, I))
        mass, first = mass - m, first - m * at
        second = second - I - m * (at @ at * np.eye(3) - np.outer(at, at))
    centre = first / mass
    second = second - mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))

    def text(values):
        return " ".join(f"{k:.17g}" for k in values)

    def full(I):
        return text([I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]])

    wheels = "".join(
        f'<body pos="{text(at)}"><inertial pos="0 0 0" mass="{m}" fullinertia="{full(I)}"/>'
        f'<joint type="hinge" axis="{text(a)}" damping="{w.viscous}"/></body>'
        for (a, at, m, I), w in zip(rotors, vehicle.wheels, strict=True)
    )
    hinge = ""
    for k in vehicle.appendages or ():
        body = f'pos="{text(k.body.com)}" mass="{k.body.mass}"'
        I = np.array(k.body.inertia) + 1e-12 * np.eye(3)
        hinge += (
            f'<body><inertial {body} fullinertia="{full(I)}"/><joint type="{k.joint}"'
            f' axis="{text(k.axis)}" pos="{text(k.point)}" stiffness="{k.stiffness}"'
            f' damping="{k.damping}"/></body>'
        )
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/><option timestep="{dt}" integrator="RK4"'
        ' gravity="0 0 0"/><worldbody><body><freejoint/>'
        f'<inertial pos="{text(centre)}" mass="{mass:.17g}" fullinertia="{full(second)}"/>'
        f"{wheels}{hinge}</body></worldbody></mujoco>"
    )


def test_a_free_joint_with_heavy_rotors_moves_alike():
    """10 s, wheels driven and spun up, panels and slosh excited: attitude, place, speeds."""
    h = 2.5e-3
    wheels = tuple(replace(k, coulomb=0.0) for k in FREE.wheels)
    vehicle = replace(FREE, wheels=wheels, jets=None)
    system = System(arm=NO_ARM, vehicle=vehicle, physics_dt=h, control_dt=0.025)
    sim = Simulator(system)
    w0 = np.array([0.3, 0.8, -0.2])
    sim.reset(yd=np.r_[0, 0, 0, w0], wheel_speed=SPEEDS)
    model = free_joint_model(vehicle, h)
    data = mujoco.MjData(model)
    data.qvel[3:6], data.qvel[6:10] = w0, SPEEDS  # a free joint turns in body axes
    torque = np.array([0.1, -0.05, 0.15, -0.2])
    for k in range(400):
        push = torque * np.cos(0.3 * k)
        state = sim.step(wheel_torque=push)
        data.qfrc_applied[6:10] = push
        for _ in range(10):
            mujoco.mj_step(model, data)
    apart = np.abs(attitude.difference(data.qpos[3:7], state.attitude[0])).max()
    away = np.abs(data.qpos[:3] - state.y[0, :3]).max()
    at, rate = sim.internal_state
    hidden = np.abs(data.qpos[11:] - at[0, 4:]).max(), np.abs(data.qvel[6:] - rate[0]).max()
    print(f"free joint: {apart:.1e} rad, {away:.1e} m, {hidden[0]:.1e}, {hidden[1]:.1e} rad/s")
    assert np.abs(at[0, 4:]).max() > 1e-3  # they did move
    assert max(apart, away, *hidden) <= 1e-9


def test_momentum_and_energy_without_jets():
    """Tumbling, arm and wheels driven: momentum stays, the account of energy closes."""
    system = System(vehicle=replace(SERVICER_FLEXIBLE, jets=None))
    run = play_motions(system, [MOTION], settle=0.05, record_dt=1.25e-3, yd=TUMBLING)
    held = run.internal(0)
    h = momentum(system, run.q[0], run.v[0], run.y[0], run.yd[0], held)
    drift = np.abs(h - h[0]).max() / np.abs(h).max()
    balance = EnergyBalance.of(run.log(0))
    print(f"momentum {drift:.1e}, energy {balance.relative:.1e}")
    assert np.abs(run.motor).max() > 0.19  # the wheels give all they can
    assert drift <= 1e-9
    assert balance.relative <= 1e-8


def test_jets_change_momentum_by_their_impulse_and_the_account_closes():
    system = System(vehicle=SERVICER_FLEXIBLE)
    run = play_motions(system, [MOTION], settle=0.05, record_dt=1.25e-3, yd=TUMBLING / 3)
    h = momentum(system, run.q[0], run.v[0], run.y[0], run.yd[0], run.internal(0))
    R = rotation(run.log(0).y)
    force = np.einsum("nij,nj->ni", R, run.jet[0, :, :3])
    arm = np.einsum("nij,nj->ni", R, run.jet[0, :, 3:]) + np.cross(run.y[0, :, :3], force)
    # turning wrenches, one period of 10 steps at a time: Simpson's rule would see their jumps
    turned = [
        np.trapezoid(part, dx=1.25e-3, axis=0)
        for part in (force[k : k + 11] for k in range(0, len(force) - 1, 10))
    ]
    held = np.repeat(run.jet[0, ::10], 10, axis=0)[: len(R)]
    assert np.abs(held[: len(run.jet[0])] - run.jet[0]).max() == 0  # held through periods
    assert np.abs(h[-1, 3:] - h[0, 3:]).max() > 1.0
    np.testing.assert_allclose(np.sum(turned, axis=0), h[-1, :3] - h[0, :3], atol=0.02)
    impulse = np.trapezoid(arm, dx=1.25e-3, axis=0)
    np.testing.assert_allclose(impulse, h[-1, 3:] - h[0, 3:], rtol=0.05, atol=0.1)
    balance = EnergyBalance.of(run.log(0))
    print(f"energy with jets {balance.relative:.1e}")
    assert balance.relative <= 1e-6
    assert (np.diff(run.propellant[0, :, 0]) >= 0).all()


def test_a_wheel_stops_at_its_momentum_limit():
    """Full torque for 2 s ends at the limit; with less the wheel does not get there."""
    slow = tuple(replace(k, momentum_max=0.2, coulomb=0.0, viscous=0.0) for k in FREE.wheels)
    system = System(arm=NO_ARM, vehicle=replace(FREE, wheels=slow, appendages=None))
    for torque, ends in ((0.2, 10.0), (0.09, 9.0)):
        sim = Simulator(system)
        for _ in range(160):
            sim.step(wheel_torque=[torque, 0, 0, 0])
        assert sim.wheel_speed[0, 0] == pytest.approx(ends, rel=2e-3)


def test_pointing_turns_to_a_target_and_stays():
    sim = Simulator(System(vehicle=SERVICER, control_dt=0.05, physics_dt=5e-3), 2)
    state = sim.reset(q=[0, 0.5, -1])
    hold = sim.servo_command(state.q, 0 * state.q)
    targets = attitude.exp([[0.1, -0.05, 0.08], [0.0, 0.0, 0.0]])
    sim.point(targets)
    for _ in range(1200):
        state = sim.step(hold)
    error = np.linalg.norm(attitude.difference(targets, state.attitude), axis=1)
    assert error[0] < 1e-3
    assert error[1] < 1e-6
    assert sim.base_actuators.propellant[1] == 0


def test_jets_unload_wheels_that_store_too_much():
    """Wheels at 0.9 of their momentum: below 0.3 after 60 s, the attitude held; not at 0.6."""
    system = System(vehicle=SERVICER, control_dt=0.05, physics_dt=5e-3)
    sim = Simulator(system, 2)
    full = SERVICER.wheels[0].speed_max
    sim.reset(q=[0, 0.5, -1], wheel_speed=[[0.9 * full] * 4, [0.6 * full] * 4])
    hold = sim.servo_command(sim.state.q, 0 * sim.state.q)
    for _ in range(1200):
        state = sim.step(hold)
    speeds = np.abs(sim.wheel_speed) / full
    assert speeds[0].max() < 0.32
    assert speeds[1].min() > 0.5
    assert sim.base_actuators.propellant[0] > 1e-3
    assert sim.base_actuators.propellant[1] == 0
    assert np.linalg.norm(attitude.log(state.attitude), axis=1).max() < np.deg2rad(0.5)


def test_wheels_and_appendages_take_their_share_of_a_latch():
    """Reference: MuJoCo's mass matrix and tool Jacobian, M (v+ - v-) = -J^T p in every row."""
    ends = []
    for backend in ("kernel", "mujoco"):
        sim = Simulator(System(vehicle=FREE, payload=TARGET), backend=backend)
        sim.reset(q=[0, 0.5, -1], v=[0.2, -0.1, 0.3], yd=TUMBLING / 10, wheel_speed=SPEEDS)
        sim.step(wheel_torque=0.1)
        before, total = (sim.state, sim.internal_state[1]), sim.payload.momentum
        event = sim.payload.grasp()[0]
        after = sim.state, sim.internal_state[1]
        np.testing.assert_allclose(sim.payload.momentum, total, rtol=0, atol=1e-9)
        model = compile_model(sim.system)
        data = mujoco.MjData(model)
        data.qpos[TO_Y], data.qpos[6:9] = after[0].y[0], after[0].q[0]
        data.qpos[9:] = sim.internal_state[0][0]
        mujoco.mj_forward(model, data)
        mass, jump = np.zeros((model.nv, model.nv)), np.zeros(model.nv)
        mujoco.mj_fullM(model, data, mass)
        jump[TO_Y] = (after[0].yd - before[0].yd)[0]
        jump[6:9], jump[9:] = (after[0].v - before[0].v)[0], (after[1] - before[1])[0]
        jacobian = np.zeros((6, model.nv))
        mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], model.site("tool").id)
        np.testing.assert_allclose(mass @ jump, -jacobian.T @ event.impulse, atol=1e-9)
        assert np.abs(jump[9:]).max() > 1e-3  # they do take some
        assert event.lost > 0
        for _ in range(40):
            sim.step(wheel_torque=0.1, base_wrench=[1.0, 0, 0, 0, 2.0, 0])
        ends.append([*sim.state, *sim.internal_state])
    for a, b in zip(*ends, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9)


def test_a_snapshot_holds_wheels_and_jets():
    sim = Simulator(System(vehicle=SERVICER_FLEXIBLE), 2)
    sim.reset(q=[0, 0.5, -1], yd=[TUMBLING / 5, 0 * TUMBLING], wheel_speed=SPEEDS)
    for _ in range(7):
        sim.step()
    taken = sim.snapshot()
    first = sim.step()
    sim.reset()
    sim.restore(taken)
    again = sim.step()
    for a, b in zip(first, again, strict=True):
        np.testing.assert_array_equal(a, b)
    assert sim.base_actuators.propellant[0] > 0


def test_what_does_not_fit_is_refused(tmp_path):
    sim = Simulator(System(vehicle=SERVICER))
    plain = Simulator(System(vehicle=Satellite(body=SERVICER.body)))
    for call, message in (
        (lambda: sim.step(wheel_torque=0.1), "pointing commands wheels and jets"),
        (lambda: sim.point([1.0, 1.0, 0.0, 0.0]), "unit quaternions"),
        (lambda: plain.step(wheel_torque=0.1), "needs a vehicle with reaction wheels"),
        (lambda: plain.reset(wheel_speed=1.0), "needs a vehicle with reaction wheels"),
        (lambda: plain.step(base_wrench=np.zeros(6)), "a vehicle with thrusters or jets"),
        (lambda: plain.point([1.0, 0, 0, 0]), "point needs a satellite with pointing"),
        (lambda: System(vehicle=SERVICER, mode="emulated"), "emulated knows a satellite's"),
    ):
        with pytest.raises(ParameterError, match=message):
            call()
    SERVICER_FLEXIBLE.save(tmp_path / "servicer.toml")
    assert get_vehicle(tmp_path / "servicer.toml") == SERVICER_FLEXIBLE


def test_a_log_is_read_back_with_wheels_and_jets(tmp_path):
    run = play_motions(System(vehicle=SERVICER), [MOTION], settle=0.0, yd=TUMBLING / 10)
    log = run.log(0)
    log.save(tmp_path / "run.csv")
    again = RunLog.load(tmp_path / "run.csv")
    assert again.digest == log.digest
    assert again.motor.shape == (len(log.t), 4)
    assert EnergyBalance.of(again).relative == EnergyBalance.of(log).relative
