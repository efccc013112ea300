"""Vehicle: damping other than described."""

from __future__ import annotations

from dataclasses import dataclass

from ves_gym.mechanics.vehicle import BaseModel, has
from ves_gym.system.effect import BaseEffect, parameter, register
from ves_gym.system.system import System


@register("base/damping")
@dataclass(frozen=True, kw_only=True)
class BaseDamping(BaseEffect):
    """The vehicle's damping is D (1 + `error`).

    Of what the admittance integrates, in the laboratory (derived here).
    """

    modes = ("ideal", "emulated")
    port = "admittance"
    error: float = parameter("1", bounds=(-1.0, 10.0), start=1.0)

    def check(self, system: System) -> None:
        """A vehicle in free space has no damping."""
        self._require(has(system.vehicle, "D"), "a vehicle with damping")

    def base(self, base: BaseModel) -> BaseModel:
        """D (1 + error)."""
        return base if self.is_null else base.scaled(damping=1 + self.error)
