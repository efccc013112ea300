"""Closing in on a target by rates, as a function of what is observed now."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.envs.registration import EnvSpec

from ves_gym._util.params import Array, Index
from ves_gym.baselines.controllers import remember, require_fit
from ves_gym.baselines.resolved import (
    STARTS,
    carried,
    configurations_for,
    damped_inverse,
    inverse_sparing,
    joints_at,
    pose_from_base,
    seen_from_base,
)
from ves_gym.envs.pose_reach import PoseReach, goal_pose
from ves_gym.envs.reach import Reach
from ves_gym.envs.track import Track
from ves_gym.envs.vector import VesVectorEnv
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.kinematics import joint_positions, tool_frame, tool_jacobian
from ves_gym.mechanics.spatial import matvec, rotation, twist
from ves_gym.mechanics.spherical_wrist import has_spherical_wrist, shortest_way
from ves_gym.mechanics.tool_pose import every_joints_for

_MOST_SHARE = 8.0  # 1/s: largest share of the way left that is gone per second
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
    1985), at most `_MOST_SHARE`; and, as that share grows, the rates that take back how the
    base carries the tool along. Along a path, through control tool_velocity: the path's
    velocity, a share `_FOLLOW` of the distance from it per second, less the velocity that the
    base gives the tool.

    Rates that an error of the network adds do not add up, as accelerations do: they leave the
    tool off by the error over the share. So what is learned of this law ends closer to the
    target than what is learned of `Resolved`, which leads accelerations.
    """

    name = "closing"
    privileged = True
    move = 0.82  # share of an episode that the way to a target takes
    _ends: Array  # (n, STARTS + 1, joints) at the target, base at rest, and NaN

    def settings(self, spec: EnvSpec) -> dict[str, Any]:
        if "control" in spec.kwargs:
            return {}
        desired = "tool_velocity" if spec.kwargs.get("task") == "track" else "joint_velocity"
        return {"control": _CONTROLS[desired]}

    def reset(self, env: VesVectorEnv, ids: Index) -> None:
        task, s = env.task, env.batch.scene
        self._require(env)
        if isinstance(task, Track):
            return
        remember(self, env.num_envs, _ends=(STARTS + 1, s.q.shape[1]))
        self._ends[ids] = np.nan
        for i, ends in zip(ids.tolist(), self._every(env, ids), strict=True):
            self._ends[i, : len(ends)] = ends

    def _require(self, env: VesVectorEnv) -> None:
        """Refuse another task or control."""
        control = {Reach: "joint_velocity", Track: "tool_velocity"}
        kinds = [kind for cls, kind in control.items() if isinstance(env.task, cls)]
        require_fit(
            self.name,
            kinds == [env.task.control.kind],
            "acts on tasks reach and reach_goal through control joint_velocity and on track"
            " through tool_velocity",
            env,
        )

    def _every(self, env: VesVectorEnv, ids: Index) -> list[Array]:
        """Joint angles (m, joints) that reach the targets of episodes, base at rest [rad]."""
        s = env.batch.scene
        return list(every_joints_for(env.task.system.arm, s.goal[ids, :3], s.q[ids]))

    def act(self, env: VesVectorEnv, observation: Any) -> Array:
        rates = self._along(env) if isinstance(env.task, Track) else self._towards(env)
        return np.clip(rates, -1.0, 1.0)

    def _towards(self, env: VesVectorEnv) -> Array:
        """(n, joints) joint rates to the target, in those of a full action."""
        task, s = env.task, env.batch.scene
        share = share_per_second(s.time, self.move * task.duration)[:, None]
        end, drift = self._target(env)
        rates = share * (end - s.q) - share / _MOST_SHARE * drift
        full = task.control.speed * task.system.arm.column("v_max")  # type: ignore[attr-defined]
        return np.asarray(rates / full)

    def _nearest(self, arm: Arm, q: Array) -> Array:
        """(n, joints) of the joint angles that reach the target those soonest reached [rad]."""
        far = np.linalg.norm((self._ends - q[:, None]) / arm.column("v_max"), axis=-1)
        soonest = np.nan_to_num(far, nan=np.inf).argmin(axis=1)
        return np.asarray(self._ends[np.arange(len(q)), soonest])

    def _target(self, env: VesVectorEnv) -> tuple[Array, Array]:
        """Joint angles for the target on the base as measured, and how the base moves them."""
        s, arm = env.batch.scene, env.task.system.arm
        end = self._nearest(arm, s.q)
        desired = seen_from_base(s.y_seen, s.goal[:, :3])
        inverse = damped_inverse(tool_jacobian(arm, end))
        for _ in range(_ROUNDS):
            end = end + matvec(inverse, desired - joint_positions(arm, end)[:, -1])
        return end, matvec(inverse, carried(twist(s.y_seen, s.yd_seen), desired)[:, :3])

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
        place = seen_from_base(s.y_seen, s.tool_seen)
        command -= carried(twist(s.y_seen, s.yd_seen), place)[:, :3]
        return np.asarray(command / task.control.speed)  # type: ignore[attr-defined]


class ClosingPose(Closing):
    """`Closing` for poses: to the nearest configuration that has the tool there.

    In closed form, of arms with a spherical wrist; else of a sample for the base at rest,
    corrected. Through control joint_velocity.
    """

    name = "closing-pose"
    move = 0.86

    def _require(self, env: VesVectorEnv) -> None:
        fits = isinstance(env.task, PoseReach) and env.task.control.kind == "joint_velocity"
        require_fit(
            self.name, fits, "acts on task pose_reach through control joint_velocity", env
        )

    def _every(self, env: VesVectorEnv, ids: Index) -> list[Array]:
        s, arm = env.batch.scene, env.task.system.arm
        if has_spherical_wrist(arm):
            return list(s.q[ids, None])
        places, turns = goal_pose(s)
        return configurations_for(arm, s.q[ids], places[ids], turns[ids])

    def _target(self, env: VesVectorEnv) -> tuple[Array, Array]:
        s, arm = env.batch.scene, env.task.system.arm
        place, turn = pose_from_base(s.y_seen, *goal_pose(s))
        if has_spherical_wrist(arm):
            end = s.q + shortest_way(arm, s.q, place, turn)
        else:
            end, _ = joints_at(arm, self._nearest(arm, s.q), place, turn)
        drift = carried(twist(s.y_seen, s.yd_seen), tool_frame(arm, end)[0])
        return end, matvec(inverse_sparing(arm, end), drift)


def share_per_second(time: Array, seconds: float) -> Array:
    """Return the share of the way left that the straight motion of least jerk goes [1/s]."""
    part = np.minimum(time / seconds, 1 - 1e-6)
    # rate of the quintic over the way that it leaves, in closed form
    pace = 30 * part**2 / ((1 - part) * (1 + 3 * part + 6 * part**2))
    return np.asarray(np.minimum(pace / seconds, _MOST_SHARE))
