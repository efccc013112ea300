"""Changes that a machine of joints may have besides the laws of the library: a payload,
shafts that several joints turn, rates logged otherwise than they were.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym.effects.joint_friction import CREEP


@dataclass(frozen=True)
class RateError:
    """Rates that are logged too large or too late; of the log, so no simulation has it."""

    gain: tuple[float, ...]  # (n,) relative
    delay: tuple[float, ...]  # (n,) s


@dataclass(frozen=True)
class CarriedBody:
    """A body fixed to the last link, by the ten numbers in which forces are linear."""

    mass: float  # kg
    moment: tuple[float, float, float] = (0.0, 0.0, 0.0)  # mass x centre, link frame [kg m]
    inertia: tuple[float, ...] = (0.0,) * 6  # xx xy yy xz yz zz about the frame's origin

    def __post_init__(self) -> None:
        if len(self.moment) != 3 or len(self.inertia) != 6:
            raise ParameterError(
                f"a payload has 3 moments and 6 inertias, got {self.moment}, {self.inertia}"
            )

    @property
    def parameters(self) -> Array:
        """(10,) in the order of `body_numbers.PARAMETERS`."""
        return np.array([self.mass, *self.moment, *self.inertia])

    @property
    def centre(self) -> tuple[float, ...]:
        """Centre of mass in the frame of the last link [m]."""
        return tuple(m / self.mass for m in self.moment)


@dataclass(frozen=True)
class Shaft:
    """A shaft that turns with a sum of joints: friction and inertia of a coupled drive."""

    ratio: tuple[float, ...]  # (n,) rate of the shaft per rate of each joint
    coulomb: float = 0.0  # N m
    viscous: float = 0.0  # N m s/rad
    inertia: float = 0.0  # kg m^2

    def needed(self, v: Array, a: Array) -> Array:
        """Return (..., T, n) forces that the shaft takes at the joints.

        Args:
            v, a: (..., T, n) rates and accelerations of the joints.
        """
        ratio = np.array(self.ratio)
        rate = v @ ratio
        torque = self.coulomb * np.tanh(rate / CREEP) + self.viscous * rate
        return np.asarray((torque + self.inertia * (a @ ratio))[..., None] * ratio)
