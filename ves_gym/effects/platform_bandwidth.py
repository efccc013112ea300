"""Platform: slower or faster than stated."""

from __future__ import annotations

from dataclasses import dataclass

from ves_gym.system.deviations import LoopParameters
from ves_gym.system.effect import LaboratoryEffect, parameter, register


@register("platform/bandwidth")
@dataclass(frozen=True, kw_only=True)
class PlatformBandwidth(LaboratoryEffect):
    """The platform's bandwidth differs from the stated one by the fraction `error`.

    Of legs both gains of their servos do (thesis 5.6), to which their bandwidth is about
    proportional.
    """

    port = "platform"
    shows = ("platform", "wrench")
    error: float = parameter("1", bounds=(-0.9, 10.0), start=(0.2, -0.4, 1.5))

    def edit(self, p: LoopParameters) -> None:
        """Add the deviation to the machine's parameters."""
        p.bandwidth = p.bandwidth + self.error
