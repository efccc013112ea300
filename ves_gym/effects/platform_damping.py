"""Platform: damping ratio other than stated."""

from __future__ import annotations

from dataclasses import dataclass

from ves_gym.hardware.platform import PoseServo
from ves_gym.system.deviations import LoopParameters
from ves_gym.system.effect import LaboratoryEffect, parameter, register
from ves_gym.system.system import System


@register("platform/damping")
@dataclass(frozen=True, kw_only=True)
class PlatformDamping(LaboratoryEffect):
    """The platform's damping ratio differs from the stated one by the fraction `error`."""

    port = "platform"
    error: float = parameter("1", bounds=(-0.9, 10.0), start=(0.2, -0.4, 1.5))

    def check(self, system: System) -> None:
        """Legs have gains of their own instead."""
        servo = system.emulator_settings.platform
        self._require(isinstance(servo, PoseServo), f"a pose servo, got {servo.kind}")

    def edit(self, p: LoopParameters) -> None:
        """Add the deviation to the machine's parameters."""
        p.damping = p.damping + self.error
