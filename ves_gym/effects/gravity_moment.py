"""Gravity estimate: wrong moment parameters P (thesis eq. 3.9)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ves_gym._util.params import ParameterError, Vector
from ves_gym.mechanics.gravity import minimal_model
from ves_gym.system.deviations import LoopParameters
from ves_gym.system.effect import LaboratoryEffect, parameter, register
from ves_gym.system.system import System


@register("gravity/moment")
@dataclass(frozen=True, kw_only=True)
class GravityMoment(LaboratoryEffect):
    """Errors of the minimal moment parameters, in their order (`minimal_model(arm).names`)."""

    port = "gravity"
    error: Vector = parameter("kg m", bounds=(-20.0, 20.0), null=0.0, shape=(None,))

    def check(self, system: System) -> None:
        """One number per parameter of this arm; only micro-gravity subtracts an estimate."""
        operation = system.emulator_settings.operation
        self._require(operation == "microgravity", f"operation microgravity, got {operation}")
        arm, size = system.arm, minimal_model(system.arm).size
        if len(self.error) != size:
            raise ParameterError(
                f"{self.kind}.error must be {size} numbers for {arm.name},"
                f" got {len(self.error)}"
            )

    def edit(self, p: LoopParameters) -> None:
        """Add the deviation to the machine's parameters."""
        p.gravity_P = p.gravity_P + np.array(self.error)
