"""Payload: centre of mass elsewhere than described."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ves_gym._util.params import Vector
from ves_gym.mechanics.arm import Arm
from ves_gym.system.effect import ArmEffect, parameter, register


@register("payload/com")
@dataclass(frozen=True, kw_only=True)
class PayloadCom(ArmEffect):
    """The last link's centre of mass lies `offset` away from where it is described.

    In the link's axes; mass and inertia about the centre as described (derived here).
    """

    modes = ("ideal", "emulated")
    port = "joint"
    offset: Vector = parameter(
        "m", bounds=(-0.3, 0.3), shape=(3,), start=0.02, search=(-0.2, 0.2)
    )

    def arm(self, arm: Arm) -> Arm:
        """The last link with its centre of mass moved."""
        if self.is_null:
            return arm
        last = arm.links[-1]
        com = tuple((np.array(last.inertial.com) + self.offset).tolist())
        moved = replace(last, inertial=replace(last.inertial, com=com))
        return replace(arm, links=(*arm.links[:-1], moved))
