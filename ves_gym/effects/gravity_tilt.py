"""Gravity estimate: wrong orientation of the platform (thesis 3.2.4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ves_gym._util.params import Vector
from ves_gym.system.deviations import LoopParameters
from ves_gym.system.effect import LaboratoryEffect, parameter, register
from ves_gym.system.system import System


@register("gravity/tilt")
@dataclass(frozen=True, kw_only=True)
class GravityTilt(LaboratoryEffect):
    """The pose given to the gravity estimate is turned by `angles` about x, y and z."""

    port = "gravity"
    angles: Vector = parameter("rad", bounds=(-0.1, 0.1), shape=(3,), start=0.01)

    def check(self, system: System) -> None:
        """Only micro-gravity emulation subtracts an estimate."""
        operation = system.emulator_settings.operation
        self._require(operation == "microgravity", f"operation microgravity, got {operation}")

    def edit(self, p: LoopParameters) -> None:
        """Add the deviation to the machine's parameters."""
        p.gravity_tilt = p.gravity_tilt + np.array(self.angles)
