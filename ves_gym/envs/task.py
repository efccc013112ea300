"""`Task`: what an episode asks, vectorised over simulations. A new task is a new file.

A task is frozen data: the system, how actions drive the joints, and what counts. Whatever
changes during an episode is held by `Batch`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, TypeVar, dataclass_transform

import numpy as np

from ves_gym._util.own import require_free
from ves_gym._util.params import (
    Array,
    Index,
    Mask,
    ParameterError,
    finite,
    require_positive,
    require_types,
    to_plain,
    unit,
)
from ves_gym._util.suggest import did_you_mean
from ves_gym.envs.base_control import BaseControl
from ves_gym.envs.control import Control
from ves_gym.envs.randomize import Range
from ves_gym.system.energy import TAIL
from ves_gym.system.system import System

if TYPE_CHECKING:
    from ves_gym.simulation.simulator import Simulator

TASKS: dict[str, type[Task]] = {}
T = TypeVar("T", bound="type[Task]")
_WIDTHS = {"y": 6, "yd": 6, "pose": 6, "target": 3}  # of options that are not joint angles


@dataclass(frozen=True)
class Field:
    """A named part of the observation: value / scale, clipped to +-`Task.CLIP`.

    `scale` (size,) is what counts as one, in the unit.
    """

    name: str
    unit: str
    scale: Array
    what: str

    @property
    def size(self) -> int:
        """Number of entries."""
        return len(self.scale)


class Start(NamedTuple):
    """Initial states of k episodes.

    Joints q, v (k, joints) [rad, rad/s], the base's pose and rate y, yd (k, 6), and goal
    (k, g), whatever the task compares with.
    """

    q: Array
    goal: Array
    y: Array | float = 0.0
    yd: Array | float = 0.0
    v: Array | float = 0.0


@dataclass
class Scene:
    """Every simulation at one instant. Leading axis n.

    Attributes:
        time: (n,) s since the episode's start.
        q, v: (n, joints) rad and rad/s.
        y, yd: (n, 6) pose of the base, true [m, rad], and its rate.
        y_seen, yd_seen: (n, 6) what is measured of them: the truth in space; in the laboratory
            the platform's pose, and the rate of the vehicle emulated.
        tool, tool_seen: (n, 3) tool in space [m], true and by the measured pose of the base.
        energies: (n, 2) E of the base and its strain energy [J].
        ref: (n, 3, joints) motion that the servos follow: angle, rate, acceleration.
        goal: (n, g) of the task.
        memory: (n, `Task.memory`) what the task remembers, zero at an episode's start.
        table_values: (n, k) of `Task.lookup` at this instant.
        tau: (n, joints) torque or drive command last sent.
        payload: (n, k) `latch.LatchTarget` of the payload in rows; k = 0 where none takes part.
        contact: (n, 7) wrench of contact on the tool, inertial axes [N, N m], and what its
            springs store [J]; (n, 0) of systems without.
        propellant: (n,) used since the start [kg].
        wheels: (n, w) speeds of the vehicle's reaction wheels [rad/s].
        tail: (n,) J s that the base will keep after the end; zero before it.
        kp, kd: (n, joints) gains in force [N m/rad, N m s/rad].
    """

    time: Array
    q: Array
    v: Array
    y: Array
    yd: Array
    y_seen: Array
    yd_seen: Array
    tool: Array
    tool_seen: Array
    energies: Array
    ref: Array
    goal: Array
    memory: Array
    table_values: Array
    tau: Array
    payload: Array
    contact: Array
    propellant: Array
    wheels: Array
    tail: Array
    kp: Array
    kd: Array

    @property
    def energy(self) -> Array:
        """(n,) E of the base [J]."""
        return self.energies[:, 0]

    @property
    def strain(self) -> Array:
        """(n,) strain energy of the base [J]."""
        return self.energies[:, 1]

    def rows(self, ids: Index) -> Scene:
        """A copy of some simulations, of (k,) indices."""
        return Scene(**{f.name: getattr(self, f.name)[ids] for f in fields(self)})


@dataclass(frozen=True, kw_only=True)
class Task(ABC):
    """Question that an episode asks: starts, goals, reward, success.

    `tail` seconds after the deadline count into `E_mean`, joints held, as in the planning
    benchmark; their energy is computed from the linearised motion, not simulated. `context`
    appends what was drawn for the episode (`randomize`) to the observation. `base_control`
    appends wheels and jets of a satellite to the action.

    A class says of itself:

    - `draws`: uniform numbers that `start` takes per episode.
    - `memory`: columns of `Scene.memory`, 0.
    - `options`: what `reset` lets one choose; keywords of `start`.
    - `energetic`: costs that are the objective energy.
    - `goal_fields`: names of the fields achieved and desired, of goal variants.
    - `compiled`: that `observe`, `remember`, `costs`, `success`, `failed`, `closes` and
      `opens` are formulas of the scene alone, a simulation per row: the kernel then compiles
      their NumPy text. It holds for the class that says so, not for those derived from it.
    - `interacts`: that the system's payload takes part: `payload`, `closes` and `opens` are
      asked.
    """

    REGISTRY: ClassVar[dict[str, type[Task]]] = TASKS
    CLIP: ClassVar[float] = 5.0  # of observations, in their scales
    kind: ClassVar[str]
    draws: ClassVar[int]
    options: ClassVar[tuple[str, ...]] = ()
    goal_fields: ClassVar[tuple[str, str] | None] = None
    memory: ClassVar[int] = 0
    energetic: ClassVar[tuple[str, ...]] = ("energy", "tail")
    compiled: ClassVar[bool] = False
    interacts: ClassVar[bool] = False

    system: System = System(physics_dt=2.5e-3)
    control: Control
    duration: float = unit("s")
    tail: float = unit("s", default=TAIL)
    randomize: tuple[Range, ...] = ()
    context: bool | None = None
    base_control: BaseControl | None = None

    def __post_init__(self) -> None:
        require_types(self, "system", "control", "base_control", "randomize")
        for name in (k.name for k in fields(self) if k.type == "Vector"):
            value = getattr(self, name)
            finite(value, np.shape(value), f"{self.kind}.{name}")
        require_positive(self, "duration")
        require_positive(self, "tail", zero=True)
        self.system.arm.require_rigid(f"task {self.kind}")
        self.system.arm.require_turning(f"task {self.kind}")
        steps = self.duration / self.system.control_dt
        if abs(steps - round(steps)) > 1e-9 * steps:
            raise ParameterError(
                f"{self.kind}.duration must be whole control periods of"
                f" {self.system.control_dt:g} s, got {self.duration:g} s"
            )
        self.control.check(self.system)
        if self.base_control is not None:
            self.base_control.check(self.system)
        for spread in self.randomize:
            spread.check(self.system)
        if self.context and not self.randomize:
            raise ParameterError(
                f"{self.kind}.context shows what randomize draws, got nothing to draw"
            )

    @property
    def tumbles(self) -> bool:
        """A free base may turn by more than `machines.LEAVE`: such tasks step in NumPy."""
        return False

    @cached_property
    def steps(self) -> int:
        """Control periods of an episode."""
        return round(self.duration / self.system.control_dt)

    @property
    def action_width(self) -> int:
        """Numbers in an action: of the joints, then of wheels and jets."""
        base = self.base_control
        beside = 0 if base is None else base.width(self.system)
        return self.control.width(self.system.arm) + beside

    @abstractmethod
    def start(self, u: Array, **options: Array) -> Start:
        """Beginnings of k episodes from uniform numbers u (k, draws) in [0, 1).

        `options`: what was chosen instead, (k, ...) each.
        """

    @abstractmethod
    def fields(self) -> tuple[Field, ...]:
        """Parts of the observation, in order."""

    def parts(self) -> tuple[Field, ...]:
        """All of the observation: the task's fields, and with `context` what was drawn."""
        if not self.context:
            return self.fields()
        drawn = [
            Field(r.label, "1", np.ones(r.entries), "drawn, -1 to 1 from one end to the other")
            for r in self.randomize
            if r.entries
        ]
        return (*self.fields(), *drawn)

    @abstractmethod
    def observe(self, s: Scene) -> tuple[Array, ...]:
        """Values (n, size) of the fields, in their units."""

    def lookup(self, goal: Array, step: Index) -> Array:
        """Values that the formulas take from tables at an instant, as `Scene.table_values`.

        Args:
            goal: (n, g) of the episodes.
            step: (n,) periods since their starts.

        Returns:
            (n, k); nothing by default.
        """
        return np.empty((len(goal), 0))

    def payload(self, goal: Array) -> dict[str, Array]:
        """Return what payloads are and where they fly as episodes begin.

        Args:
            goal: (k, g) of the episodes.

        Returns:
            Values (k, ...) of `PayloadHandler.change`; what is not there is as described.
        """
        return {}

    def closes(self, s: Scene) -> Mask:
        """(n,) whether the latch closes at the end of a period, or of a reset.

        The scene, with the states that the impulse has left, is then looked at anew.
        """
        return np.zeros(len(s.q), bool)

    def opens(self, s: Scene) -> Mask:
        """(n,) whether the latch opens after a period: what is there holds the payload still.

        Args:
            s: with what is remembered of the period.
        """
        return np.zeros(len(s.q), bool)

    def step_info(self, sim: Simulator, ended: Mask) -> dict[str, Any]:
        """Return entries (n, ...) of an info beside those that every task has.

        Args:
            sim: as the period left it.
            ended: (n,) episodes that end; the mask of what is reported of them alone.
        """
        return {}

    def remember(self, s: Scene, dt: float) -> None:  # noqa: B027
        """Bring `s.memory` up to date, once per period, before `costs`."""

    @abstractmethod
    def costs(self, s: Scene, dt: float, last: Mask) -> dict[str, Array]:
        """Costs (n,) >= 0 of the period dt that ended here, by name; `last`: the deadline's.

        Summed over an episode they are its cost J, in units in which doing nothing costs about
        one; what an episode returns is a function of J, success and failure (`episode.judge`).
        """

    def missing(self, s: Scene) -> Array | None:
        """(n,) >= 0 missing to the goal now; what it is at the deadline is part of J.

        None: of tasks that are no way to a goal.
        """
        return None

    @abstractmethod
    def success(self, s: Scene) -> Mask:
        """(n,) whether the episode would count as solved if it ended here."""

    def failed(self, s: Scene) -> Mask:
        """(n,) whether an episode must end now as a failure. Joint limits, by default."""
        low, high = self.joint_range
        return np.any((s.q < low) | (s.q > high), axis=1)

    def marker(self, s: Scene) -> Array | None:
        """(n, k, 3) points in space that pictures show [m]: a target, then a line from it."""
        return None

    def goal_reward(self, achieved: Array, desired: Array) -> Array:
        """(...,) reward of a goal variant from goals (..., g)."""
        raise NotImplementedError

    def check_options(
        self, options: Mapping[str, Any] | None, extra: tuple[str, ...], rows: int | None = None
    ) -> dict[str, Any]:
        """Options of `reset` as arrays, checked.

        Args:
            extra: names that are the environment's own, passed on as they are.
            rows: number of environments of a vector, None for one.

        Raises:
            ParameterError: unknown names, wrong widths, joints out of their limits.
        """
        if not isinstance(options, (Mapping, type(None))):
            raise ParameterError(f"reset: options must be a dict or None, got {options!r}")
        out: dict[str, Any] = {}
        for name, value in (options or {}).items():
            if name in extra:
                out[name] = value
                continue
            if name not in self.options:
                keys = (*extra, *self.options)
                raise ParameterError(
                    f"reset: unknown option {name!r}; known: {', '.join(keys)}"
                    f"{did_you_mean(name, keys)}"
                )
            width = _WIDTHS.get(name, self.system.arm.n)
            shape = (width,) if rows is None else (rows, width)
            out[name] = finite(value, shape, f"options[{name!r}]")
            if name in ("q", "goal"):
                for q in np.atleast_2d(out[name]):
                    self.system.arm.require_within_limits(q, f"options[{name!r}]")
        return out

    @cached_property
    def columns(self) -> dict[str, slice]:
        """Columns of the observation by field."""
        out, at = {}, 0
        for part in self.parts():
            out[part.name] = slice(at, at + part.size)
            at += part.size
        return out

    # ----------------------------------------------------------------- scales

    @cached_property
    def joint_range(self) -> tuple[Array, Array]:
        """Lower and upper joint limits (joints,) with a degree to spare."""
        arm = self.system.arm
        return arm.column("q_min") - np.deg2rad(1), arm.column("q_max") + np.deg2rad(1)

    @cached_property
    def sway(self) -> tuple[Array, Array]:
        """Units of Y and of Y' (6,) in observations: each holds one joule, or m and rad."""
        base = self.system.ideal().base
        K, M = np.diag(base.K), np.diag(base.mass_matrix) + self.system.arm.mass
        soft = np.where(K > 0, K, 2.0)
        return np.minimum(np.sqrt(2 / soft), 1.0), np.minimum(np.sqrt(2 / M), 1.0)

    def to_dict(self) -> dict[str, Any]:
        """Plain data, `kind` included."""
        return to_plain(self)


@dataclass_transform(kw_only_default=True, frozen_default=True, field_specifiers=(unit, field))
def register_task(kind: str) -> Callable[[T], T]:
    """Class decorator: file a task under its name; a name already taken is an error.

    A class that is no dataclass yet becomes one, frozen and with keywords alone.
    """

    def decorate(cls: T) -> T:
        if not issubclass(cls, Task):
            raise ParameterError(f"task {kind!r} must be a subclass of Task, got {cls!r}")
        if not hasattr(cls, "draws"):
            raise ParameterError(
                f"task {kind!r} must say `draws`, how many uniform numbers `start` takes"
            )
        require_free(kind, "task", cls, TASKS.get(kind))
        if "__dataclass_params__" not in vars(cls):
            dataclass(frozen=True, kw_only=True)(cls)  # in place
        cls.kind = kind
        TASKS[kind] = cls
        return cls

    return decorate
