"""Gravity estimate: wrong total mass (thesis eq. 3.5)."""

from __future__ import annotations

from dataclasses import dataclass

from ves_gym.system.deviations import LoopParameters
from ves_gym.system.effect import LaboratoryEffect, parameter, register
from ves_gym.system.system import System


@register("gravity/mass")
@dataclass(frozen=True, kw_only=True)
class GravityMass(LaboratoryEffect):
    """The gravity estimate takes the arm for heavier by `error`; its moments are right."""

    port = "gravity"
    error: float = parameter("kg", bounds=(-20.0, 20.0), start=1.0)

    def check(self, system: System) -> None:
        """Only micro-gravity emulation subtracts an estimate."""
        operation = system.emulator_settings.operation
        self._require(operation == "microgravity", f"operation microgravity, got {operation}")

    def edit(self, p: LoopParameters) -> None:
        """Add the deviation to the machine's parameters."""
        p.gravity_mass = p.gravity_mass + self.error
