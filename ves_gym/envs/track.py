"""Follow a path or a seam in space with the tool while the base flexes under the arm."""

from __future__ import annotations

from functools import cached_property, lru_cache
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import (
    Array,
    Index,
    Mask,
    ParameterError,
    Vector,
    finite,
    integer,
    unit,
)
from ves_gym.engine.kernel.compiled_function import CompiledFunction
from ves_gym.engine.kernel.numbers import geometry
from ves_gym.envs.arm_task import ArmTask, directions, gap
from ves_gym.envs.control import Control, ToolVelocity
from ves_gym.envs.scales import BaseModes, motion_energy
from ves_gym.envs.task import Field, Scene, Start, register_task
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.boom import REACHING_OUT, SHUTTLE_LIKE
from ves_gym.mechanics.kinematics import dexterity, frames, joint_positions, tool_motions
from ves_gym.mechanics.motion import QUINTIC_PEAK_SPEED, quintic
from ves_gym.mechanics.spatial import matvec, quadratic, rotation
from ves_gym.system.system import System

_TRIES = 6  # candidate paths per episode; the first that is dexterous all along counts
_CHECKED = 16  # points per round at which that is looked at
_SMALLEST = 0.3  # share of the largest swing that a joint may be drawn with
_COARSE = 0.1  # s between the samples that the energy scale is computed from
_SPARE = np.deg2rad(5.0)  # between a path and the joint limits, for what the sway asks
_EIGHTS = 0.3  # share of joints that swing twice per round


@register_task("track")
class Track(ArmTask):
    """Follow a closed path in space with the tool, from rest to rest, `rounds` times.

    A path is where the tool goes on a base at rest when every joint swings sinusoidally, once
    or twice per round. So every point of it can be reached within the joint limits, at rates of
    at most `pace` of the joints' limits; the remainder is for the base's sway. The phase runs
    by the quintic law. The path starts in the box of the planning benchmark reach100 and is
    used when it is `dexterous` all along. Solved: at the deadline the root mean square of the
    tool's distance from where it was to be is within `tolerance`.

    Cost:

    - The mean of what is missing to where the tool is to be (`arm_task.gap`, in `far`).
    - `thrift` times E_mean over that expected of the joint motion that the path was made of
      (`scales.motion_energy`).
    """

    options: ClassVar[tuple[str, ...]] = ("q",)
    memory: ClassVar[int] = 2  # m^2, squared distance; m^2 s, its integral
    compiled: ClassVar[bool] = True
    rows: ClassVar[int] = 4 * _TRIES
    positive: ClassVar[tuple[str, ...]] = ("pace", "dexterous", "tolerance", "far")
    not_negative: ClassVar[tuple[str, ...]] = ("thrift",)
    control: Control = ToolVelocity(speed=1.5)
    duration: float = unit("s", default=6.0)
    rounds: int = 2
    span: Vector = unit("rad", default=tuple(np.deg2rad([120.0, 60.0, 120.0]).tolist()))
    pace: float = unit("1", default=0.7)
    dexterous: float = unit("m/rad", default=0.1)  # least `tool.dexterity` along the path
    preview: Vector = unit("s", default=(0.1, 0.2, 0.4))  # how far ahead the path is observed
    tolerance: float = unit("m", default=0.005)
    far: float = unit("m", default=0.3)  # distance that counts as one
    thrift: float = unit("1", default=0.01)

    def __post_init__(self) -> None:
        super().__post_init__()
        integer(self.rounds, f"{self.kind}.rounds", 1)
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
        low, high = self.box
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
        return Start(chosen[0], np.column_stack([self._energy_of(along), path.reshape(k, -1)]))

    def _energy_of(self, along: Array) -> Array:
        """(k,) E_mean expected of joint motions (k, steps + 1, joints) [J]."""
        stride = max(1, round(_COARSE / self.system.control_dt))
        dt = stride * self.system.control_dt
        return motion_energy(self._modes, along[:, ::stride], dt, self.tail)

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
        s.memory[:, 0] = ((s.table_values[:, 2:5] - s.tool) ** 2).sum(axis=1)
        s.memory[:, 1] += dt * s.memory[:, 0]

    def success(self, s: Scene) -> Mask:
        """(n,) whether the whole path is behind the tool, and was close to it."""
        close = s.memory[:, 1] <= self.tolerance**2 * self.duration
        return close & (s.time > self.duration - self.system.control_dt / 2)

    # --------------------------------------------------------------- observation

    def fields(self) -> tuple[Field, ...]:
        points = 3 * (1 + len(self.preview))
        return (
            *self.sensed(),
            Field("path", "m", np.full(points, 0.2), "path now and ahead, less tool measured"),
            Field("phase", "1", np.ones(2), "sine and cosine of the phase along the path"),
            self.time_left,
            Field("energy_scale", "1", np.array([2.0]), "decimal logarithm of the scale in J"),
        )

    def observe(self, s: Scene) -> tuple[Array, ...]:
        n, phase = len(s.table_values), s.table_values[:, 1]
        points = s.table_values[:, 2:].reshape(n, -1, 3) - s.tool_seen[:, None]
        return (
            *self.sense(s),
            points.reshape(n, -1),
            np.column_stack([np.sin(phase), np.cos(phase)]),
            self.left(s),
            np.log10(s.table_values[:, :1]),
        )

    # -------------------------------------------------------------------- reward

    def costs(self, s: Scene, dt: float, last: Mask) -> dict[str, Array]:
        missing = gap(np.sqrt(s.memory[:, 0]), self.tolerance, self.far)
        return {
            "error": missing * (dt / self.duration),
            **self.energy_costs(s, dt, s.table_values[:, 0]),
        }


