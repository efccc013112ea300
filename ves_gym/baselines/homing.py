"""Homing: the way of least jerk to the target, taken anew in every control period."""

from __future__ import annotations

from typing import Any

import numpy as np

from ves_gym._util.params import Array, Index, ParameterError
from ves_gym.baselines.resolved import carried, damped_inverse, seen_from_base
from ves_gym.envs.reach import Reach
from ves_gym.envs.vector import VesVectorEnv
from ves_gym.mechanics.kinematics import joint_positions, tool_jacobian
from ves_gym.mechanics.spatial import matvec, twist
from ves_gym.mechanics.tool_pose import joints_for

_MOVE = 0.75  # share of an episode that the way takes
_LEAST = 0.35  # s that there are left to go at any time
_AHEAD = 0.05  # s after which the acceleration is what the way asks for


class Homing:
    """Leads the tool to a target by what there is to see, whatever came before.

    In every period the quintic of least jerk is taken from the reference's rate and
    acceleration (Flash & Hogan, J. Neuroscience 5(7), 1985) to rest at the joint angles that
    bring the tool to the target on the base as measured, in the time that is left of the way,
    at least `_LEAST`. The action is its acceleration shortly after. Unlike `Resolved` it
    follows no plan: but for which of several configurations it goes to, chosen at the start,
    two episodes that look alike ask for the same action.
    """

    name = "homing"
    privileged = True

    def __init__(self) -> None:
        self._end = np.empty(0)  # (n, joints) that reach the target, base at rest [rad]

    def reset(self, env: VesVectorEnv, ids: Index) -> None:
        """See `Controller`."""
        task, s = env.task, env.batch.scene
        if not isinstance(task, Reach) or task.control.kind != "acceleration":
            raise ParameterError(
                "controller homing acts on tasks reach and reach_goal through control"
                f" acceleration, got task {task.kind} through control {task.control.kind}"
            )
        if self._end.shape != s.q.shape:
            self._end = np.zeros_like(s.q)
        self._end[ids], _ = joints_for(task.system.arm, s.goal[ids, :3], s.q[ids])

    def act(self, env: VesVectorEnv, observation: Any) -> Array:
        """See `Controller`."""
        task, s, control = env.task, env.batch.scene, env.task.control
        arm = task.system.arm
        left = np.maximum(_MOVE * task.duration - s.time, _LEAST)[:, None]
        # joint angles for the target, and their rate, on the base as it is
        inverse = damped_inverse(tool_jacobian(arm, self._end))
        reach = joint_positions(arm, self._end)[:, -1]
        wanted = seen_from_base(s.y_seen, s.goal[:, :3])
        drift = carried(twist(s.y_seen, s.yd_seen), reach)[:, :3]
        end, rate = self._end + matvec(inverse, wanted - reach), -matvec(inverse, drift)
        near = np.minimum(left, _LEAST)  # the base sways: its rate says little of later
        _, v, a = s.ref.swapaxes(0, 1)
        jerk = (
            60 * (end + rate * near - s.q) / left**3
            - (36 * v + 24 * rate) / left**2
            - 9 * a / left
        )
        action: Array = (a + _AHEAD * jerk) / control.limits(arm)  # type: ignore[attr-defined]
        return np.clip(action, -1.0, 1.0)
