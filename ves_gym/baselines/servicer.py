"""A servicer that catches a tumbling target: computed torque, wheels, and jets for the rest."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from ves_gym._util.params import Array, Index
from ves_gym.baselines.controllers import remember, require_fit, torque_action
from ves_gym.baselines.resolved import damped_inverse
from ves_gym.envs.control import Acceleration, Torque, guided
from ves_gym.envs.servicer_capture import ServicerCapture, meeting
from ves_gym.envs.vector import VesVectorEnv
from ves_gym.mechanics.attitude import IDENTITY, from_angles, to_matrix
from ves_gym.mechanics.dynamics import inverse_dynamics
from ves_gym.mechanics.kinematics import tool_frame, tool_twists
from ves_gym.mechanics.latch import BODY, free_mass, named, to_point, tool_motion
from ves_gym.mechanics.pointing import AttitudeControl, wheel_axes, wheel_torques, within_limits
from ves_gym.mechanics.spatial import matvec, rotation, twist
from ves_gym.simulation.capture import fly

_HORIZON = 0.6  # s: how far ahead a fixture is aimed at when its meeting is due
_FLIGHT = 2.0  # s, step of the target's flight that is foreseen
_ROUNDS = 2  # of Newton's method per period
_DAMPING = 0.02  # m/rad, of the least squares near singular configurations
_STIFF = 5.0, 2.0  # rad/s of the joints' error, before the capture and after it
_FADE = 5.0  # s in which the joints stop after the capture
_LAW = AttitudeControl(bandwidth=0.03, damping_ratio=0.9, spin_max=0.03, moment_max=12.0)
_IDLE = 0.3  # N m left to the wheels: only what is asked beyond it is worth a pulse


class Servicer:
    """Meets the fixture where the episode was drawn, and takes the tumble over.

    Reads the true state, the target's mass and inertia included. Before the capture the joints
    follow the quintic from where they are led to the configuration that meets the fixture as it
    will be (torque-free flight), on the base as it will be (momentum of what the arm has
    still to do), moving with it; it is made anew in every period. After it the joints fade
    to rest. Either way the torque is that of the desired acceleration with the inertia of arm,
    floating base and target. The base is turned back by a quaternion law with the inertia of
    everything: wheels first, jets what wheels cannot.
    """

    name = "servicer"
    privileged = True
    _led: Array  # (n, 3, joints) angles, rates, accelerations wanted
    _fades: Array  # (n,) s since the capture, negative before
    _caught: Array  # (n, joints) rates at the capture

    def reset(self, env: VesVectorEnv, ids: Index) -> None:
        s, fits = env.batch.scene, isinstance(env.task, ServicerCapture)
        require_fit(
            self.name,
            fits and isinstance(env.task.control, (Acceleration, Torque)),
            "acts on task servicer_capture through control acceleration or torque",
            env,
        )
        n, joints = s.q.shape
        remember(self, n, _led=(3, joints), _caught=(joints,), _fades=())
        self._led[ids, 0], self._led[ids, 1:] = s.q[ids], 0.0
        self._fades[ids] = -1.0

    def act(self, env: VesVectorEnv, observation: Any) -> Array:
        s, dt = env.batch.scene, env.batch.dt
        cargo = env.batch.sim.payload
        assert cargo is not None
        begun = cargo.carried & (self._fades < 0)
        self._caught[begun] = s.v[begun]
        self._led[begun, 0], self._led[begun, 1] = s.q[begun], s.v[begun]
        self._fades[begun] = 0.0
        self._fades[cargo.carried] += dt
        masses = _masses(env)
        free, carrying = np.flatnonzero(~cargo.carried), np.flatnonzero(cargo.carried)
        if len(free):
            self._lead(env, free, masses.arm[free])
        if len(carrying):
            x = np.minimum(self._fades[carrying] / _FADE, 1.0)[:, None]
            rate = self._caught[carrying] * (1 - x**3 * (10 - 15 * x + 6 * x * x))
            slope = -self._caught[carrying] * (30 * x * x * (1 - x) ** 2) / _FADE
            self._led[carrying, 0] += dt * (self._led[carrying, 1] + rate) / 2
            self._led[carrying, 1], self._led[carrying, 2] = rate, slope
        joints = self._joint_action(env, masses)
        if env.task.base_control is None:  # the vehicle points by itself
            return joints
        return np.concatenate([joints, _base_action(env, masses.all)], axis=1)

    def _lead(self, env: VesVectorEnv, ids: Index, mass: Array) -> None:
        """Move what is wanted of the joints on by a period, towards the meeting."""
        s, task, dt = env.batch.scene, env.task, env.batch.dt
        assert isinstance(task, ServicerCapture)
        arm, n = task.system.arm, task.system.arm.n
        angles, clock = meeting(s, n)
        horizon = np.maximum(clock[ids] - s.time[ids], _HORIZON)
        place, turn, motion = _fixture_after(env, ids, horizon)
        led = self._led[ids]
        early = (horizon > _HORIZON)[:, None]
        q = np.where(early, angles[ids], led[:, 0])  # of a meeting that is due: those of now
        # twist of the base per joint rate, appendages locked
        moved: Array = -np.linalg.solve(mass[:, :6, :6], mass[:, :6, 6 : 6 + n]).astype(float)
        y, Y = s.y[ids], twist(s.y[ids], s.yd[ids])
        for _ in range(_ROUNDS):
            shift = matvec(moved, q - s.q[ids])  # of the base until then, its axes
            base_turn = rotation(y) @ Rotation.from_rotvec(shift[:, 3:]).as_matrix()
            base = y[:, :3] + matvec(rotation(y), shift[:, :3])
            back = np.swapaxes(base_turn, -1, -2)
            at, turned = tool_frame(arm, q)
            missing = back @ turn @ np.swapaxes(turned, -1, -2)
            error = [matvec(back, place - base) - at, Rotation.from_matrix(missing).as_rotvec()]
            J = tool_twists(arm, q) + _lifted(at) @ moved  # with the base that gives way
            q = q + matvec(damped_inverse(J, _DAMPING), np.concatenate(error, axis=1))
        desired = np.concatenate([matvec(back, motion[:, :3]), matvec(back, motion[:, 3:])], 1)
        residual = Y - matvec(moved, s.v[ids])  # what the base does besides the arm's momentum
        v = matvec(damped_inverse(J, _DAMPING), desired - matvec(_lifted(at), residual))
        self._led[ids] = guided(led, q, horizon, dt, v)

    def _joint_action(self, env: VesVectorEnv, masses: Masses) -> Array:
        """(n, joints) that give the torque which the wanted motion takes."""
        s, task, dt = env.batch.scene, env.task, env.batch.dt
        arm, control = task.system.arm, task.control
        q, v, a = self._led.swapaxes(0, 1)
        w = np.where(self._fades < 0, *_STIFF)[:, None]
        desired: Array = a + 2 * w * (v - s.v) + w * w * (q - s.q - dt * s.v)
        mass, joints = masses.all, slice(6, 6 + arm.n)
        joint_mass, base, across = mass[:, joints, joints], mass[:, :6, :6], mass[:, :6, joints]
        joint_mass = joint_mass - np.swapaxes(across, -1, -2) @ np.linalg.solve(base, across)
        most = 0.9 * arm.column("tau_max")
        tau: Array = np.clip(matvec(joint_mass, desired), -most, most)
        if isinstance(control, Torque):
            tau = tau + inverse_dynamics(arm, s.q, s.v, np.zeros_like(v))[0]
            return torque_action(env, control, tau)
        return _acceleration_for(env, tau, masses.arm[:, joints, joints])


def _acceleration_for(env: VesVectorEnv, tau: Array, M: Array) -> Array:
    """Actions whose moved reference makes the servos give a torque at the period's end.

    With the acceleration a there, angle and rate of the reference are linear in a, and so is
    the torque kp (angle - q) + kd (rate - v) + M a beside what the rates take; M (n, joints,
    joints) is the inertia that the feed-forward knows.
    """
    s, control, dt = env.batch.scene, env.task.control, env.batch.dt
    arm = env.task.system.arm
    assert isinstance(control, Acceleration)
    q, v, a = s.ref.swapaxes(0, 1)
    angle, rate = q + dt * v + dt * dt / 3 * a, v + dt / 2 * a  # with a = 0 there
    gain = (s.kp * dt * dt / 6 + s.kd * dt / 2)[..., None] * np.eye(arm.n) + M
    servo_torque = s.kp * (angle - s.q - dt * s.v) + s.kd * (rate - s.v)
    desired = np.linalg.solve(gain, (tau - servo_torque)[..., None])[..., 0]
    return np.clip(desired / control.limits(arm), -1.0, 1.0)


def _base_action(env: VesVectorEnv, mass: Array) -> Array:
    """(n, k) torques of the wheels and wrench of the jets that turn the base back."""
    s, task, sim = env.batch.scene, env.task, env.batch.sim
    control, acts = task.base_control, sim.base_actuators
    assert control is not None and acts is not None
    total, first = mass[:, 0, 0], mass[:, 3:6, :3]
    J = mass[:, 3:6, 3:6] + first @ first / total[:, None, None]
    axes, speed = wheel_axes(acts.wheels), sim.wheel_speed
    stored = (speed * acts.rotors) @ axes.T
    attitude, spin = from_angles(s.y[:, 3:]), twist(s.y, s.yd)[:, 3:]
    target = np.tile(IDENTITY, (len(J), 1))
    moment = _LAW.moment(J, target, attitude, spin, stored)
    out = np.zeros((len(J), control.width(task.system)))
    w = len(acts.wheels) if control.wheels else 0
    remainder = moment
    if w:
        torque = within_limits(
            acts.wheels, wheel_torques(acts.wheels, moment), speed, env.batch.dt
        )
        out[:, :w] = torque
        remainder = moment + torque @ axes.T
    if control.jets:
        size = np.linalg.norm(remainder, axis=1, keepdims=True)
        out[:, w + 3 :] = remainder * np.maximum(1 - _IDLE / np.maximum(size, _IDLE), 0.0)
    return np.clip(out / control.scale(task.system), -1.0, 1.0)


class Masses(NamedTuple):
    """Inertia (n, N, N) of base, arm and what the base carries."""

    arm: Array  # the hand empty
    all: Array  # with the target where it is carried


def _masses(env: VesVectorEnv) -> Masses:
    s, sim, system = env.batch.scene, env.batch.sim, env.task.system
    motion = tool_motion(system.arm, system.base, s.y, s.q, sim.internal_state[0])
    cargo, mass = sim.payload, motion.mass.copy()
    assert cargo is not None
    carrying = np.flatnonzero(cargo.carried)
    if len(carrying):
        t = cargo.target(carrying)
        body = free_mass(cargo.mass[carrying], cargo.inertia[carrying], t.turn)
        J = np.linalg.solve(to_point(t.centre, motion.place[carrying]), motion.J[carrying])
        mass[carrying] += np.swapaxes(J, -1, -2) @ body @ J
    return Masses(motion.mass, mass)


def _fixture_after(env: VesVectorEnv, ids: Index, time: Array) -> tuple[Array, Array, Array]:
    """Place (k, 3), axes (k, 3, 3) and twist (k, 6) of free fixtures, `time` (k,) from now."""
    cargo, payload = env.batch.sim.payload, env.task.system.payload
    assert cargo is not None and payload is not None
    count, com = int(np.ceil(time.max() / _FLIGHT)), cargo.com[ids]
    steps = np.repeat(time[:, None] / count, count, axis=1)
    body = named(fly(cargo.rows(BODY)[ids], com, cargo.inertia[ids], steps), BODY)
    turn, grip = to_matrix(body["attitude"]), np.array(payload.grip.position)
    arm, spin = matvec(turn, grip - com), matvec(turn, body["spin"])
    motion = np.concatenate([body["velocity"] + np.cross(spin, arm), spin], axis=1)
    return body["position"] + matvec(turn, grip), turn @ payload.grip.rotation, motion


def _lifted(place: Array) -> Array:
    """(k, 6, 6) from the twist of the base to that of its point at a place (k, 3)."""
    return to_point(np.zeros_like(place), place)
