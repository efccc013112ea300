"""Blocks of the emulation loop and the signals between them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym.engine.batch_parameters import Bodies
from ves_gym.system.deviations import LoopParameters

Values = Mapping[str, Array]  # arrays by name, leading axis = simulation
Stepped = tuple[dict[str, Array], dict[str, Array]]  # memory and outputs

WRENCH, POSE = "N, N m", "m, rad"
RATE, ACCELERATION = "m/s, rad/s", "m/s^2, rad/s^2"


@dataclass(frozen=True)
class Signal:
    """A quantity that one block hands to others, once per control period."""

    name: str
    shape: tuple[int | str, ...]  # of one simulation, sizes by their letters in `Shape.sizes`
    unit: str
    frame: str  # in which its components are
    meaning: str
    outside: str = "outside"  # who hands it in where no block does

    def sized(self, shape: LoopShape) -> tuple[int, ...]:
        """Return the shape with its letters replaced by numbers."""
        return tuple(shape.sizes[w] if isinstance(w, str) else w for w in self.shape)


@dataclass(frozen=True)
class LoopShape:
    """Sizes that all blocks of a loop share."""

    nodes: int  # physics steps of a period, both ends counted
    joints: int
    control_dt: float  # s
    physics_dt: float  # s
    leg_states: int = 0  # of a leg and its servo

    @property
    def sizes(self) -> dict[str, int]:
        """Sizes by their letters."""
        k, n = self.nodes, self.joints
        return {"k": k, "k-1": k - 1, "n": n, "6+n": 6 + n, "s": self.leg_states}


_PLATFORM, _FLOOR = "platform", "floor"  # axes of the platform top; of its home pose
_PATH, _STEPS, _MOTION = ("k", 6), ("k-1", 6), f"{POSE}; {RATE}"
_ENGINE, _SERVO = "engine", "joint servo"
_BY_MODEL = "_model"  # ends the names of signals of the model of the platform
SIGNALS: dict[str, Signal] = {
    signal.name: signal
    for signal in (
        Signal("q", ("n",), "rad", "joints", "measured joint angles", _ENGINE),
        Signal("kp", ("n",), "N m/rad", "joints", "gain on angles", _SERVO),
        Signal("kd", ("n",), "N m s/rad", "joints", "gain on rates", _SERVO),
        Signal("inertia", ("6+n", "6+n"), "kg m^2", _PLATFORM, "inertia of arm and base link"),
        Signal("reading", (6,), WRENCH, _PLATFORM, "wrench that the force sensor reports"),
        Signal("weight", (6,), WRENCH, _PLATFORM, "estimate of the arm's weight", "zero"),
        Signal("payload", (6,), WRENCH, _PLATFORM, "reading that the arm's inertia causes"),
        Signal("motion", (12,), _MOTION, _FLOOR, "motion asked of the platform", "operator"),
        Signal("command", (12,), _MOTION, _FLOOR, "motion that leaves the computer"),
        Signal("command_sent", (12,), _MOTION, _FLOOR, "command that safety lets pass"),
        Signal("frozen", (), "1", "", "1 where a safety stop holds it"),
        Signal("command_received", (12,), _MOTION, _FLOOR, "command that the legs follow"),
        Signal("y", _PATH, POSE, _FLOOR, "pose over the period"),
        Signal("yd", _PATH, RATE, _FLOOR, "rate of the pose"),
        Signal("ydd", _PATH, ACCELERATION, _FLOOR, "acceleration of the pose"),
        Signal("y_measured", (6,), POSE, _FLOOR, "pose by the sensors of the platform"),
        Signal("y_nodes", _STEPS, POSE, _FLOOR, "pose over the period, but for its end"),
        Signal("yd_nodes", _STEPS, RATE, _FLOOR, "rate of the pose, but for its end"),
        Signal("ydd_nodes", _STEPS, ACCELERATION, _FLOOR, "acceleration, but for its end"),
        Signal("legs", ("s", 6), "m, m/s, m/s^2", "legs", "legs and their controllers"),
        Signal("pose", (6,), POSE, _FLOOR, "pose at the end of the period"),
        Signal("y_engine", (6,), POSE, _FLOOR, "pose of the engine's platform", _ENGINE),
        Signal("yd_engine", (6,), RATE, _FLOOR, "rate of the engine's platform", _ENGINE),
        Signal("acceleration", _PATH, ACCELERATION, _FLOOR, "path of the engine's platform"),
        Signal("wrench", _PATH, WRENCH, _PLATFORM, "true wrench of the arm", _ENGINE),
        Signal("draws", (18,), "1", "", "standard normal numbers", "generators"),
        Signal("table", (6,), WRENCH, _PLATFORM, "weight as learnt (thesis 3.3)", "table"),
    )
}
TO_ENGINE = ("acceleration",)  # what leaves the loop


def signal_of(name: str) -> Signal:
    """Return a signal by its name.

    Raises:
        ParameterError: no such signal.
    """
    if name.endswith(_BY_MODEL):
        signal = signal_of(name.removesuffix(_BY_MODEL))
        return replace(signal, name=name, meaning=f"{signal.meaning}, by the model")
    if name not in SIGNALS:
        raise ParameterError(f"no signal {name!r}; known: {', '.join(SIGNALS)}")
    return SIGNALS[name]


@dataclass(frozen=True)
class Memory:
    """One named array that a block carries from period to period."""

    shape: tuple[int, ...]  # of one simulation
    feeds_back: bool = True  # False: constant or random, no part of the loop's dynamics


class Noted:
    """Parameters that note which of their fields are read."""

    def __init__(self, source: LoopParameters | Bodies, names: set[str]) -> None:
        self._source, self._names = source, names

    def __getattr__(self, name: str) -> Any:
        self._names.add(name)
        return getattr(self._source, name)


_ANY = LoopShape(0, 0, 0.0, 0.0)


class Block(ABC):
    """A part of the loop: a pure function from (parameters, memory, signals) on.

    `p`, `x` and `u` are arrays by name with simulations along their first axis; names of `p`
    and `x` are the block's own.
    """

    name: ClassVar[str]
    inputs: tuple[str, ...]  # of SIGNALS
    outputs: tuple[str, ...]
    shape: LoopShape = _ANY  # of the loop, where the block asks for its sizes or clocks
    compiles: bool = True  # False: its text cannot be traced
    repeats: int = 1  # times that `step` runs in a control period
    stacked: tuple[str, ...] = ()  # outputs that repetitions put side by side, not over again
    sparse: ClassVar[tuple[str, ...]] = ()  # parameters whose zeros are part of the structure
    memory: Mapping[str, Memory] = {}  # arrays that the block carries over
    # all that `step` depends on beside `shape` and `p`, for the key of compiled code
    structure: tuple[Any, ...] = ()

    @property
    def summary(self) -> str:
        """First sentence about the block."""
        return " ".join((type(self).__doc__ or "").split("\n\n")[0].split())

    def parameters(self, p: LoopParameters, bodies: Bodies) -> dict[str, Array]:
        """Return the block's parameters, one row per row of what is given.

        They are derived anew where a field that was read here at first has changed.

        Args:
            p: parameters of m loops, effects included.
            bodies: m arms and vehicles.
        """
        return {}

    @abstractmethod
    def step(self, p: Values, x: Values, u: Values) -> Stepped:
        """Advance by a control period.

        Args:
            p: `parameters`.
            x: `memory`.
            u: `inputs`.

        Returns:
            The new memory and the outputs.
        """

    def start(self, p: Values, u: Values) -> Stepped:
        """Return memory and held outputs at a reset.

        Args:
            p: parameters of the m simulations that are reset.
            u: signals at that instant, by name: `q`, pose and rate `X` (m, 12), and what the
                blocks reset before have put out.
        """
        m = len(u["X"])
        return {k: np.zeros((m, *v.shape)) for k, v in self.memory.items()}, {}


class ModelOf(Block):
    """A block of the platform as a model beside it, under names of its own."""

    def __init__(self, block: Block) -> None:
        """Give the block's signals the names of the model; commands arrive as they are sent."""
        self.block, self.name = block, f"{block.name}{_BY_MODEL}"  # type: ignore[misc]
        self._names = {k: f"{k}{_BY_MODEL}" for k in (*block.inputs, *block.outputs)}
        self._names["command_received"] = "command_sent"
        self._back = {new: old for old, new in self._names.items()}
        self.inputs = tuple(self._names[k] for k in block.inputs)
        self.outputs = tuple(self._names[k] for k in block.outputs)
        self.stacked = tuple(self._names[k] for k in block.stacked)
        self.compiles, self.repeats, self.shape = block.compiles, block.repeats, block.shape
        self.memory = block.memory
        self.structure = (type(block).__name__, *block.structure)

    @property
    def summary(self) -> str:
        return self.block.summary

    def parameters(self, p: LoopParameters, bodies: Bodies) -> dict[str, Array]:
        return self.block.parameters(p, bodies)

    def step(self, p: Values, x: Values, u: Values) -> Stepped:
        x_new, y = self.block.step(p, x, {self._back.get(k, k): v for k, v in u.items()})
        return x_new, {self._names.get(k, k): v for k, v in y.items()}

    def start(self, p: Values, u: Values) -> Stepped:
        x, y = self.block.start(p, {self._back.get(k, k): v for k, v in u.items()})
        return x, {self._names.get(k, k): v for k, v in y.items()}


def shares(age: Array, nodes: int) -> Array:
    """Return weights (n, nodes) that interpolate past values linearly at an age.

    Args:
        age: (n,) in periods, 0 to nodes - 1.
        nodes: values remembered, newest first.
    """
    away: Array = np.abs(np.arange(nodes) - age[:, None])
    return np.asarray(np.clip(1 - away, 0.0, None), dtype=np.float64)


def mixed(weights: Array, history: Array) -> Array:
    """Return sums of remembered values.

    Args:
        weights: (n, m).
        history: (n, m, c).

    Returns:
        (n, c).
    """
    return (weights[:, None, :] @ history)[:, 0]
