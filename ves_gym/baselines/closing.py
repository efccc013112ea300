"""Closing in on a target by rates that are a function of what is observed now."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.envs.registration import EnvSpec

from ves_gym._util.params import Array, Index, ParameterError
from ves_gym.baselines.resolved import damped_inverse
from ves_gym.envs.reach import Reach
from ves_gym.envs.track import Track
from ves_gym.envs.vector import VesVectorEnv
from ves_gym.mechanics.dynamics import joint_positions
from ves_gym.mechanics.kinematics import MOST, every_joints_for, tool_jacobian
from ves_gym.mechanics.spatial import matvec, rotation, twist

_MOVE = 0.82  # share of an episode that the way to a target takes
MOST_SHARE = 8.0  # 1/s: largest share of the way left that is gone per second
_ROUNDS = 2  # of Newton's method for the joint angles on the base as measured
_FOLLOW = 12.0  # 1/s: how fast the distance from a path is taken back
_LEAD = 0.05  # s ahead that the path's velocity is taken: half a decision, and the servos' lag
_CONTROLS: dict[str, dict[str, Any]] = {
    "joint_velocity": {"kind": "joint_velocity"},
    "tool_velocity": {"kind": "tool_velocity", "speed": 1.5, "damping": 0.05},
}


class Closing:
    """Asks for rates, by the present observation alone: a law that a policy can learn.

    To a target, through control joint_velocity: of the joint angles that bring the tool there
    on the base as measured, the nearest; of the way left the share per second that the
    straight motion of least jerk takes at this time (Flash & Hogan, J. Neuroscience 5(7),
    1985), at most `MOST_SHARE`; and, as that share grows, the rates that take back how the base
    carries the tool along. Along a path, through control tool_velocity: the path's velocity,
    a share `_FOLLOW` of the distance from it per second, less the velocity that the base gives
    the tool.

    Rates that an error of the network adds do not add up, as accelerations do: they leave the
    tool off by the error over the share. So what is learned of this law ends closer to the
    target than what is learned of `Homing` or `Resolved`, which lead accelerations.
    """

    name = "closing"
    privileged = True

    def __init__(self) -> None:
        self._ends = np.empty(0)  # (n, MOST, joints) that reach the target, base at rest

    def settings(self, spec: EnvSpec) -> dict[str, Any]:
        """See `Controller`."""
        if "control" in spec.kwargs:
            return {}
        desired = "tool_velocity" if spec.kwargs.get("task") == "track" else "joint_velocity"
        return {"control": _CONTROLS[desired]}

    def reset(self, env: VesVectorEnv, ids: Index) -> None:
        """See `Controller`."""
        task, s = env.task, env.batch.scene
        desired = {Reach: "joint_velocity", Track: "tool_velocity"}
        kinds = [kind for cls, kind in desired.items() if isinstance(task, cls)]
        if kinds != [task.control.kind]:
            raise ParameterError(
                "controller closing acts on tasks reach and reach_goal through control"
                " joint_velocity and on track through tool_velocity, got task"
                f" {task.kind} through control {task.control.kind}"
            )
        if not isinstance(task, Reach):
            return
        if self._ends.shape != (env.num_envs, MOST, s.q.shape[1]):
            self._ends = np.full((env.num_envs, MOST, s.q.shape[1]), np.nan)
        self._ends[ids] = every_joints_for(task.system.arm, s.goal[ids, :3], s.q[ids])

    def act(self, env: VesVectorEnv, observation: Any) -> Array:
        """See `Controller`."""
        if isinstance(env.task, Track):
            return np.clip(self._along(env), -1.0, 1.0)
        return np.clip(self._towards(env), -1.0, 1.0)

    def _towards(self, env: VesVectorEnv) -> Array:
        """(n, joints) joint rates to the target, in those of a full action."""
        task, s = env.task, env.batch.scene
        arm = task.system.arm
        fast = arm.column("v_max")
        share = share_per_second(s.time, _MOVE * task.duration)[:, None]
        far = np.linalg.norm((self._ends - s.q[:, None]) / fast, axis=-1)
        end = self._ends[np.arange(len(far)), np.nan_to_num(far, nan=np.inf).argmin(axis=1)]
        turn = np.swapaxes(rotation(s.y_seen), -1, -2)
        desired = matvec(turn, s.goal[:, :3] - s.y_seen[:, :3])
        inverse = damped_inverse(tool_jacobian(arm, end))
        for _ in range(_ROUNDS):
            end = end + matvec(inverse, desired - joint_positions(arm, end)[:, -1])
        drift = matvec(inverse, _carried(s.y_seen, s.yd_seen, desired))
        rates = share * (end - s.q) - share / MOST_SHARE * drift
        return np.asarray(rates / (task.control.speed * fast))  # type: ignore[attr-defined]

    def _along(self, env: VesVectorEnv) -> Array:
        """(n, 3) velocities along the path, in those of a full action."""
        task, s = env.task, env.batch.scene
        assert isinstance(task, Track)
        path, rows, step = task.path(s), np.arange(env.num_envs), env.batch.episodes.steps
        ahead = [0, *np.rint(np.array(task.preview) / env.batch.dt).astype(int)[:2]]
        current, soon, later = (path[rows, np.minimum(step + k, task.steps)] for k in ahead)
        first, second = task.preview[0], task.preview[1] - task.preview[0]
        rates = (soon - current) / first, (later - soon) / second
        bend = (rates[1] - rates[0]) / ((first + second) / 2)
        velocity = rates[0] + bend * (_LEAD - first / 2)
        turn = np.swapaxes(rotation(s.y_seen), -1, -2)
        command = matvec(turn, velocity + _FOLLOW * (current - s.tool_seen))
        place = matvec(turn, s.tool_seen - s.y_seen[:, :3])
        command -= _carried(s.y_seen, s.yd_seen, place)
        return np.asarray(command / task.control.speed)  # type: ignore[attr-defined]


def share_per_second(time: Array, seconds: float) -> Array:
    """Return the share of the way left that the straight motion of least jerk goes [1/s].

    Args:
        time: (n,) since it began [s].
        seconds: that it takes [s].
    """
    part = np.minimum(time / seconds, 1 - 1e-6)
    # rate of the quintic over the way that it leaves, in closed form
    pace = 30 * part**2 / ((1 - part) * (1 + 3 * part + 6 * part**2))
    return np.asarray(np.minimum(pace / seconds, MOST_SHARE))


def _carried(y: Array, yd: Array, place: Array) -> Array:
    """Return the velocity that a base gives a place, in its own axes (n, 3) [m/s].

    Args:
        y, yd: (n, 6) its pose and rate.
        place: (n, 3) in its axes [m].
    """
    base = twist(y, yd)
    out: Array = base[:, :3] + np.cross(base[:, 3:], place)
    return out
