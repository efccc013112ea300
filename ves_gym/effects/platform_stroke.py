"""Platform: legs that end, or tire, before they should."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ves_gym.system.deviations import LoopParameters
from ves_gym.system.effect import LaboratoryEffect, parameter, register


@register("platform/stroke")
@dataclass(frozen=True, kw_only=True)
class PlatformStroke(LaboratoryEffect):
    """The legs' stroke lacks the fraction `travel`, their speed the fraction `speed`.

    A command beyond is held back silently: on its way from home, or from the last one, in
    proportion. The platform goes there at the speed that takes (derived here). Of several
    such effects the tightest counts.
    """

    port = "platform"
    travel: float = parameter("1", bounds=(0.0, 0.9999))
    speed: float = parameter("1", bounds=(0.0, 0.9999))

    def edit(self, p: LoopParameters) -> None:
        """Tighten the machine's limits."""
        p.platform_travel = np.maximum(p.platform_travel, self.travel)
        p.platform_speed = np.maximum(p.platform_speed, self.speed)
