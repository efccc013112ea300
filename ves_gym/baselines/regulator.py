"""Linear-quadratic regulator of base and joints with an observer and integral action."""

from __future__ import annotations

import numpy as np
import scipy.linalg

from ves_gym._util.params import Array, Index
from ves_gym.baselines.controllers import remember, require_fit, torque_action
from ves_gym.engine.linear import linearise_ideal
from ves_gym.envs.control import Torque
from ves_gym.envs.vector import VesVectorEnv
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.spatial import matvec
from ves_gym.system.system import System

# Standard deviations, this project: what the plant leaves out against what sensors do.
_ACCELERATION = 0.05, 0.5  # of base and joints, unknown, over root of a second [.. s^0.5]
_MODE = 1.0  # kg^0.5 m/s^1.5, the same of internal modes
_SEEN = 1e-4, 1e-4  # of pose and joint angles as measured [m, rad]
# Prices beside the base's energy: of joints away from home, of the integral of that, of torque
_STRAY, _DRIFT, _EFFORT = 5.0, 2.0, 1e-4


class Regulator:
    """Damps the base and holds the joints where the episode began, by linear state feedback.

    The plant is the nominal system linearised at the start of the episode. Feedback: least time
    integral of base energy + `_STRAY` |q - q0|^2 + `_DRIFT` |integral of (q - q0)|^2 +
    `_EFFORT` |tau|^2 (`envs.lqr.Lqr` is the same without drift, in closed form). State: a
    Kalman filter that sees the pose of the base and the joint angles as measured, and knows the
    torque that the motors give. The integral takes out what constant torques or forces that
    nobody knows of would leave of joint error.
    """

    name = "lqi"
    privileged = True
    # of each environment: home and the integral of what is left to it, state, torque; plant,
    # observer's gain, feedback
    _home: Array
    _summed: Array
    _state: Array
    _tau: Array
    _A: Array
    _B: Array
    _L: Array
    _F: Array

    def reset(self, env: VesVectorEnv, ids: Index) -> None:
        task, s = env.task, env.batch.scene
        fits = task.kind in ("damp", "lqr") and isinstance(task.control, Torque)
        require_fit(self.name, fits, "gives torques in tasks damp and lqr", env)
        system = task.system.replace(effects=()).ideal()
        count, joints = s.q.shape
        outputs = 6 + joints
        n = outputs + system.base.m  # coordinates: Y, joints, internal modes
        remember(self, count, **dict.fromkeys(("_home", "_summed", "_tau"), (joints,)))
        remember(self, count, _state=(2 * n,), _A=(2 * n, 2 * n), _B=(2 * n, joints))
        remember(self, count, _L=(2 * n, outputs), _F=(joints, 2 * n + joints))
        servo, dt = task.control.servo_for(system), env.batch.dt
        for i in ids.tolist():
            self._home[i] = s.q[i]
            A, B = linearise_ideal(system, s.q[i], servo=servo).discretise(dt)
            self._A[i], self._B[i] = A, B
            self._L[i] = observer_gain(A, joints, dt)
            self._F[i] = feedback(system, s.q[i], A, B, dt)
        u, ud = system.base.attached(s.y_seen), system.base.attached(s.yd_seen)
        x = np.concatenate([s.y_seen, s.q - self._home, u, s.yd_seen, s.v, ud], axis=1)
        self._state[ids], self._summed[ids], self._tau[ids] = x[ids], 0.0, 0.0

    def act(self, env: VesVectorEnv, observation: object) -> Array:
        s, control, dt = env.batch.scene, env.task.control, env.batch.dt
        assert isinstance(control, Torque)
        away = s.q - self._home
        started = env.batch.episodes.steps > 0
        # one period on by the plant, then what was seen of it
        ahead = matvec(self._A, self._state) + matvec(self._B, self._tau)
        measured = np.concatenate([s.y_seen, away], axis=1)
        ahead += matvec(self._L, measured - ahead[:, : measured.shape[1]])
        self._state = np.where(started[:, None], ahead, self._state)
        tau = -matvec(self._F, np.concatenate([self._state, self._summed], axis=1))
        action = torque_action(env, control, tau)
        self._tau = control.torque(action, env.task.system.arm)
        limited = np.abs(action) >= 1.0  # an integral that goes on there would wind up
        self._summed += np.where(limited, 0.0, dt * away)
        return action


def feedback(system: System, q: Array, A: Array, B: Array, dt: float) -> Array:
    """Gains (joints, 2 s + joints) of torque per state (Y, q - q0, u, rates) and integral.

    A (2 s, 2 s) and B (2 s, joints) are linearised at q (joints,) and sampled with dt [s].
    """
    size, joints = B.shape
    n = size // 2
    Q = np.zeros((size + joints, size + joints))
    mass, _, K = system.base.full()
    mass[:6, :6] += inertia(system.arm, q)[:6, :6]
    at, joint = np.r_[:6, 6 + joints : n], np.arange(6, 6 + joints)
    Q[np.ix_(at, at)], Q[np.ix_(n + at, n + at)] = K / 2, mass / 2
    Q[joint, joint] = _STRAY
    Q[size:, size:] = _DRIFT * np.eye(joints)
    wide_A = np.eye(size + joints)  # of state and integral
    wide_A[:size, :size] = A
    wide_A[size:, joint] = dt * np.eye(joints)
    wide_B = np.vstack([B, np.zeros((joints, joints))])
    R = _EFFORT * np.eye(joints)
    P = scipy.linalg.solve_discrete_are(wide_A, wide_B, dt * Q, dt * R)
    out: Array = np.linalg.solve(dt * R + wide_B.T @ P @ wide_B, wide_B.T @ P @ wide_A)
    return out


def observer_gain(A: Array, joints: int, dt: float) -> Array:
    """Steady gain (2 s, 6 + joints) of the Kalman filter that sees pose and joint angles.

    A is (2 s, 2 s), sampled with dt [s]; s is 6 + joints + internal modes.
    """
    n, outputs = len(A) // 2, 6 + joints
    rates = np.r_[
        np.full(6, _ACCELERATION[0]),
        np.full(joints, _ACCELERATION[1]),
        np.full(n - outputs, _MODE),
    ]
    unknown = np.vstack([np.eye(n) * dt / 2, np.eye(n)]) * rates * np.sqrt(dt)
    noise = np.diag(np.r_[np.full(6, _SEEN[0]), np.full(joints, _SEEN[1])] ** 2)
    C = np.eye(outputs, 2 * n)
    floor = 1e-18 * np.eye(2 * n)  # keeps the Riccati equation regular
    S = scipy.linalg.solve_discrete_are(A.T, C.T, unknown @ unknown.T + floor, noise)
    out: Array = S @ C.T @ np.linalg.inv(C @ S @ C.T + noise)
    return out