def _joints(shape: Array, phase: Array) -> Array:
    """Joint angles along paths: shape (4, ..., joints), phase (m,) -> (..., m, joints).

    q + swing (sin(waves phase + shift) - sin(shift)).
    """
    q, swing, waves, shift = shape[..., None, :]
    turned = np.sin(waves * phase[:, None] + shift)
    return np.asarray(q + swing * (turned - np.sin(shift)), dtype=np.float64)


# ----------------------------------------------------------------------- seams

# Lengths of the candidate seams, as shares of those asked for: shorter ones where none of the
# first fits (an arm that is slow for its size). The first that can be followed well counts.
_LENGTHS = np.repeat([1.0, 0.5, 0.25, 0.125], [14, 3, 2, 1])
_SEAMS = len(_LENGTHS)  # per episode
_MARKS = 33  # points along a seam at which that is looked at
_FREE = np.deg2rad(8.0)  # between a seam and the joint limits, for what the sway asks
_STRAIGHT = 0.5  # share of seams that are lines


@lru_cache(maxsize=1)
def _on_a_boom() -> System:
    return System(vehicle=SHUTTLE_LIKE.at(REACHING_OUT), physics_dt=2.5e-3)


@register_task("seam")
class Seam(Track):
    """Follow a seam with the tool, a line or an arc fixed in space, while the boom sways.

    The arm (any: `arm=`) stands on the flange of a long flexible boom whose joints are on their
    brakes (`mechanics.boom`). At the start the flange is displaced along a direction drawn
    uniformly over the sphere: the boom stores `energy` and sways through the episode. The seam
    begins at the tool, is `length` of the arm's reach long, and bends by up to `bend` in all or
    not at all. `rounds` counts passes along it, forth and back, by the quintic law. Twenty
    seams are drawn, the last six shorter. The first counts that is `dexterous` and that the arm
    can follow on a base at rest, at rates of at most `pace` of the joints' limits.

    Observation, reward and success are those of task `track`.
    """

    options: ClassVar[tuple[str, ...]] = ("q", "y")
    compiled: ClassVar[bool] = True
    rows: ClassVar[int] = _SEAMS
    more: ClassVar[int] = 2 + 5 * _SEAMS
    positive: ClassVar[tuple[str, ...]] = (*Track.positive, "energy")
    not_negative: ClassVar[tuple[str, ...]] = (*Track.not_negative, "bend")
    system: System = _on_a_boom()
    rounds: int = 1
    pace: float = unit("1", default=0.6)
    dexterous: float = unit("m/rad", default=0.14)  # least `dexterity` along the seam
    length: tuple[float, float] = unit("1", default=(0.25, 0.5))  # of the arm's reach
    bend: float = unit("rad", default=np.pi / 2)
    energy: float = unit("J", default=3.0)  # strain energy of the boom at the start

    def __post_init__(self) -> None:
        super().__post_init__()
        low, high = finite(self.length, (2,), f"{self.kind}.length").tolist()
        if not 0 < low <= high:
            raise ParameterError(f"seam.length must be 0 < low <= high, got {low}, {high}")
        softest = float(np.linalg.eigvalsh(self._stiffness)[0])
        if softest <= 0:
            raise ParameterError(
                "seam needs a base that holds its place, got"
                f" {type(self.system.vehicle).__name__} with a stiffness of {softest:.3g}"
            )

    @cached_property
    def _stiffness(self) -> Array:
        return self.system.ideal().base.K

    @cached_property
    def _phase(self) -> Array:
        """(steps + 1,) rad, at the end of every period; pi per pass."""
        time = np.arange(self.steps + 1) / self.steps
        return np.asarray(np.pi * self.rounds * quintic(time), dtype=np.float64)

    def start(self, u: Array, **options: Array) -> Start:
        """See `Task`. Goal: the energy that counts as one [J], then the seam's points [m]."""
        arm, k = self.system.arm, len(u)
        y = options["y"] if "y" in options else self._released(u[:, :2])
        drawn = u[:, 2:].reshape(k, _SEAMS, -1)
        low, high = self.box
        q = low + (high - low) * drawn[..., : arm.n]
        if "q" in options:
            q = np.broadcast_to(options["q"][:, None], q.shape)
        shape = _shapes(drawn[..., -5:], self.length, self.bend, _reach(arm))
        shape[..., 6] *= _LENGTHS
        first = joint_positions(arm, q)[..., -1, :]
        shares = np.linspace(0.0, 1.0, _MARKS)
        points = first[..., None, :] + _points(shape, shares)
        along, lack = self._followed(q, points)
        rows = np.arange(k)
        best = lack.argmin(axis=1)
        share = (1 - np.cos(self._phase)) / 2
        tool = y[:, :3] + matvec(rotation(y), first[rows, best])  # where the boom holds it
        path = tool[:, None] + _points(shape[rows, best], share)
        plan = _between(along[rows, best], shares, share)
        energy = self._energy_of(plan) + quadratic(self._stiffness, y)
        goal = np.column_stack([energy, path.reshape(k, -1)])
        return Start(q[rows, best], goal, y=y)

    def _released(self, u: Array) -> Array:
        """(k, 6) displacements under a force at the flange, which hold `energy`."""
        force = np.concatenate([directions(u), np.zeros((len(u), 3))], axis=1)
        compliance = np.linalg.inv(self._stiffness)
        y = (force[:, None] @ compliance)[:, 0]
        scale = np.sqrt(self.energy / quadratic(self._stiffness, y))
        return np.asarray(y * scale[:, None], dtype=np.float64)

    def _followed(self, q: Array, points: Array) -> tuple[Array, Array]:
        """Joint angles along seams from q, and how far each is from one that is well followed.

        Args:
            q: (k, tries, joints) at the start [rad].
            points: (k, tries, m, 3) evenly along the seams [m].

        Returns:
            (k, tries, m, joints), and (k, tries) zero where nothing is lacking.
        """
        arm = self.system.arm
        low, high = arm.column("q_min") + _FREE, arm.column("q_max") - _FREE
        plan, lack = [q], np.zeros(q.shape[:2])
        for point in np.moveaxis(points, 2, 0)[1:]:
            at, gap = pursued(arm, plan[-1], point)
            plan.append(at)
            short = 1 - dexterity(arm, at) / self.dexterous
            out = np.maximum(np.maximum(low - at, at - high).max(axis=-1), 0.0)
            missed = np.linalg.norm(gap, axis=-1) / self.tolerance
            lack = np.maximum(lack, np.maximum(short, 0.0) + out + np.maximum(missed - 1, 0.0))
        along = np.stack(plan, axis=2)
        rate = np.abs(np.gradient(along, axis=2)) * (_MARKS - 1)  # per pass
        fastest = np.abs(np.gradient(self._phase)).max() / (2 * self.system.control_dt)
        pace = (rate * fastest / (self.pace * arm.column("v_max"))).max(axis=(-2, -1))
        return along, lack + np.maximum(pace - 1, 0.0)


