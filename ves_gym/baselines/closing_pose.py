"""Closing in on a pose by joint rates that are a function of what is observed now."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.envs.registration import EnvSpec
from scipy.spatial.transform import Rotation

from ves_gym._util.params import Array, Index, ParameterError
from ves_gym.baselines.closing import MOST_SHARE, share_per_second
from ves_gym.baselines.resolved_pose import carried, configurations_for, inverse_sparing
from ves_gym.envs.pose_reach import PoseReach, goal_pose
from ves_gym.envs.vector import VesVectorEnv
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.spatial import matvec, rotation, twist
from ves_gym.mechanics.spherical_wrist import has_spherical_wrist, shortest_way
from ves_gym.mechanics.tool_pose import tool_frame

_MOVE = 0.86  # share of an episode that the way to the pose takes
_ROUNDS = 2  # of Newton's method for the joint angles on the base as measured


class ClosingPose:
    """Asks for joint rates towards the nearest configuration that has the tool at the pose.

    What `Closing` is for places: of the configurations for the pose on the base as measured the
    nearest to the joint angles of now (in closed form, of arms with a spherical wrist; else of
    a sample for the base at rest, corrected); of the way left the share per second of the
    motion of least jerk; and the rates that take back how the base carries the tool along.
    Through control joint_velocity.
    """

    name = "closing-pose"
    privileged = True

    def __init__(self) -> None:
        self._ends: list[Array] = []  # (m, joints) per environment [rad]

    def settings(self, spec: EnvSpec) -> dict[str, Any]:
        """See `Controller`."""
        return {} if "control" in spec.kwargs else {"control": {"kind": "joint_velocity"}}

    def reset(self, env: VesVectorEnv, ids: Index) -> None:
        """See `Controller`."""
        task, s = env.task, env.batch.scene
        if not isinstance(task, PoseReach) or task.control.kind != "joint_velocity":
            raise ParameterError(
                "controller closing-pose acts on task pose_reach through control"
                f" joint_velocity, got task {task.kind} through control {task.control.kind}"
            )
        if len(self._ends) != env.num_envs:
            self._ends = list(s.q[:, None].copy())
        if has_spherical_wrist(task.system.arm):
            return
        places, turns = goal_pose(s)
        every = configurations_for(task.system.arm, s.q[ids], places[ids], turns[ids])
        for i, ends in zip(ids.tolist(), every, strict=True):
            self._ends[i] = ends

    def act(self, env: VesVectorEnv, observation: Any) -> Array:
        """See `Controller`."""
        task, s = env.task, env.batch.scene
        arm = task.system.arm
        fast = arm.column("v_max")
        share = share_per_second(s.time, _MOVE * task.duration)[:, None]
        place, turn = goal_pose(s)
        back = np.swapaxes(rotation(s.y_seen), -1, -2)
        place, turn = matvec(back, place - s.y_seen[:, :3]), back @ turn
        end = self._end(arm, s.q, place, turn)
        inverse = inverse_sparing(arm, end)
        drift = carried(twist(s.y_seen, s.yd_seen), tool_frame(arm, end)[0])
        rates = share * (end - s.q) - share / MOST_SHARE * matvec(inverse, drift)
        full = task.control.speed * fast  # type: ignore[attr-defined]
        return np.clip(rates / full, -1.0, 1.0)

    def _end(self, arm: Arm, q: Array, place: Array, turn: Array) -> Array:
        """(n, joints) joint angles for poses on the base as measured, the nearest to q.

        Args:
            arm: whose joints.
            q: (n, joints) [rad].
            place: (n, 3) of the tool in the base's axes [m].
            turn: (n, 3, 3) of the tool there.
        """
        if has_spherical_wrist(arm):
            axes = [tuple(axis.T) for axis in np.moveaxis(turn, -1, 0)]
            way = shortest_way(arm, list(q.T), tuple(place.T), axes, np, np.clip)
            return np.asarray(q + np.stack(way, axis=1))
        fast = arm.column("v_max")
        near = [
            ends[np.linalg.norm((ends - angles) / fast, axis=1).argmin()]
            for ends, angles in zip(self._ends, q, strict=True)
        ]
        end = np.array(near)
        for _ in range(_ROUNDS):
            at, turned = tool_frame(arm, end)
            missing = Rotation.from_matrix(turn @ np.swapaxes(turned, -1, -2)).as_rotvec()
            inverse = inverse_sparing(arm, end)
            end = end + matvec(inverse, np.concatenate([place - at, missing], axis=1))
        return end
