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
    """The platform's damping ratio differs from the stated one by the fraction `error`.

    Of legs the gain K2 does, which acts on the last change of a leg's length (thesis 5.6).
    """

    port = "platform"
    shows = ("platform", "wrench")
    error: float = parameter("1", bounds=(-0.9, 10.0), start=(0.2, -0.4, 1.5))

    def check(self, system: System) -> None:
        """Legs need a gain that brakes them."""
        servo = system.emulator_settings.platform
        brakes = isinstance(servo, PoseServo) or servo.K2 > 0
        self._require(brakes, "a pose servo, or legs of K2 > 0")

    def edit(self, p: LoopParameters) -> None:
        """Add the deviation to the machine's parameters."""
        p.damping = p.damping + self.error
