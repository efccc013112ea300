"""What is hidden, as the simulation sees it: numbers of the machine, and laws with memory.

A `Law` is a set of hooks; each does nothing unless it is overridden. Memory of a law is part of
the integrated state: `size` numbers, whose rates the hooks write into `ds`.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from benchmarks.trial.arm import Array


class Law:
    """A hidden law of one machine; `size` numbers of memory that start at `start`."""

    size: int = 0

    def start(self, q: Array) -> Array:
        """Return the memory (size,) at the beginning, joints at rest at q."""
        return np.zeros(self.size)

    def joint(
        self, t: float, q: Array, v: Array, tau: Array, s: Array, ds: Array
    ) -> Array | None:
        """Return the torque (n,) beside the motor's; may write the memory's rates."""
        return None

    def base(self, t: float, y: Array, yd: Array, s: Array, ds: Array) -> Array | None:
        """Return the force (6,) on the coordinates of the base."""
        return None

    def limit(self, tau: Array) -> Array:
        """Return what the motors give (n,) of what they are told."""
        return tau


class Gear(Law, ABC):
    """Rotor and link of one joint apart: memory is angle and rate of the rotor.

    `transfer` gives the torque on the link; encoders sit on the rotor.
    """

    size = 2

    def __init__(self, joint: int, rotor: float) -> None:
        self.place, self.rotor = joint, rotor

    def start(self, q: Array) -> Array:
        """The rotor stands where the link stands."""
        return np.array([q[self.place], 0.0])

    @abstractmethod
    def transfer(self, twist: float, rate: float) -> float:
        """Return the torque [N m]: the rotor is ahead by `twist` [rad] and `rate` [rad/s]."""


@dataclass
class Signals:
    """Departures of signals: seconds late, low-pass of rates, errors of the laboratory."""

    command_delay: float = 0.0  # s
    reading_delay: float = 0.0  # s, joints to servo and log
    velocity_lag: Array | None = None  # (n,) s
    sensor_gain: Array = field(default_factory=lambda: np.eye(6))  # in the sensor's frame
    sensor_bias: Array = field(default_factory=lambda: np.zeros(6))
    sensor_cutoff: float = 1.0  # times the described
    bandwidth: float = 1.0  # of the platform, times the described
    damping: float = 1.0
    platform_delay: float = 0.0  # s
    weight_scale: float = 1.0
    weight_mass: float = 0.0  # kg
    tilt: Array = field(default_factory=lambda: np.zeros(3))  # rad
    weight_delay: float = 0.0  # s


@dataclass
class Hidden:
    """Everything that a machine has beside its description (numbers that changed excepted)."""

    laws: Sequence[Law] = ()
    signals: Signals = field(default_factory=Signals)

    def memory(self, q: Array) -> tuple[Array, list[slice]]:
        """Return all laws' memory at the start, and each law's part of it."""
        parts, slices, at = [np.zeros(0)], [], 0
        for law in self.laws:
            parts.append(law.start(q))
            slices.append(slice(at, at + law.size))
            at += law.size
        return np.concatenate(parts), slices
