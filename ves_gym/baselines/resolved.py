"""Resolved-motion control: joint rates that move the tool in space whatever the base does."""

from __future__ import annotations

from typing import Any

import numpy as np

from ves_gym._util.params import Array, Index, ParameterError
from ves_gym.baselines.controllers import FOLLOW, reference_action
from ves_gym.envs.free_flyer import FreeFlyerReach
from ves_gym.envs.payload_transfer import PayloadTransfer
from ves_gym.envs.reach import Reach
from ves_gym.envs.track import Track
from ves_gym.envs.vector import VesVectorEnv
from ves_gym.mechanics.kinematics import joint_positions, tool_jacobian
from ves_gym.mechanics.motion import quintic
from ves_gym.mechanics.spatial import matvec, rotation, twist
from ves_gym.mechanics.tool_pose import joints_for

_MOVE = 0.7  # share of an episode that the way to a target takes
_LEGS = ((0.0, 0.37), (0.45, 0.8))  # the same of the two legs of payload_transfer
_CALM = 0.1  # s before the joints have to be at rest by which they slow down
_REST = 0.8  # of the rate that counts as rest, the most that they then have
_DAMPING = 0.05  # m/rad, of the least squares near singular configurations
LEVER = 0.3  # m per radian, of turn beside place


class Resolved:
    """Leads the tool along a path in space, by joint rates that take back the base's motion.

    The joints follow a plan for a base at rest: for task track the one that the Jacobian
    gives along the path, for reach and free_flyer the straight quintic to the nearest joint
    angles that bring the tool to the target, for payload_transfer two of them, to the payload
    and to the berth. In every period the plan is corrected by what the Jacobian says of the
    distance between path and tool, on the base as measured, and of the rate at which the base
    carries the tool along (resolved motion rate control: Whitney, IEEE Trans. Man-Machine
    Systems 10(2), 1969). At the end of free_flyer, whose joints must be at rest on a satellite
    that turns, they take back no more of that than `rest` allows.
    """

    privileged = True

    def __init__(self, name: str = "resolved", follow: float = FOLLOW) -> None:
        self.name, self.follow = name, follow  # 1/s, see `reference_action`
        self._plan = np.empty(0)  # (n, steps + 2, joints) rad
        self._path = np.empty(0)  # (n, steps + 2, 3) of the tool in space [m]

    def reset(self, env: VesVectorEnv, ids: Index) -> None:
        """See `Controller`."""
        task, s = env.task, env.batch.scene
        known = isinstance(task, (FreeFlyerReach, PayloadTransfer, Reach, Track))
        if not known or task.control.level != "reference":
            raise ParameterError(
                "controller resolved leads the reference of tasks reach, track, free_flyer and"
                f" payload_transfer, got task {task.kind} through control {task.control.kind}"
            )
        arm, steps = task.system.arm, task.steps
        if self._plan.shape[:2] != (env.num_envs, steps + 2):
            self._plan = np.zeros((env.num_envs, steps + 2, arm.n))
            self._path = np.zeros((env.num_envs, steps + 2, 3))
        q = s.q[ids]
        if isinstance(task, Track):
            path = task.path(s)[ids]
            plan = [q]
            for point in np.swapaxes(path[:, 1:], 0, 1):
                gap = point - joint_positions(arm, plan[-1])[:, -1]
                inverse = damped_inverse(tool_jacobian(arm, plan[-1]))
                plan.append(plan[-1] + matvec(inverse, gap))
            along = np.stack(plan, axis=1)
        elif isinstance(task, PayloadTransfer):
            along = q[:, None]
            clock = np.arange(steps + 1) / steps
            for goal, (leaves, arrives) in zip(
                (s.goal[ids, :3], s.goal[ids, 3:6]), _LEGS, strict=True
            ):
                before = along[:, -1]
                there, _ = joints_for(arm, goal, before)
                share = quintic((clock - leaves) / (arrives - leaves))[:, None]
                along = along + share * (there - before)[:, None]
            path = joint_positions(arm, along)[..., -1, :]
        else:
            end, _ = joints_for(arm, s.goal[ids, :3], q)
            share = quintic(np.arange(steps + 1) / (_MOVE * steps))[:, None]
            along = q[:, None] + share * (end - q)[:, None]
            path = joint_positions(arm, along)[..., -1, :]
        self._plan[ids] = np.concatenate([along, along[:, -1:]], axis=1)
        self._path[ids] = np.concatenate([path, path[:, -1:]], axis=1)

    def act(self, env: VesVectorEnv, observation: Any) -> Array:
        """See `Controller`."""
        return reference_action(env, env.task.control, self.lead(env), self.follow)

    def lead(self, env: VesVectorEnv) -> Array:
        """Return where the reference is to be at the period's end (n, 3, joints).

        Args:
            env: in the middle of its episodes.
        """
        s, arm, dt = env.batch.scene, env.task.system.arm, env.batch.dt
        rows, step = np.arange(env.num_envs), env.batch.episodes.steps
        before, present, then = (
            self._plan[rows, np.minimum(step + k, env.task.steps + 1)] for k in (0, 1, 2)
        )
        y: Array = s.y_seen + dt * s.yd_seen  # of the base at the period's end
        reach = joint_positions(arm, present)[:, -1]
        wanted = seen_from_base(y, self._path[rows, np.minimum(step + 1, env.task.steps)])
        drift = carried(twist(y, s.yd_seen), reach)[:, :3]  # of the tool with the base
        inverse = damped_inverse(tool_jacobian(arm, present))
        angles = present + matvec(inverse, wanted - reach)
        # once more: damping leaves up to a fifth of the gap where the arm is least dexterous
        angles += matvec(inverse, wanted - joint_positions(arm, angles)[:, -1])
        reference = [
            angles,
            (then - before) / (2 * dt) - matvec(inverse, drift),
            (then - 2 * present + before) / dt**2,
        ]
        out = np.stack(reference, axis=1)
        if isinstance(env.task, FreeFlyerReach):
            left = env.task.duration - step * dt
            calm = left <= env.task.hold + _CALM
            out[calm] = _slowly(s.ref[calm], out[calm], _REST * env.task.rest, dt)
        return out


