"""Reaction compensation: the arms beside the one that works keep a free base at rest."""

from __future__ import annotations

from dataclasses import replace

from ves_gym._util.params import Index
from ves_gym.baselines.controllers import joint_query, require_fit, sampled
from ves_gym.baselines.resolved import Resolved
from ves_gym.envs.dual_arm_reach import DualArmReach
from ves_gym.envs.vector import VesVectorEnv
from ves_gym.mechanics.kinematics import joint_positions

_WAY = 0.5  # share of an episode that the motion takes


class Compensating(Resolved):
    """`Resolved`, about a motion of all arms that leaves the base the least energy.

    Planner `direct` finds it: the last arm is to end where its tool is on the target,
    base at rest, the others anywhere. What the base does all the same the last arm takes back.
    Where the planner finds no answer, the others stay where they are.
    """

    def __init__(self) -> None:
        super().__init__("compensating")

    def reset(self, env: VesVectorEnv, ids: Index) -> None:
        from ves_gym.planners.query import solve
        from ves_gym.planners.registry import get_planner

        fits, arm = isinstance(env.task, DualArmReach), env.task.system.arm
        require_fit(self.name, fits, "leads the arms of task dual_arm_reach", env)
        super().reset(env, ids)
        free = tuple(range(arm.spans[-1].start))
        for i in ids.tolist():
            start, end = self._plan[i, 0], self._plan[i, -1]
            query = joint_query(env, start, end, _WAY * env.task.duration)
            plan = solve(get_planner("direct"), replace(query, free_joints=free))
            if plan.found:
                along = sampled(plan.motion, len(self._plan[i]), env.batch.dt)[:, 0]
                self._plan[i], self._path[i] = along, joint_positions(arm, along)[:, -1]
