"""Gravity estimate: too large as a whole (thesis 3.2.1, 3.2.2)."""

from __future__ import annotations

from dataclasses import dataclass

from ves_gym.system.deviations import LoopParameters
from ves_gym.system.effect import LaboratoryEffect, parameter, register
from ves_gym.system.system import System


@register("gravity/scale")
@dataclass(frozen=True, kw_only=True)
class GravityScale(LaboratoryEffect):
    """The gravity estimate is too large by the fraction `error`, force and moment alike."""

    port = "gravity"
    error: float = parameter("1", bounds=(-0.2, 0.2), start=0.01)

    def check(self, system: System) -> None:
        """Only micro-gravity emulation subtracts an estimate."""
        operation = system.emulator_settings.operation
        self._require(operation == "microgravity", f"operation microgravity, got {operation}")

    def edit(self, p: LoopParameters) -> None:
        """Add the deviation to the machine's parameters."""
        p.gravity_mass = p.gravity_mass * (1 + self.error)
        p.gravity_P = p.gravity_P * (1 + self.error)
