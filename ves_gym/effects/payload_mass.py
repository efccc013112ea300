"""Payload: a mass that is not described."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ves_gym._util.params import Array, Vector
from ves_gym.mechanics.arm import Arm, Inertial, matrix
from ves_gym.mechanics.payload import carrying
from ves_gym.system.effect import ArmEffect, parameter, register

REACH = 0.03  # m, about which a payload sits otherwise than thought, and extends


def _farther(axis: int, effect: PayloadMass) -> PayloadMass:
    """Return a payload that sits farther along an axis of its link."""
    position = np.array(effect.position) + REACH * np.eye(3)[axis]
    return replace(effect, position=tuple(position.tolist()))


def _longer(along: tuple[float, ...], effect: PayloadMass) -> Rod:
    """Return a payload that extends along a direction of its link."""
    return Rod(mass=effect.mass, position=effect.position, along=along)


# Axes and what halves their angles: any second moments of mass are a sum of these.
_DIRECTIONS = (
    *((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    *((0.5**0.5, 0.5**0.5, 0.0), (0.5**0.5, 0.0, 0.5**0.5), (0.0, 0.5**0.5, 0.5**0.5)),
)


@register("payload/mass")
@dataclass(frozen=True, kw_only=True)
class PayloadMass(ArmEffect):
    """A point mass rides on the tool, `position` away from it in the last link's axes.

    Joints, base and force sensor feel it; gravity estimate and compensation know nothing of
    it (parallel axes: derived here). A diagnosis takes some distance along each axis, and some
    extent along each direction, as forms that it may have in part.
    """

    modes = ("ideal", "emulated")
    port = "joint"
    forms = (
        *(partial(_farther, axis) for axis in range(3)),
        *(partial(_longer, along) for along in _DIRECTIONS),
    )
    mass: float = parameter("kg", bounds=(0.0, 20.0), start=1.0)
    position: Vector = parameter(
        "m", bounds=(-1.0, 1.0), null=None, shape=(3,), default=(0.0, 0.0, 0.0)
    )

    def arm(self, arm: Arm) -> Arm:
        """The last link with the mass on it."""
        if not self.mass:
            return arm
        body = Inertial(mass=self.mass, com=self.position, inertia=matrix(self.inertia))
        return carrying(arm, body, np.zeros(3), np.eye(3))

    @property
    def inertia(self) -> Array:
        """(3, 3) about its own centre of mass, in the last link's axes [kg m^2]."""
        return np.zeros((3, 3))


@dataclass(frozen=True, kw_only=True)
class Rod(PayloadMass):
    """A mass whose parts are `REACH` from its centre, root mean square, along a direction."""

    along: Vector = parameter("1", bounds=(-1.0, 1.0), shape=(3,), default=_DIRECTIONS[0])

    @property
    def inertia(self) -> Array:
        """(3, 3) of a rod that thin: m r^2 (1 - u u^T)."""
        return self.mass * REACH**2 * (np.eye(3) - np.outer(self.along, self.along))
