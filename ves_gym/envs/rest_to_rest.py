"""From rest to rest by a deadline with least energy to the base."""

from __future__ import annotations

from functools import cached_property
from typing import ClassVar

import numpy as np

from ves_gym._util.params import Array, Mask, Vector, require_positive, unit
from ves_gym.envs.arm_task import middle_and_half, straight_pace, usual_of
from ves_gym.envs.control import Control, Guided
from ves_gym.envs.scales import least_scale, straight_energy, straight_motion
from ves_gym.envs.task import Field, Scene, Start, Task, register_task
from ves_gym.mechanics.kinematics import joint_positions

_TRIES = 12  # candidate queries per episode; the first that respects the speed limits counts


@register_task("rest_to_rest")
class RestToRest(Task):
    """Bring the arm from one configuration to another, at rest at the deadline.

    Queries are those of the planning benchmark reach100: both ends uniform in a box of joint
    angles, used when the straight quintic respects the speed limits. Cost: E_mean over
    E_straight, or over a quarter of its median where that is more; and `miss` times the
    distance to the goal at the end.

    E_straight is the energy that a straight motion is expected to leave on the machine as
    described (`scales.straight_energy`), in the laboratory and with effects too. The policy has
    to find out how another machine differs.

    Solved: at the goal and at rest there, with E_mean at most `saving` times E_straight.
    Control `guided` arrives whatever the action: with `saving` None doing nothing solves every
    episode.
    """

    options: ClassVar[tuple[str, ...]] = ("q", "goal")
    memory: ClassVar[int] = 1  # J s, integral of the base's energy
    compiled: ClassVar[bool] = True
    control: Control = Guided()
    duration: float = unit("s", default=2.0)
    span: Vector = unit("rad", default=tuple(np.deg2rad([120.0, 60.0, 120.0]).tolist()))
    tolerance: float = unit("rad", default=float(np.deg2rad(1.0)))  # of each joint at the end
    rest: float = unit("rad/s", default=float(np.deg2rad(5.0)))  # of each joint at the end
    miss: float = unit("1/rad", default=2.0)  # penalty of the distance left at the end
    saving: float | None = unit("1", default=0.5)  # most of E_straight that counts as solved

    @property
    def draws(self) -> int:  # type: ignore[override]
        return 2 * _TRIES * max(3, self.system.arm.n)

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive(self, "tolerance", "rest")
        require_positive(self, "miss", zero=True)
        if self.saving is not None:
            require_positive(self, "saving")

    @cached_property
    def _straight(self) -> straight_energy:
        return straight_motion(self, self.duration)

    def start(self, u: Array, **options: Array) -> Start:
        """See `Task`. Goal: joint angles (joints), E_straight."""
        q, goal = self._ends(u)
        q, goal = options.get("q", q), options.get("goal", goal)
        return Start(q, np.column_stack([goal, self._straight(q, goal)]))

    @cached_property
    def least_energy(self) -> float:
        return least_scale(lambda u: self._straight(*self._ends(u)), self.draws)

    def _ends(self, u: Array) -> tuple[Array, Array]:
        """Joint angles (k, joints) where motions start and end [rad]."""
        n = self.system.arm.n
        usual = usual_of(self, "span")
        middle, span = middle_and_half(self.system.arm, (0.0,), self.span, usual)
        ends = middle + (2 * u.reshape(len(u), _TRIES, 2, -1)[..., :n] - 1) * span
        excess = straight_pace(self.system.arm, ends[:, :, 1] - ends[:, :, 0], self.duration)
        pick = (excess <= 1).argmax(axis=1)  # the first that fits, or the first of all
        rows = np.arange(len(u))
        chosen = ends[rows, pick]
        # none of the tries: shorten the first until it fits
        shrink = np.maximum(excess[rows, pick], 1.0)[:, None]
        q = chosen[:, 0]
        return q, q + (chosen[:, 1] - q) / shrink

    def remember(self, s: Scene, dt: float) -> None:
        s.memory[:, 0] += dt * s.energy

    def fields(self) -> tuple[Field, ...]:
        arm = self.system.arm
        sway, swaying = self.sway
        fast = arm.column("v_max")
        return (
            Field("joint_angle", "rad", np.full(arm.n, np.pi), "joint angles"),
            Field("to_goal", "rad", np.full(arm.n, np.pi / 2), "goal less reference"),
            Field("reference_rate", "rad/s", fast, "rate of the reference"),
            Field(
                "reference_acceleration", "rad/s^2", 4 * fast, "acceleration of the reference"
            ),
            Field("base_pose", "m, rad", sway, "pose of the base as measured"),
            Field("base_rate", "m/s, rad/s", swaying, "rate of the base as measured"),
            Field("time_left", "s", np.array([self.duration]), "until the deadline"),
            Field("energy_scale", "1", np.array([2.0]), "decimal logarithm of E_straight in J"),
        )

    def observe(self, s: Scene) -> tuple[Array, ...]:
        n = self.system.arm.n
        return (
            s.q,
            s.goal[:, :n] - s.ref[:, 0],
            s.ref[:, 1],
            s.ref[:, 2],
            s.y_seen,
            s.yd_seen,
            (self.duration - s.time)[:, None],
            np.log10(s.goal[:, n : n + 1]),
        )

    def costs(self, s: Scene, dt: float, last: Mask) -> dict[str, Array]:
        n, length = self.system.arm.n, self.duration + self.tail
        scale = np.maximum(self._scale(s), self.least_energy * length)
        distance = np.abs(s.goal[:, :n] - s.q).sum(axis=1)
        return {
            "energy": s.energy * dt / scale,
            "tail": s.tail / scale,
            "miss": np.where(last, self.miss * distance, 0.0),
        }

    def marker(self, s: Scene) -> Array:
        """The arm at the goal, from its tool down."""
        n = self.system.arm.n
        return joint_positions(self.system.arm, s.goal[:, :n])[:, ::-1]

    def success(self, s: Scene) -> Mask:
        """At the goal, at rest there, and with as little energy as `saving` asks."""
        n = self.system.arm.n
        over: Mask = s.time > self.duration - self.system.control_dt / 2
        near: Mask = np.all(np.abs(s.goal[:, :n] - s.q) <= self.tolerance, axis=1)
        calm: Mask = np.all(np.abs(s.v) <= self.rest, axis=1)
        if self.saving is None:
            return over & near & calm
        return over & near & calm & (s.memory[:, 0] + s.tail <= self.saving * self._scale(s))

    def _scale(self, s: Scene) -> Array:
        """(n,) integral of E that counts as one [J s]."""
        return s.goal[:, self.system.arm.n] * (self.duration + self.tail)
