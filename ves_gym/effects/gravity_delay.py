"""Gravity estimate: late (thesis 2.4.1: it comes from another computer)."""

from __future__ import annotations

from dataclasses import dataclass

from ves_gym.system.deviations import LoopParameters
from ves_gym.system.effect import LaboratoryEffect, parameter, register
from ves_gym.system.system import System


@register("gravity/delay")
@dataclass(frozen=True, kw_only=True)
class GravityDelay(LaboratoryEffect):
    """The gravity estimate is of joints and pose `delay` ago."""

    port = "gravity"
    delay: float = parameter("s", bounds=(0.0, 0.5), start=0.02)

    def check(self, system: System) -> None:
        """Only micro-gravity emulation subtracts an estimate."""
        operation = system.emulator_settings.operation
        self._require(operation == "microgravity", f"operation microgravity, got {operation}")

    def edit(self, p: LoopParameters) -> None:
        """Add the deviation to the machine's parameters."""
        p.gravity_delay = p.gravity_delay + self.delay
