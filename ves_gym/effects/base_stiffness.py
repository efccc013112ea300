"""Vehicle: stiffness other than described."""

from __future__ import annotations

from dataclasses import dataclass

from ves_gym.mechanics.vehicle import BaseModel, has
from ves_gym.system.effect import BaseEffect, parameter, register
from ves_gym.system.system import System


@register("base/stiffness")
@dataclass(frozen=True, kw_only=True)
class BaseStiffness(BaseEffect):
    """The vehicle's stiffness is K (1 + `error`), its damping as described.

    In the laboratory the vehicle is virtual: it is what the admittance integrates, while
    the payload compensation's arm stays as described (derived here).
    """

    modes = ("ideal", "emulated")
    port = "admittance"
    error: float = parameter("1", bounds=(-0.9, 3.0), start=0.1)

    def check(self, system: System) -> None:
        """A vehicle in free space has no stiffness."""
        self._require(has(system.vehicle, "K"), "a vehicle with stiffness")

    def base(self, base: BaseModel) -> BaseModel:
        """K (1 + error)."""
        return base if self.is_null else base.scaled(stiffness=1 + self.error)
