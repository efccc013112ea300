"""Force sensor: high-frequency electronic noise (thesis 3.2.4, App. F)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ves_gym._util.params import Vector
from ves_gym.system.deviations import LoopParameters
from ves_gym.system.effect import LaboratoryEffect, parameter, register


@register("sensor/noise")
@dataclass(frozen=True, kw_only=True)
class SensorNoise(LaboratoryEffect):
    """Standard deviation of the signals' noise, as it is left after the sensor's filter."""

    port = "wrench"
    places = "axis"
    hidden = "all that a log shows is judged in units of its noise, which is read from the log"
    force: Vector = parameter("N", bounds=(0.0, 20.0), shape=(3,))
    moment: Vector = parameter("N m", bounds=(0.0, 10.0), shape=(3,))

    def edit(self, p: LoopParameters) -> None:
        """Add the deviation to the machine's parameters."""
        added = np.array([*self.force, *self.moment])
        p.sensor.noise = np.sqrt(p.sensor.noise**2 + added**2)
