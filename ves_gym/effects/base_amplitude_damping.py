"""Vehicle: damping that grows with the amplitude."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ves_gym._util.params import Array, Vector
from ves_gym.mechanics.vehicle import BaseModel, Satellite
from ves_gym.system.effect import BaseEffect, parameter, register
from ves_gym.system.system import System


@register("base/amplitude_damping")
@dataclass(frozen=True, kw_only=True)
class BaseAmplitudeDamping(BaseEffect):
    """A force `coefficient` |Y'| Y' along each axis against the vehicle's motion.

    A mode of amplitude A and angular frequency w loses as much to it as to a viscous damper
    8 / (3 pi) coefficient w A: its damping ratio grows in proportion to the amplitude
    (equivalent linearisation, derived here).
    """

    modes = ("ideal", "emulated")
    port = "admittance"
    coefficient: Vector = parameter(
        "N s^2/m^2, N m s^2", bounds=(0.0, 1e6), shape=(6,), start=500.0
    )

    def check(self, system: System) -> None:
        """Nothing holds a satellite."""
        fits = not isinstance(system.vehicle, Satellite)
        self._require(fits, "a vehicle of M, D, K, got a satellite")

    def base(self, base: BaseModel) -> BaseModel:
        """Drag + coefficient."""
        if self.is_null:
            return base
        drag: Array = np.array(self.coefficient)
        return replace(base, drag=drag if base.drag is None else base.drag + drag)
