"""Follow a path in space with the tool while the base flexes under the arm."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import (
    Array,
    Index,
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
)
from ves_gym.envs.paths import tool_points
from ves_gym.envs.scales import BaseModes, motion_energy
from ves_gym.envs.task import Field, Scene, Start, Task, register_task
from ves_gym.mechanics.kinematics import dexterity
from ves_gym.mechanics.motion import QUINTIC_PEAK_SPEED, quintic

_TRIES = 6  # candidate paths per episode; the first that is dexterous all along counts
_CHECKED = 16  # points per round at which that is looked at
_SMALLEST = 0.3  # share of the largest swing that a joint may be drawn with
_COARSE = 0.1  # s between the samples that the energy scale is computed from
_SPARE = np.deg2rad(5.0)  # between a path and the joint limits, for what the sway asks
_EIGHTS = 0.3  # share of joints that swing twice per round


@register_task("track")
@dataclass(frozen=True, kw_only=True)
class Track(Task):
    """Follow a closed path in space with the tool, from rest to rest, `rounds` times.

    A path is where the tool goes when every joint swings sinusoidally, once or twice per
    round, on a base at rest: ellipses and Lissajous figures bent by the arm's kinematics. So
    every point of it can be reached, within the joint limits and at rates of at most `pace`
    of the joints' own; the rest is for the base's sway. The phase runs by the quintic law.
    It starts in the box of the planning benchmark reach100 and is kept when it is `dexterous`
    all along. Solved: at the deadline, when the root mean square of the tool's distance from
    where it was to be is within `tolerance`.

    Reward, summed over an episode: minus the mean of sqrt(1 + (distance/near)^2) - 1, which
    is quadratic up to `near` and linear beyond, and minus `thrift` times E_mean in that
    expected of the joint motion that the path was made of (`scales.motion_energy`).

    An episode is terminated at the deadline (the horizon is part of the task, and the time
    left is observed) or beyond a joint limit.
    """

    options: ClassVar[tuple[str, ...]] = ("q",)
    memory: ClassVar[int] = 2  # m^2, squared distance; m^2 s, its integral
    compiled: ClassVar[bool] = True
    control: Control = Acceleration()
    duration: float = unit("s", default=6.0)
    rounds: int = 2
    span: Vector = unit("rad", default=tuple(np.deg2rad([120.0, 60.0, 120.0]).tolist()))
    pace: float = unit("1", default=0.7)
    dexterous: float = unit("m/rad", default=0.1)  # least `tool.dexterity` along the path
    preview: Vector = unit("s", default=(0.1, 0.2, 0.4))  # how far ahead the path is observed
    tolerance: float = unit("m", default=0.005)
    near: float = unit("m", default=0.03)  # distance up to which the cost is quadratic
    thrift: float = unit("1", default=0.1)

    @property
    def draws(self) -> int:  # type: ignore[override]
        """See `Task`."""
        return 4 * drawn_joints(self.system.arm) * _TRIES

    def __post_init__(self) -> None:
        super().__post_init__()
        require_control(self, *REFERENCES, "pd_target", "torque")
        require_positive(self, "pace", "dexterous", "tolerance", "near")
        require_positive(self, "thrift", zero=True)
        joint_box(self, (0.0,), self.span)
        if self.rounds < 1:
            raise ParameterError(f"track.rounds must be >= 1, got {self.rounds}")
        periods = np.array(self.preview) / self.system.control_dt
        if (periods < 0.5).any() or (np.abs(periods - np.rint(periods)) > 1e-9 * periods).any():
            raise ParameterError(
                "track.preview must be whole control periods of"
                f" {self.system.control_dt:g} s, got {self.preview} s"
            )

    @cached_property
    def _phase(self) -> Array:
        """(steps + 1,) rad, at the end of every period."""
        time = np.arange(self.steps + 1) / self.steps
        return np.asarray(2 * np.pi * self.rounds * quintic(time), dtype=np.float64)

    @cached_property
    def _ahead(self) -> npt.NDArray[np.intp]:
        """Periods ahead of now that are observed."""
        periods = np.rint(np.array([0.0, *self.preview]) / self.system.control_dt)
        return periods.astype(np.intp)

    @cached_property
    def _modes(self) -> BaseModes:
        return BaseModes(self.system.ideal())

    # ------------------------------------------------------------------ episodes

    def start(self, u: Array, **options: Array) -> Start:
        """See `Task`. Goal: the energy that counts as one [J], then the path's points [m]."""
        arm, k = self.system.arm, len(u)
        place, size, shift, twice = np.moveaxis(u.reshape(k, _TRIES, 4, -1)[..., : arm.n], 2, 0)
        low, high = joint_box(self, (0.0,), self.span)
        q = low + (high - low) * place
        if "q" in options:
            q = np.broadcast_to(options["q"][:, None], q.shape)
        waves, shift = 1.0 + (twice < _EIGHTS), 2 * np.pi * shift
        fastest = 2 * np.pi * self.rounds * QUINTIC_PEAK_SPEED / self.duration  # rad/s of phase
        swing = self.pace * arm.column("v_max") / (waves * fastest)
        swing *= _SMALLEST + (1 - _SMALLEST) * size
        # within the joint limits: a swing goes from -1 - sin(shift) to 1 - sin(shift)
        aside = np.sin(shift)
        up, down = arm.column("q_max") - q, q - arm.column("q_min")
        for room, way in ((up, 1 - aside), (down, 1 + aside)):
            swing = np.minimum(swing, np.maximum(room - _SPARE, 0) / np.maximum(way, 1e-9))
        parameters = np.stack([q, swing, waves, shift])  # (4, k, tries, joints)
        looked_at = 2 * np.pi * np.arange(_CHECKED) / _CHECKED
        worst = dexterity(arm, _joints(parameters, looked_at)).min(axis=-1)
        lack = np.maximum(1 - worst / self.dexterous, 0.0)
        chosen = parameters[:, np.arange(k), lack.argmin(axis=1)]
        along = _joints(chosen, self._phase)
        path = tool_points(arm, along)
        stride = max(1, round(_COARSE / self.system.control_dt))
        energy = motion_energy(
            self._modes, along[:, ::stride], stride * self.system.control_dt, self.tail
        )
        return Start(chosen[0], np.column_stack([energy, path.reshape(k, -1)]))

    def path(self, s: Scene) -> Array:
        """(n, steps + 1, 3) where the tool is to be at the end of every period [m]."""
        return s.goal[:, 1:].reshape(len(s.goal), -1, 3)

    def target(self, s: Scene) -> Array:
        """(n, 3) where the tool is to be now [m]."""
        return self.path(s)[np.arange(len(s.goal)), self._step(s)]

    def lookup(self, goal: Array, step: Index) -> Array:
        """See `Task`: energy scale [J], phase [rad], points of the path now and ahead [m]."""
        n = len(goal)
        at = np.minimum(step[:, None] + self._ahead, self.steps)
        points = goal[:, 1:].reshape(n, -1, 3)[np.arange(n)[:, None], at]
        return np.column_stack([goal[:, 0], self._phase[at[:, 0]], points.reshape(n, -1)])

    def _step(self, s: Scene) -> npt.NDArray[np.intp]:
        """(n,) periods since the start; an episode that is over stays at its end."""
        periods = np.rint(s.time / self.system.control_dt)
        return np.minimum(periods, self.steps).astype(np.intp)

    def marker(self, s: Scene) -> Array:
        """Return the tool's target and the remaining path."""
        steps_ahead = self._step(s)[:, None] + np.arange(self.steps + 1)
        return self.path(s)[
            np.arange(len(s.goal))[:, None], np.minimum(steps_ahead, self.steps)
        ]

    def remember(self, s: Scene, dt: float) -> None:
        """See `Task`."""
        s.memory[:, 0] = ((s.table_values[:, 2:5] - s.tool) ** 2).sum(axis=1)
        s.memory[:, 1] += dt * s.memory[:, 0]

    def success(self, s: Scene) -> Mask:
        """(n,) whether the whole path is behind the tool, and was close to it."""
        close = s.memory[:, 1] <= self.tolerance**2 * self.duration
        done: Mask = close & (s.time > self.duration - self.system.control_dt / 2)
        return done

    # --------------------------------------------------------------- observation

    def fields(self) -> tuple[Field, ...]:
        """See `Task`."""
        arm, (sway, swaying) = self.system.arm, self.sway
        points = 3 * (1 + len(self.preview))
        return (
            Field("joint_angle", "rad", np.full(arm.n, np.pi), "joint angles"),
            *rate_fields(self.control, arm),
            Field("base_pose", "m, rad", sway, "pose of the base as measured"),
            Field("base_rate", "m/s, rad/s", swaying, "rate of the base as measured"),
            Field("path", "m", np.full(points, 0.2), "path now and ahead, less tool measured"),
            Field("phase", "1", np.ones(2), "sine and cosine of the phase along the path"),
            Field("time_left", "s", np.array([self.duration]), "until the deadline"),
            Field("energy_scale", "1", np.array([2.0]), "decimal logarithm of the scale in J"),
        )

    def observe(self, s: Scene) -> tuple[Array, ...]:
        """See `Task`."""
        n, phase = len(s.table_values), s.table_values[:, 1]
        points = s.table_values[:, 2:].reshape(n, -1, 3) - s.tool_seen[:, None]
        return (
            s.q,
            *rates(self.control, s),
            s.y_seen,
            s.yd_seen,
            points.reshape(n, -1),
            np.column_stack([np.sin(phase), np.cos(phase)]),
            (self.duration - s.time)[:, None],
            np.log10(s.table_values[:, :1]),
        )

    # -------------------------------------------------------------------- reward

    def reward(self, s: Scene, dt: float, last: Mask) -> dict[str, Array]:
        """See `Task`."""
        scale = s.table_values[:, 0] * (self.duration + self.tail) / self.thrift
        return {
            "error": (1 - np.sqrt(1 + s.memory[:, 0] / self.near**2)) * (dt / self.duration),
            "energy": -s.energy * dt / scale,
            "tail": -s.tail / scale,
        }


def _joints(shape: Array, phase: Array) -> Array:
    """Joint angles along paths: shape (4, ..., joints), phase (m,) -> (..., m, joints).

    q + swing (sin(waves phase + shift) - sin(shift)).
    """
    q, swing, waves, shift = shape[..., None, :]
    turned = np.sin(waves * phase[:, None] + shift)
    return np.asarray(q + swing * (turned - np.sin(shift)), dtype=np.float64)
