"""What tasks of an arm share: where joints start, what moves them, what is sensed of them."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from itertools import pairwise
from typing import ClassVar

import numpy as np

from ves_gym._util.params import Array, ParameterError, Vector, require_positive
from ves_gym.envs.control import Control, SmoothReference
from ves_gym.envs.scales import least_scale, straight_energy, straight_motion
from ves_gym.envs.task import Field, Scene, Task
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.motion import QUINTIC_PEAK_SPEED
from ves_gym.mechanics.tool_pose import joints_for

# controls that move a reference smoothly, by acceleration or by velocity
REFERENCES = ("acceleration", "joint_velocity", "tool_velocity")
_SHARE = 0.9  # of a joint's range, the most that a box meant for another arm takes


@dataclass(frozen=True, kw_only=True)
class ArmTask(Task):
    """Base of tasks that draw joint angles in a box, `rows` times an episode.

    Numbers are drawn for `least` joints at least, so that arms with fewer have the same
    beginnings whatever their number.
    """

    rows: ClassVar[int]  # angles drawn of every joint
    more: ClassVar[int] = 0  # numbers drawn beside them
    least: ClassVar[int] = 6
    controls: ClassVar[tuple[str, ...]] = (*REFERENCES, "pd_target", "torque")
    positive: ClassVar[tuple[str, ...]] = ()  # settings that are > 0
    not_negative: ClassVar[tuple[str, ...]] = ()
    leg: ClassVar[float] = 0.5  # share of an episode that a straight motion takes

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.control.kind not in self.controls:
            raise ParameterError(
                f"{self.kind}: control must be {' or '.join(self.controls)}, got"
                f" {self.control.kind}"
            )
        require_positive(self, *self.positive)
        require_positive(self, *self.not_negative, zero=True)
        _ = self.box  # within the joints' limits

    @property
    def draws(self) -> int:  # type: ignore[override]
        return self.rows * max(self.least, self.system.arm.n) + self.more

    @cached_property
    def box(self) -> tuple[Array, Array]:
        """Lower and upper ends (joints,) of `home`, or zero, +- `span` [rad].

        Raises:
            ParameterError: a negative span, or a box beyond the joint limits.
        """
        arm, (middle, half) = self.system.arm, self._middle_and_half
        low, high = middle - half, middle + half
        least, most = arm.column("q_min"), arm.column("q_max")
        if (half < 0).any() or (low < least).any() or (high > most).any():
            limits = [np.rad2deg(k).round(1).tolist() for k in (low, high, least, most)]
            raise ParameterError(
                f"{self.kind}: episodes must start within the joint limits {limits[2]} to"
                f" {limits[3]} deg, got {limits[0]} to {limits[1]} deg"
            )
        return low, high

    @cached_property
    def _middle_and_half(self) -> tuple[Array, Array]:
        home, usual = getattr(self, "home", (0.0,)), usual_of(self, "home", "span", "bend")
        return middle_and_half(self.system.arm, home, self.half_widths(), usual)

    @property
    def middle(self) -> Array:
        """Angles (joints,) where episodes are about [rad]."""
        return self._middle_and_half[0]

    def half_widths(self) -> Vector:
        """Half the widths of the box [rad]."""
        return self.span  # type: ignore[attr-defined]

    def angles(self, u: Array) -> Array:
        """(k, rows, joints) angles in the box [rad] from uniform numbers (k, draws)."""
        low, high = self.box
        share = u[:, : u.shape[1] - self.more].reshape(len(u), self.rows, -1)
        return low + (high - low) * share[..., : self.system.arm.n]

    # --------------------------------------------------------------------- energies

    @cached_property
    def straight(self) -> straight_energy:
        """E_mean of straight motions, which leave the base free until the episode's end [J]."""
        return straight_motion(self, self.leg * self.duration)

    def places(self, u: Array, q: Array | None = None) -> tuple[Array, ...]:
        """Joint angles (k, joints) where straight motions begin (q, if given) and end [rad]."""
        raise NotImplementedError

    def expected(self, *ends: Array) -> Array:
        """(k,) E_mean expected of the straight motions between places [J]."""
        return sum(self.straight(a, b) for a, b in pairwise(ends))  # type: ignore[return-value]

    @cached_property
    def least_energy(self) -> float:
        """Least energy that counts as one: a quarter of straight motions' median [J]."""
        return least_scale(lambda u: self.expected(*self.places(u)), self.draws)

    def scale_of(self, *ends: Array) -> Array:
        """(k,) energy that counts as one: as expected, at least a quarter of the median [J]."""
        return np.maximum(self.expected(*ends), self.least_energy)

    def energy_costs(self, s: Scene, dt: float, energy: Array) -> dict[str, Array]:
        """`thrift` times E_mean in an energy (n,)."""
        thrift: float = self.thrift  # type: ignore[attr-defined]
        scale = energy * (self.duration + self.tail) / thrift
        return {"energy": s.energy * dt / scale, "tail": s.tail / scale}

    # ------------------------------------------------------------------ observation

    def sensed(
        self, angle: float = np.pi, base: tuple[Array, Array] | None = None
    ) -> tuple[Field, ...]:
        """Fields of joints and base, whose values are those of `sense`.

        Args:
            angle: of the joints that counts as one [rad].
            base: the same of pose and rate (6,) of the base; None: `sway`.
        """
        arm = self.system.arm
        sway, swaying = self.sway if base is None else base
        return (
            Field("joint_angle", "rad", np.full(arm.n, angle), "joint angles"),
            *rate_fields(self.control, arm),
            Field("base_pose", "m, rad", sway, "pose of the base as measured"),
            Field("base_rate", "m/s, rad/s", swaying, "rate of the base as measured"),
        )

    def sense(self, s: Scene) -> tuple[Array, ...]:
        """Values (n, ...) of `sensed`."""
        return s.q, *rates(self.control, s), s.y_seen, s.yd_seen

    @property
    def time_left(self) -> Field:
        """Field of the time until the deadline."""
        return Field("time_left", "s", np.array([self.duration]), "until the deadline")

    def left(self, s: Scene) -> Array:
        """(n, 1) of `time_left`."""
        return (self.duration - s.time)[:, None]

    def require_reachable(self, points: Array, middle: Array, miss: float) -> None:
        """Refuse targets (3,) or (n, 3) that the tool misses by more than that, base at rest.

        Args:
            points: in space [m].
            middle: (joints,) where the search starts [rad].
            miss: [m].
        """
        points = np.atleast_2d(points)
        _, gap = joints_for(self.system.arm, points, np.tile(middle, (len(points), 1)))
        worst = int(gap.argmax())
        if gap[worst] > miss:
            raise ParameterError(
                "options['target'] must be a point in space that the tool reaches, got"
                f" {points[worst].tolist()} m, which it misses by {gap[worst]:.3g} m"
            )


