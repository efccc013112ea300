"""Force sensor: filter slower or faster than stated."""

from __future__ import annotations

from dataclasses import dataclass

from ves_gym.system.deviations import LoopParameters
from ves_gym.system.effect import LaboratoryEffect, parameter, register


@register("sensor/lag")
@dataclass(frozen=True, kw_only=True)
class SensorLag(LaboratoryEffect):
    """The sensor filter's cut-off differs from the stated one by the fraction `error`."""

    port = "wrench"
    error: float = parameter("1", bounds=(-0.9, 10.0), start=(-0.3, 1.0))

    def edit(self, p: LoopParameters) -> None:
        """Add the deviation to the machine's parameters."""
        p.sensor.cutoff = p.sensor.cutoff * (1 + self.error)
