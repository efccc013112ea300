"""Payload: a mass that is not described."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ves_gym._util.params import Vector
from ves_gym.mechanics.arm import Arm, Inertial
from ves_gym.mechanics.payload import carrying
from ves_gym.system.effect import ArmEffect, parameter, register

REACH = 0.03  # m along an axis, about which a payload sits otherwise than thought


def _farther(axis: int, effect: PayloadMass) -> PayloadMass:
    """Return a payload that sits farther along an axis of its link."""
    position = np.array(effect.position) + REACH * np.eye(3)[axis]
    return replace(effect, position=tuple(position.tolist()))


@register("payload/mass")
@dataclass(frozen=True, kw_only=True)
class PayloadMass(ArmEffect):
    """A point mass rides on the tool, `position` away from it in the last link's axes.

    Joints, base and force sensor feel it; gravity estimate and compensation know nothing of
    it (parallel axes: derived here).
    """

    modes = ("ideal", "emulated")
    port = "joint"
    forms = tuple(partial(_farther, axis) for axis in range(3))
    mass: float = parameter("kg", bounds=(0.0, 20.0), start=1.0)
    position: Vector = parameter(
        "m", bounds=(-1.0, 1.0), null=None, shape=(3,), default=(0.0, 0.0, 0.0)
    )

    def arm(self, arm: Arm) -> Arm:
        """The last link with the mass on it."""
        if not self.mass:
            return arm
        zero = (0.0, 0.0, 0.0)
        point = Inertial(mass=self.mass, com=self.position, inertia=(zero,) * 3)
        return carrying(arm, point, zero, np.eye(3))
