"""Platform: hears its command late."""

from __future__ import annotations

from dataclasses import dataclass

from ves_gym.system.deviations import LoopParameters
from ves_gym.system.effect import LaboratoryEffect, parameter, register


@register("platform/delay")
@dataclass(frozen=True, kw_only=True)
class PlatformDelay(LaboratoryEffect):
    """The platform gets the computer's command `delay` later than the loop assumes.

    Linear between two commands; the payload compensation does not know (thesis 2.4.1 has one
    period of it, `EmulatorSettings.delay`).
    """

    port = "platform"
    delay: float = parameter("s", bounds=(0.0, 0.2), start=5e-3)

    def edit(self, p: LoopParameters) -> None:
        """Add the deviation to the machine's parameters."""
        p.platform_delay = p.platform_delay + self.delay