def _slowly(ref: Array, then: Array, rate: float, dt: float) -> Array:
    """Return where references are to be at the period's end if no joint may be faster.

    Args:
        ref: (k, 3, joints) angle, rate and acceleration now.
        then: (k, 3, joints) where they were to be.
        rate: largest of a joint [rad/s].
        dt: period [s].
    """
    angle = np.clip(then[:, 0], ref[:, 0] - rate * dt, ref[:, 0] + rate * dt)
    slow = np.clip(then[:, 1], -rate, rate)
    return np.stack([angle, slow, np.zeros_like(slow)], axis=1)


def seen_from_base(y: Array, place: Array) -> Array:
    """Return places in the base's axes (n, 3) [m].

    Args:
        y: (n, 6) pose of the base.
        place: (n, 3) in space [m].
    """
    return matvec(np.swapaxes(rotation(y), -1, -2), place - y[:, :3])


def carried(base: Array, place: Array) -> Array:
    """Return the velocity that a base gives a place, or the rate of it, turn included.

    Args:
        base: (n, 6) in its own axes [m/s, rad/s].
        place: (n, 3) [m].

    Returns:
        (n, 6).
    """
    out = base.copy()
    out[:, :3] += np.cross(base[:, 3:], place)
    return out


def damped_inverse(J: Array, damping: float = _DAMPING, dear: Array | None = None) -> Array:
    """Return damped pseudo-inverses (..., n, m) of the tool's Jacobians.

    Args:
        J: (..., m, n) of places, m = 3, or of places and turns, m = 6.
        damping: of the least squares near singular configurations [m/rad].
        dear: (..., n, n) what joint rates cost beside each other; None: they are alike.
    """
    weighted = J.copy()
    weighted[..., 3:, :] *= LEVER
    across = np.swapaxes(weighted, -1, -2)
    if dear is not None:
        across = np.linalg.solve(dear, across).astype(float)
    out: Array = across @ np.linalg.inv(weighted @ across + damping**2 * np.eye(J.shape[-2]))
    out[..., 3:] *= LEVER
    return out
