"""The task reach with goals in the observation and a reward of the goals alone, for HER."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ves_gym._util.params import Array, Mask
from ves_gym.envs.joints import REFERENCES, require_control
from ves_gym.envs.reach import Reach
from ves_gym.envs.task import Field, Scene, register_task

_SCALE = np.ones(3)  # m: of tool and target in the observation


@register_task("reach_goal")
@dataclass(frozen=True, kw_only=True)
class ReachGoal(Reach):
    """`Reach`, goal-conditioned: the tool as measured is achieved, the target desired.

    Reward: 0 within `tolerance` of the target, -1 elsewhere, computed from the observation,
    so that it is `compute_reward` of what `step` returned, bit for bit. The base's energy is
    told in `info` only. No joint limit ends an episode, for no function of the goals could
    tell and ending early would pay; the controls that are left keep the reference within.
    """

    goal_fields: ClassVar[tuple[str, str] | None] = ("tool", "target")
    compiled: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        require_control(self, *REFERENCES, "pd_target")

    def fields(self) -> tuple[Field, ...]:
        """See `Task`."""
        return (
            *self._sensed(),
            Field("tool", "m", _SCALE, "tool in space as measured"),
            Field("target", "m", _SCALE, "where it is to be"),
        )

    def observe(self, s: Scene) -> tuple[Array, ...]:
        """See `Task`."""
        return *self._sense(s), s.tool_seen, s.goal[:, :3]

    def failed(self, s: Scene) -> Mask:
        """Never."""
        return np.zeros(len(s.q), bool)

    def reward(self, s: Scene, dt: float, last: Mask) -> dict[str, Array]:
        """See `Task`."""
        achieved, desired = self._goal_of(s.tool_seen), self._goal_of(s.goal[:, :3])
        return {"reached": self._reached(achieved - desired)}

    def _goal_of(self, place: Array) -> Array:
        """(n, 3) a place as the observation gives it, in float64."""
        rounded = np.clip(place / _SCALE, -self.CLIP, self.CLIP).astype(np.float32)
        return rounded.astype(np.float64)

    def goal_reward(self, achieved: Array, desired: Array) -> Array:
        """(...,) reward of goals (..., 3) in the units of the observation."""
        return self._reached(np.asarray(achieved, float) - np.asarray(desired, float))

    def _reached(self, gap: Array) -> Array:
        return np.where(((gap * _SCALE) ** 2).sum(axis=-1) <= self.tolerance**2, 0.0, -1.0)