def _reach(arm: Arm) -> float:
    """Length of an arm beyond its first joint, stretched out [m]."""
    return float(sum(np.hypot(k.a, k.d) for k in arm.links[1:]))


def _shapes(u: Array, length: tuple[float, float], bend: float, reach: float) -> Array:
    """Seams (..., 8): direction (3) and normal (3), length [m], angle by which each bends."""
    ahead, turn = directions(u), 2 * np.pi * u[..., 1]
    level = np.stack([-np.sin(turn), np.cos(turn), np.zeros_like(turn)], axis=-1)
    upright = np.cross(ahead, level)
    roll = 2 * np.pi * u[..., 2, None]
    normal = np.cos(roll) * level + np.sin(roll) * upright
    size = reach * (length[0] + (length[1] - length[0]) * u[..., 3])
    angle = bend * np.maximum(u[..., 4] - _STRAIGHT, 0.0) / (1 - _STRAIGHT)
    return np.concatenate([ahead, normal, size[..., None], angle[..., None]], axis=-1)


def _points(shape: Array, share: Array) -> Array:
    """Points (..., m, 3) of seams (..., 8) from their starts at shares (m,) of the length."""
    ahead, normal, size, angle = np.split(shape[..., None, :], [3, 6, 7], axis=-1)
    turned = angle * share[:, None]
    along = share[:, None] * np.sinc(turned / np.pi)
    aside = share[:, None] * np.sin(turned / 2) * np.sinc(turned / (2 * np.pi))
    return np.asarray(size * (along * ahead + aside * normal), dtype=np.float64)


