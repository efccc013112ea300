"""Resolved motion whose servos are braced against the base's acceleration."""

from __future__ import annotations

import numpy as np

from ves_gym._util.params import Array, Index
from ves_gym.baselines.resolved import Resolved
from ves_gym.envs.vector import VesVectorEnv
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.dynamics import inertia, newton_euler
from ves_gym.mechanics.spatial import matvec, twist, twist_rate


class Braced(Resolved):
    """Resolved motion, and what the servos need besides: the torque of an accelerating base.

    A servo's feed-forward takes the base for still. Here the reference is shifted by s so that
    servo and feed-forward together add that torque, M s'' + kd s' + kp s = torque. For arms
    whose servos are soft; where they are stiff it changes little.
    """

    def __init__(self) -> None:
        super().__init__("braced")
        self._rate = np.empty(0)  # (n, 6) of the base, a period ago
        self._shift = np.empty(0)  # (2, n, joints) s and its rate

    def reset(self, env: VesVectorEnv, ids: Index) -> None:
        """See `Controller`."""
        super().reset(env, ids)
        joints = env.task.system.arm.n
        if self._shift.shape != (2, env.num_envs, joints):
            self._rate = np.zeros((env.num_envs, 6))
            self._shift = np.zeros((2, env.num_envs, joints))
        self._rate[ids] = env.batch.scene.yd_seen[ids]
        self._shift[:, ids] = 0.0

    def lead(self, env: VesVectorEnv) -> Array:
        """See `Resolved`."""
        target, s, dt = super().lead(env), env.batch.scene, env.batch.dt
        arm = env.task.system.arm
        slope = (s.yd_seen - self._rate) / dt  # of half a period ago: foreseen it was worse
        self._rate = s.yd_seen.copy()
        torque = base_torque(arm, target[:, 0], target[:, 1], s.y_seen, s.yd_seen, slope)
        shift = servo_shift(env, target[:, 0], self._shift, torque)
        self._shift = shift[:2]
        return target + np.swapaxes(shift, 0, 1)


def servo_shift(env: VesVectorEnv, q: Array, before: Array, torque: Array) -> Array:
    """Return the shift s of a reference that servos and feed-forward turn into a torque.

    M s'' + kd s' + kp s = torque, a period on by the implicit rule of Euler.

    Args:
        env: whose gains and inertia M they are.
        q: (n, joints) where the inertia is taken [rad].
        before: (2, n, joints) s and s' a period ago.
        torque: (n, joints) [N m].

    Returns:
        (3, n, joints) s, s' and s''.
    """
    s, dt, arm = env.batch.scene, env.batch.dt, env.task.system.arm
    M = inertia(arm, q)[:, 6:, 6:]
    place, rate = before
    resists = M + (dt * s.kd + dt**2 * s.kp)[:, None] * np.eye(arm.n)
    push = matvec(M, rate) + dt * (torque - s.kp * place)
    after = np.linalg.solve(resists, push[..., None])[..., 0]
    return np.stack([place + dt * after, after, (after - rate) / dt])


def base_torque(arm: Arm, q: Array, v: Array, y: Array, yd: Array, ydd: Array) -> Array:
    """Return the joint torques that a moving base asks for, beyond those of a still one.

    Args:
        arm: n joints.
        q, v: (k, n) joint angles [rad] and rates [rad/s].
        y, yd, ydd: (k, 6) pose of the base and its derivatives.

    Returns:
        (k, n) [N m].
    """
    moving, turning = twist(y, yd), twist_rate(y, yd, ydd)
    spin, none = moving[:, 3:], np.zeros_like(v)
    accel = turning[:, :3] + np.cross(spin, moving[:, :3])
    ridden, _ = newton_euler(arm, q, v, none, spin=spin, turn=turning[:, 3:], accel=accel)
    return ridden - newton_euler(arm, q, v, none)[0]