def gap(distance: Array, near: float, far: float) -> Array:
    """Return what is missing to a place: a logarithm of a distance (...,), one at `far`.

    Halving a distance is worth the same from `far` down to `near`, what the task resolves.
    """
    return np.log(1.0 + distance / near) / float(np.log(1.0 + far / near))


def braked(way: Array, rate: Array, seconds: float) -> Array:
    """Return the length (n,) of ways (n, k) left, rates as what they make in `seconds`."""
    return np.sqrt((way**2).sum(axis=1) + seconds**2 * (rate**2).sum(axis=1))


def wide(values: Vector, arm: Arm) -> Array:
    """One number per joint (joints,); fewer are repeated."""
    return np.resize(np.asarray(values, float), arm.n)


def usual_of(task: Task, *names: str) -> bool:
    """Return whether settings, where a task has them, are the defaults."""
    defaults = {field.name: field.default for field in fields(task)}
    return all(getattr(task, k) == defaults[k] for k in names if k in defaults)


def middle_and_half(arm: Arm, centre: Vector, span: Vector, usual: bool) -> tuple[Array, Array]:
    """Return the middle and half the width (joints,) of the box centre +- span [rad].

    Numbers that are not one per joint, and usual ones that this arm's limits do not hold, are
    meant for another arm: repeated, and cut to what the limits leave.

    Args:
        arm: whose joints.
        centre: of the box.
        span: to either side.
        usual: nobody gave these numbers for this arm.
    """
    middle, half = wide(centre, arm), wide(span, arm)
    least, most = arm.column("q_min"), arm.column("q_max")
    within = ((middle - half >= least) & (middle + half <= most)).all()
    if arm.n in (len(span), 3) and (within or not usual):
        return middle, half
    half = np.minimum(half, _SHARE * (most - least) / 2)
    spare = half + 1e-9  # rad, rounding
    return np.clip(middle, least + spare, most - spare), half


def straight_pace(arm: Arm, way: Array, seconds: float) -> Array:
    """Return the largest share of its speed that a joint takes on straight quintics.

    Args:
        arm: whose joints.
        way: (..., joints) from their starts to their ends [rad].
        seconds: that they take [s].

    Returns:
        (...,); up to one is within the limits.
    """
    speed = np.abs(way) * (QUINTIC_PEAK_SPEED / seconds)
    return (speed / arm.column("v_max")).max(axis=-1)


def directions(u: Array) -> Array:
    """Unit vectors (..., 3), uniform over the sphere, from uniform numbers (..., 2)."""
    up, turn = 2 * u[..., 0] - 1, 2 * np.pi * u[..., 1]
    flat = np.sqrt(1 - up**2)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), up], axis=-1)


def rate_fields(control: Control, arm: Arm) -> tuple[Field, ...]:
    """Return the fields of the joints' rates; where they follow a reference, of its rates.

    Args:
        control: of the task.
        arm: whose joints.
    """
    fast = arm.column("v_max")
    if not isinstance(control, SmoothReference):
        return (Field("joint_rate", "rad/s", fast, "joint rates"),)
    most = np.resize(control.limits(arm), arm.n)
    return (
        Field("reference_rate", "rad/s", fast, "rate of the reference"),
        Field("reference_acceleration", "rad/s^2", most, "acceleration of the reference"),
    )


def rates(control: Control, s: Scene) -> tuple[Array, ...]:
    """Values of `rate_fields`."""
    if isinstance(control, SmoothReference):
        return s.ref[:, 1], s.ref[:, 2]
    return (s.v,)
