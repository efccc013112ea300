"""Payload: a mass that is not described."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ves_gym._util.params import Vector
from ves_gym.mechanics.arm import Arm, matrix
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
        last = arm.links[-1]
        old, extra = last.inertial, self.mass
        com, place = np.array(old.com), np.array(self.position)
        total, d = old.mass + extra, place - com
        spread = np.eye(3) * (d @ d) - np.outer(d, d)
        inertial = replace(
            old,
            mass=total,
            com=tuple(((old.mass * com + extra * place) / total).tolist()),
            inertia=matrix(np.array(old.inertia) + old.mass * extra / total * spread),
        )
        return replace(arm, links=(*arm.links[:-1], replace(last, inertial=inertial)))
