"""Bring the tool to a point fixed in space, and keep it there, on a base that sways."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from ves_gym._util.params import (
    Array,
    Mask,
    ParameterError,
    Vector,
    require_positive,
    unit,
)
from ves_gym.envs.control import Acceleration, Control
from ves_gym.envs.joints import (
    REFERENCES,
    drawn_joints,
    joint_box,
    rate_fields,
    rates,
    require_control,
    straight_pace,
)
from ves_gym.envs.scales import least_scale, straight_energy, straight_motion
from ves_gym.envs.task import Field, Scene, Start, Task, register_task
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.kinematics import dexterity, joint_positions
from ves_gym.mechanics.tool_pose import joints_for

_TRIES = 16  # candidate targets per episode; the first that is near and dexterous counts
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
    chosen: Array = ends[np.arange(len(q)), best]
    return chosen


@register_task("reach")
@dataclass(frozen=True, kw_only=True)
class Reach(Task):
    """Bring the tool to a point fixed in space and keep it there until the deadline.

    The arm's own motion sways the base by centimetres, so the joints must take back what the
    base does. Joint angles of start and target are uniform in the box of the planning
    benchmark reach100; those of the target are kept when a straight quintic gets there in
    half the time within the speed limits, and when they are `dexterous`, so that the target
    stays within reach while the base sways. Solved: the tool has been within `tolerance` of
    the target for the last `hold` seconds.

    Reward, summed over an episode: minus the mean distance in `far`, and minus `thrift` times
    E_mean in that expected of a straight motion to the target in half the time
    (`scales.straight_energy`), at least a quarter of what it is in the median. Resting at the
    start returns -0.6 in the median. `arrival` is the weight of the mean of
    1 / (1 + (distance/near)^2): without it, to close the last 11 cm gains 0.04 and costs 0.05.

    An episode is terminated at the deadline (the horizon is part of the task, and the time
    left is observed) or beyond a joint limit.
    """

    options: ClassVar[tuple[str, ...]] = ("q", "target")
    memory: ClassVar[int] = 2  # m from tool to target; s at the target without a break
    compiled: ClassVar[bool] = True
    control: Control = Acceleration()
    duration: float = unit("s", default=4.0)
    span: Vector = unit("rad", default=tuple(np.deg2rad([120.0, 60.0, 120.0]).tolist()))
    dexterous: float = unit("m/rad", default=0.1)  # least `tool.dexterity` at the target
    tolerance: float = unit("m", default=0.01)
    hold: float = unit("s", default=0.5)
    far: float = unit("m", default=1.0)  # distance that counts as one
    thrift: float = unit("1", default=0.2)
    arrival: float = unit("1", default=1.0)  # weight of being at the target
    near: float = unit("m", default=0.02)  # where that is worth half

    @property
    def draws(self) -> int:  # type: ignore[override]
        """See `Task`."""
        return drawn_joints(self.system.arm) * (1 + _TRIES)

    def __post_init__(self) -> None:
        super().__post_init__()
        require_control(self, *REFERENCES, "pd_target", "torque")
        require_positive(self, "dexterous", "tolerance", "hold", "far", "near")
        require_positive(self, "thrift", "arrival", zero=True)
        joint_box(self, (0.0,), self.span)

    @cached_property
    def _straight(self) -> straight_energy:
        return straight_motion(self, self.duration / 2)

    @cached_property
    def _least(self) -> float:
        """J, the smallest energy that counts as one."""
        return least_scale(lambda u: self._straight(*self._ends(u)), self.draws)

    # ------------------------------------------------------------------ episodes

    def check_options(
        self, options: Mapping[str, Any] | None, extra: tuple[str, ...], rows: int | None = None
    ) -> dict[str, Any]:
        """See `Task`. The target must be within reach."""
        out, arm = super().check_options(options, extra, rows), self.system.arm
        if "target" in out:
            points = np.atleast_2d(out["target"])
            _, miss = joints_for(arm, points, self._middle(len(points)))
            worst = int(miss.argmax())
            if miss[worst] > _MISS:
                raise ParameterError(
                    "options['target'] must be a point in space that the tool reaches, got"
                    f" {points[worst].tolist()} m, which it misses by {miss[worst]:.3g} m"
                )
        return out

    def _middle(self, rows: int) -> Array:
        arm = self.system.arm
        return np.tile((arm.column("q_min") + arm.column("q_max")) / 2, (rows, 1))

    def start(self, u: Array, **options: Array) -> Start:
        """See `Task`. Goal: the target (3) [m], then the energy that counts as one [J]."""
        arm = self.system.arm
        q, end = self._ends(u, options.get("q"))
        if "target" in options:
            end, _ = joints_for(arm, options["target"], self._middle(len(u)))
        target = joint_positions(arm, end)[:, -1]
        energy = np.maximum(self._straight(q, end), self._least)
        return Start(q, np.column_stack([target, energy]))

    def _ends(self, u: Array, q: Array | None = None) -> tuple[Array, Array]:
        """Joint angles (k, joints) at the start (q, if given) and at the target [rad]."""
        arm = self.system.arm
        low, high = joint_box(self, (0.0,), self.span)
        share = u.reshape(len(u), 1 + _TRIES, -1)[..., : arm.n]
        drawn = low + (high - low) * share
        q = drawn[:, 0] if q is None else q
        return q, reachable(arm, q, drawn[:, 1:], self.duration / 2, self.dexterous)

    def remember(self, s: Scene, dt: float) -> None:
        """See `Task`."""
        distance = np.sqrt(((s.goal[:, :3] - s.tool) ** 2).sum(axis=1))
        s.memory[:, 1] = np.where(distance <= self.tolerance, s.memory[:, 1] + dt, 0.0)
        s.memory[:, 0] = distance

    def success(self, s: Scene) -> Mask:
        """(n,) whether the tool has come to stay."""
        settled: Mask = s.memory[:, 1] >= self.hold
        return settled

    # --------------------------------------------------------------- observation

    def fields(self) -> tuple[Field, ...]:
        """See `Task`."""
        return (
            *self._sensed(),
            Field("to_target", "m", np.full(3, self.far / 2), "target less tool as measured"),
            Field("energy_scale", "1", np.array([2.0]), "decimal logarithm of the scale in J"),
        )

    def observe(self, s: Scene) -> tuple[Array, ...]:
        """See `Task`."""
        return (*self._sense(s), s.goal[:, :3] - s.tool_seen, np.log10(s.goal[:, 3:]))

    def _sensed(self) -> tuple[Field, ...]:
        arm, (sway, swaying) = self.system.arm, self.sway
        return (
            Field("joint_angle", "rad", np.full(arm.n, np.pi), "joint angles"),
            *rate_fields(self.control, arm),
            Field("base_pose", "m, rad", sway, "pose of the base as measured"),
            Field("base_rate", "m/s, rad/s", swaying, "rate of the base as measured"),
            Field("time_left", "s", np.array([self.duration]), "until the deadline"),
        )

    def _sense(self, s: Scene) -> tuple[Array, ...]:
        remaining = (self.duration - s.time)[:, None]
        return s.q, *rates(self.control, s), s.y_seen, s.yd_seen, remaining

    # -------------------------------------------------------------------- reward

    def reward(self, s: Scene, dt: float, last: Mask) -> dict[str, Array]:
        """See `Task`."""
        scale = s.goal[:, 3] * (self.duration + self.tail) / self.thrift
        close = 1 / (1 + (s.memory[:, 0] / self.near) ** 2)
        return {
            "distance": -s.memory[:, 0] * (dt / self.duration / self.far),
            "energy": -s.energy * dt / scale,
            "tail": -s.tail / scale,
            "arrival": close * (self.arrival * dt / self.duration),
        }

    def marker(self, s: Scene) -> Array:
        """The target."""
        return s.goal[:, None, :3]
