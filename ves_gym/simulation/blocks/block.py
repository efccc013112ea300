"""Blocks of the emulation loop and the signals between them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ves_gym._util.array_functions import ArrayFunctions
from ves_gym._util.params import Array
from ves_gym.engine.batch_parameters import Bodies
from ves_gym.system.deviations import LoopParameters

Values = Mapping[str, Array]  # arrays by name, leading axis = simulation

WRENCH, POSE = "N, N m", "m, rad"
RATE, ACCELERATION = "m/s, rad/s", "m/s^2, rad/s^2"


@dataclass(frozen=True)
class Signal:
    """What one block hands to others, once per control period."""

    name: str
    shape: tuple[int | str, ...]  # of one simulation; "k" nodes of the period, "n" joints
    unit: str
    frame: str  # in which its components are
    meaning: str
    outside: str = "outside"  # who hands it in where no block does

    def sized(self, nodes: int, joints: int) -> tuple[int, ...]:
        """Return the shape with its letters replaced by numbers."""
        sizes = {"k": nodes, "n": joints, "6+n": 6 + joints}
        return tuple(sizes[w] if isinstance(w, str) else w for w in self.shape)


_PLATFORM, _FLOOR = "platform", "floor"  # axes of the platform top; of its home pose
_PATH, _MOTION = ("k", 6), f"{POSE}; {RATE}"
_ENGINE, _SERVO = "engine", "joint servo"
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
        Signal("y_model", _PATH, POSE, _FLOOR, "pose by the model of the platform"),
        Signal("yd_model", _PATH, RATE, _FLOOR, "rate by the model of the platform"),
        Signal("ydd_model", _PATH, ACCELERATION, _FLOOR, "acceleration by the model"),
        Signal("y_engine", (6,), POSE, _FLOOR, "pose of the engine's platform", _ENGINE),
        Signal("yd_engine", (6,), RATE, _FLOOR, "rate of the engine's platform", _ENGINE),
        Signal("acceleration", _PATH, ACCELERATION, _FLOOR, "path of the engine's platform"),
        Signal("wrench", _PATH, WRENCH, _PLATFORM, "true wrench of the arm", _ENGINE),
        Signal("draws", (18,), "1", "", "standard normal numbers", "generators"),
        Signal("table", (6,), WRENCH, _PLATFORM, "weight as learnt (thesis 3.3)", "table"),
    )
}
TO_ENGINE = ("acceleration",)  # what leaves the loop


@dataclass(frozen=True)
class Memory:
    """One named array that a block carries from period to period."""

    shape: tuple[int, ...]  # of one simulation
    feeds_back: bool = True  # False: constant or random, no part of the loop's dynamics


@dataclass(frozen=True)
class Shape:
    """Sizes that all blocks of a loop share."""

    nodes: int  # physics steps of a period, both ends counted
    joints: int
    control_dt: float  # s
    physics_dt: float  # s


class Block(ABC):
    """A part of the loop: a pure function from (parameters, memory, signals) on.

    `p`, `x` and `u` are arrays by name with simulations along their first axis; names of `p`
    and `x` are the block's own.
    """

    name: ClassVar[str]
    inputs: tuple[str, ...]  # of SIGNALS
    outputs: tuple[str, ...]
    compiles: bool = True  # False: its text cannot be traced
    sparse: ClassVar[tuple[str, ...]] = ()  # parameters whose zeros are part of the structure

    @property
    def summary(self) -> str:
        """First sentence about the block."""
        return " ".join((type(self).__doc__ or "").split("\n\n")[0].split())

    @property
    def memory(self) -> dict[str, Memory]:
        """What the block carries over."""
        return {}

    def parameters(self, p: LoopParameters, bodies: Bodies) -> dict[str, Array]:
        """Return the block's parameters, one row per row of what is given.

        Args:
            p: parameters of m loops, effects included.
            bodies: m arms and vehicles.
        """
        return {}

    @abstractmethod
    def step(
        self, xp: ArrayFunctions, p: Values, x: Values, u: Values
    ) -> tuple[dict[str, Array], dict[str, Array]]:
        """Advance by a control period.

        Args:
            xp: functions of the arrays.
            p: `parameters`.
            x: `memory`.
            u: `inputs`.

        Returns:
            The new memory and the outputs.
        """

    def start(self, p: Values, u: Values) -> tuple[dict[str, Array], dict[str, Array]]:
        """Return memory and held outputs at a reset.

        Args:
            p: parameters of the m simulations that are reset.
            u: signals at that instant, by name: `q`, pose and rate `X` (m, 12), and what the
                blocks reset before have put out.
        """
        m = len(u["X"])
        return {k: np.zeros((m, *v.shape)) for k, v in self.memory.items()}, {}

    @property
    def structure(self) -> tuple[Any, ...]:
        """Everything but `p` that `step` depends on, for the key of compiled code."""
        return ()


def renamed(block: Block, names: Mapping[str, str], name: str) -> Block:
    """Return a block under another name, wired to other signals.

    Args:
        block: the original, which stays as it is.
        names: old -> new name of signals.
        name: of the new block.
    """
    return _Renamed(block, names, name)


class _Renamed(Block):
    """A block whose wires have other names."""

    def __init__(self, block: Block, names: Mapping[str, str], name: str) -> None:
        self.block, self._names, self.name = block, names, name  # type: ignore[misc]
        self._back = {new: old for old, new in names.items()}
        self.inputs = tuple(names.get(k, k) for k in block.inputs)
        self.outputs = tuple(names.get(k, k) for k in block.outputs)
        self.compiles = block.compiles

    @property
    def summary(self) -> str:
        return self.block.summary

    @property
    def memory(self) -> dict[str, Memory]:
        return self.block.memory

    @property
    def structure(self) -> tuple[Any, ...]:
        return self.block.structure

    def parameters(self, p: LoopParameters, bodies: Bodies) -> dict[str, Array]:
        return self.block.parameters(p, bodies)

    def step(
        self, xp: ArrayFunctions, p: Values, x: Values, u: Values
    ) -> tuple[dict[str, Array], dict[str, Array]]:
        x_new, y = self.block.step(xp, p, x, {self._back.get(k, k): v for k, v in u.items()})
        return x_new, {self._names.get(k, k): v for k, v in y.items()}

    def start(self, p: Values, u: Values) -> tuple[dict[str, Array], dict[str, Array]]:
        x, y = self.block.start(p, {self._back.get(k, k): v for k, v in u.items()})
        return x, {self._names.get(k, k): v for k, v in y.items()}
