"""Vehicle: mass other than described."""

from __future__ import annotations

from dataclasses import dataclass

from ves_gym.mechanics.vehicle import BaseModel
from ves_gym.system.effect import BaseEffect, parameter, register


@register("base/virtual_mass")
@dataclass(frozen=True, kw_only=True)
class BaseVirtualMass(BaseEffect):
    """The vehicle's mass matrix is M (1 + `error`), or its body that much heavier.

    Stiffness and damping as described; in the laboratory it is the mass that the admittance
    integrates (derived here).
    """

    modes = ("ideal", "emulated")
    port = "admittance"
    error: float = parameter("1", bounds=(-0.9, 3.0), start=0.1)

    def base(self, base: BaseModel) -> BaseModel:
        """M (1 + error), and the same for a satellite's mass and inertia."""
        return base if self.is_null else base.scaled(mass=1 + self.error)
