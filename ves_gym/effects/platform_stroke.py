"""Platform: legs that end, or tire, before they should."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ves_gym.system.candidate import Candidate, Scope, number_of, placed
from ves_gym.system.deviations import LoopParameters
from ves_gym.system.effect import LaboratoryEffect, parameter, register

# What may be missing, in parts of what the legs are told to go: more shows in no run
SHORT = np.geomspace(0.005, 0.6, 16)


@register("platform/stroke")
@dataclass(frozen=True, kw_only=True)
class PlatformStroke(LaboratoryEffect):
    """The legs' stroke lacks the fraction `travel`, their speed the fraction `speed`.

    A command beyond is held back silently: on its way from home, or from the last one, in
    proportion. The platform goes there at the speed that takes (derived here). Of several
    such effects the tightest counts.
    """

    port = "platform"
    sets_in = True
    travel: float = parameter("1", bounds=(0.0, 0.9999))
    speed: float = parameter("1", bounds=(0.0, 0.9999))

    @classmethod
    def candidates(cls, scope: Scope) -> Iterator[Candidate]:
        """Travel, from what the legs are told to go at most."""
        starts = tuple(1 - scope.stretch * (1 - part) for part in SHORT.tolist())
        travel = replace(number_of(cls, "travel"), starts=starts)
        yield placed(cls, "", [travel], lambda x: {"travel": float(x[0])})

    def edit(self, p: LoopParameters) -> None:
        """Tighten the machine's limits."""
        p.platform_travel = np.maximum(p.platform_travel, self.travel)
        p.platform_speed = np.maximum(p.platform_speed, self.speed)