def _between(along: Array, shares: Array, at: Array) -> Array:
    """Joint angles (k, m, joints) at other shares of seams, linear in between."""
    place = np.interp(at, shares, np.arange(len(shares)))
    before = np.minimum(place.astype(int), len(shares) - 2)
    fraction = (place - before)[:, None]
    return np.asarray((1 - fraction) * along[:, before] + fraction * along[:, before + 1])


# ----------------------------------------------------------- compiled

_CORRECTED = 2  # Newton steps to a point
_DAMPING = 1e-4  # m^2/rad^2, of the least squares near singular configurations


def tool_points(arm: Arm, q: Array) -> Array:
    """Return the tool in platform axes (..., 3) [m] at joint angles (..., joints)."""
    return _tool(arm)(q)


def pursued(arm: Arm, q: Array, point: Array) -> tuple[Array, Array]:
    """Return joint angles (..., joints) that bring the tool to points, from angles near by.

    Args:
        arm: whose tool.
        q: (..., joints) where the search starts [rad].
        point: (..., 3) in platform axes [m].

    Returns:
        The angles, and the gap (..., 3) that the last step was to close [m].
    """

    out = _pursuit(arm)(q, point)
    return out[..., : arm.n], out[..., arm.n :]


@lru_cache(maxsize=16)
def _tool(arm: Arm) -> CompiledFunction:
    def tool(q: Array) -> Array:
        return frames(arm, q).position[..., -1, :]

    return CompiledFunction.of(f"tool {geometry(arm)}", tool, arm.n)


@lru_cache(maxsize=16)
def _pursuit(arm: Arm) -> CompiledFunction:
    def pursue(q: Array, point: Array) -> Array:
        for _ in range(_CORRECTED):
            at = frames(arm, q)
            across = tool_motions(arm, at)[..., :3]  # the Jacobian's transpose
            gap = point - at.position[..., -1, :]
            A = np.swapaxes(across, -1, -2) @ across + _DAMPING * np.eye(3)
            load = np.linalg.solve(A, gap[..., None])
            q = q + (across @ load)[..., 0]
        return np.concatenate([q, gap], axis=-1)

    return CompiledFunction.of(f"pursue {geometry(arm)}", pursue, arm.n, 3)
