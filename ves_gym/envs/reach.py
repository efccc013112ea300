"""Bring the tool to a point fixed in space, and keep it there, on a base that sways."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from ves_gym._util.params import Array, Mask, Vector, unit
from ves_gym.envs.arm_task import REFERENCES, ArmTask, gap, straight_pace
from ves_gym.envs.control import Control, JointVelocity
from ves_gym.envs.task import Field, Scene, Start, register_task
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.kinematics import dexterity, joint_positions
from ves_gym.mechanics.tool_pose import joints_for

_TRIES = 16  # candidate targets per episode; the first that is near and dexterous counts
_GOAL_SCALE = np.ones(3)  # m: of tool and target as goals
_MISS = 1e-4  # m by which a chosen target may be out of reach


def reachable(
    arm: Arm,
    q: Array,
    ends: Array,
    seconds: float,
    dexterous: float,
    away: float = 0.0,
    measure: Callable[[Arm, Array], Array] = dexterity,
) -> Array:
    """Return of several configurations the first that a straight motion may end in.

    A straight quintic gets there in time within the speed limits, the arm is dexterous there,
    and the tool has gone some way; of none that does, the one that lacks least.

    Args:
        arm: the arm.
        q: (k, joints) where the motion starts [rad].
        ends: (k, m, joints) candidates [rad].
        seconds: that the motion takes [s].
        dexterous: least of the `measure` [m/rad].
        away: least distance of the tool from where it starts [m].
        measure: dexterity (k, m) of an arm at angles (k, m, joints).

    Returns:
        (k, joints).
    """
    excess = np.maximum(straight_pace(arm, ends - q[:, None], seconds) - 1, 0.0)
    excess += np.maximum(1 - measure(arm, ends) / dexterous, 0.0)
    if away:
        tools = [joint_positions(arm, k)[..., -1, :] for k in (q[:, None], ends)]
        gone = np.linalg.norm(tools[1] - tools[0], axis=-1)
        excess += np.maximum(1 - gone / away, 0.0)
    best = excess.argmin(axis=1)  # the first without any, or the one with the least
    return ends[np.arange(len(q)), best]


@register_task("reach")
class Reach(ArmTask):
    """Bring the tool to a point fixed in space, where it stays until the deadline.

    The arm's motion sways the base by centimetres, so the joints must compensate for it. Joint
    angles of start and target are uniform in the box of the planning benchmark reach100. A
    straight quintic must reach those of the target in half the time within the speed limits.
    They must be `dexterous`, so that the target stays within reach while the base sways.
    Solved: the tool has been within `tolerance` of the target for the last `hold` seconds.

    Cost:

    - What is missing to the target at the end (`arm_task.gap`, from `tolerance` to `far`).
    - `thrift` times E_mean over that expected of a straight motion in half the time
      (`scales.straight_energy`), at least a quarter of its median.
    """

    options: ClassVar[tuple[str, ...]] = ("q", "target")
    memory: ClassVar[int] = 2  # m from tool to target; s at the target without a break
    compiled: ClassVar[bool] = True
    rows: ClassVar[int] = 1 + _TRIES
    positive: ClassVar[tuple[str, ...]] = ("dexterous", "tolerance", "hold", "far")
    not_negative: ClassVar[tuple[str, ...]] = ("thrift",)
    control: Control = JointVelocity()
    duration: float = unit("s", default=4.0)
    span: Vector = unit("rad", default=tuple(np.deg2rad([120.0, 60.0, 120.0]).tolist()))
    dexterous: float = unit("m/rad", default=0.1)  # least `tool.dexterity` at the target
    tolerance: float = unit("m", default=0.01)
    hold: float = unit("s", default=0.5)
    far: float = unit("m", default=1.0)  # distance that counts as one
    thrift: float = unit("1", default=0.01)

    # ------------------------------------------------------------------ episodes

    def check_options(
        self, options: Mapping[str, Any] | None, extra: tuple[str, ...], rows: int | None = None
    ) -> dict[str, Any]:
        """See `Task`. The target must be within reach."""
        out = super().check_options(options, extra, rows)
        if "target" in out:
            self.require_reachable(out["target"], self._middle, _MISS)
        return out

    @cached_property
    def _middle(self) -> Array:
        arm = self.system.arm
        return (arm.column("q_min") + arm.column("q_max")) / 2

    def start(self, u: Array, **options: Array) -> Start:
        """See `Task`. Goal: the target (3) [m], then the energy that counts as one [J]."""
        arm = self.system.arm
        q, end = self.places(u, options.get("q"))
        if "target" in options:
            middle = np.tile(self._middle, (len(u), 1))
            end, _ = joints_for(arm, options["target"], middle)
        target = joint_positions(arm, end)[:, -1]
        return Start(q, np.column_stack([target, self.scale_of(q, end)]))

    def places(self, u: Array, q: Array | None = None) -> tuple[Array, ...]:
        arm, drawn = self.system.arm, self.angles(u)
        q = drawn[:, 0] if q is None else q
        return q, reachable(arm, q, drawn[:, 1:], self.duration / 2, self.dexterous)

    def remember(self, s: Scene, dt: float) -> None:
        distance = np.sqrt(((s.goal[:, :3] - s.tool) ** 2).sum(axis=1))
        s.memory[:, 1] = np.where(distance <= self.tolerance, s.memory[:, 1] + dt, 0.0)
        s.memory[:, 0] = distance

    def success(self, s: Scene) -> Mask:
        """(n,) whether the tool has come to stay."""
        return s.memory[:, 1] >= self.hold

    # --------------------------------------------------------------- observation

    def fields(self) -> tuple[Field, ...]:
        return (
            *self.sensed(),
            self.time_left,
            Field("to_target", "m", np.full(3, self.far / 2), "target less tool as measured"),
            Field("energy_scale", "1", np.array([2.0]), "decimal logarithm of the scale in J"),
        )

    def observe(self, s: Scene) -> tuple[Array, ...]:
        return (
            *self.sense(s),
            self.left(s),
            s.goal[:, :3] - s.tool_seen,
            np.log10(s.goal[:, 3:]),
        )

    # -------------------------------------------------------------------- reward

    def costs(self, s: Scene, dt: float, last: Mask) -> dict[str, Array]:
        return self.energy_costs(s, dt, s.goal[:, 3])

    def missing(self, s: Scene) -> Array | None:
        return gap(s.memory[:, 0], self.tolerance, self.far)

    def marker(self, s: Scene) -> Array:
        """The target."""
        return s.goal[:, None, :3]


@register_task("reach_goal")
class ReachGoal(Reach):
    """`Reach`, goal-conditioned: the tool as measured is achieved, the target desired.

    Reward: 0 within `tolerance` of the target, -1 elsewhere, computed from the observation. So
    it is `compute_reward` of what `step` returned, bit for bit. The base's energy is in `info`
    only. No joint limit ends an episode, because the goals do not show it; of the controls,
    only those that keep the reference within its limits are allowed. Solved: the tool has been
    within `tolerance` for `hold` seconds in all, so that a solved episode has more return.
    """

    goal_fields: ClassVar[tuple[str, str] | None] = ("tool", "target")
    compiled: ClassVar[bool] = True
    controls: ClassVar[tuple[str, ...]] = (*REFERENCES, "pd_target")

    def fields(self) -> tuple[Field, ...]:
        return (
            *self.sensed(),
            self.time_left,
            Field("tool", "m", _GOAL_SCALE, "tool in space as measured"),
            Field("target", "m", _GOAL_SCALE, "where it is to be"),
        )

    def observe(self, s: Scene) -> tuple[Array, ...]:
        return *self.sense(s), self.left(s), s.tool_seen, s.goal[:, :3]

    def failed(self, s: Scene) -> Mask:
        """Never."""
        return np.zeros(len(s.q), bool)

    def costs(self, s: Scene, dt: float, last: Mask) -> dict[str, Array]:
        return {"reached": -self._reached_now(s)}

    def missing(self, s: Scene) -> Array | None:
        return None

    def remember(self, s: Scene, dt: float) -> None:
        s.memory[:, 0] = np.sqrt(((s.goal[:, :3] - s.tool) ** 2).sum(axis=1))
        s.memory[:, 1] += dt * (1.0 + self._reached_now(s))

    def success(self, s: Scene) -> Mask:
        """(n,) whether the tool has been there for long enough."""
        return s.memory[:, 1] >= self.hold - 1e-9

    def _reached_now(self, s: Scene) -> Array:
        return self._reached(self._goal_of(s.tool_seen) - self._goal_of(s.goal[:, :3]))

    def _goal_of(self, place: Array) -> Array:
        """(n, 3) a place as the observation gives it, in float64."""
        rounded = np.clip(place / _GOAL_SCALE, -self.CLIP, self.CLIP).astype(np.float32)
        return rounded.astype(np.float64)

    def goal_reward(self, achieved: Array, desired: Array) -> Array:
        """(...,) reward of goals (..., 3) in the units of the observation."""
        return self._reached(np.asarray(achieved, float) - np.asarray(desired, float))

    def _reached(self, gap: Array) -> Array:
        return np.where(((gap * _GOAL_SCALE) ** 2).sum(axis=-1) <= self.tolerance**2, 0.0, -1.0)
