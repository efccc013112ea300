"""Force sensor: gain errors and cross-talk (thesis 3.2.4, 3.4.5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ves_gym._util.params import Matrix
from ves_gym.system.deviations import LoopParameters
from ves_gym.system.effect import LaboratoryEffect, parameter, register


@register("sensor/calibration")
@dataclass(frozen=True, kw_only=True)
class SensorCalibration(LaboratoryEffect):
    """Signals are (1 + `error`) times the wrench in the sensor frame: gains on the diagonal,
    cross-talk beside it. Between forces and moments the unit is 1/m or m.
    """

    port = "wrench"
    error: Matrix = parameter("1", bounds=(-0.5, 0.5), shape=(6, 6), start=0.02)

    def edit(self, p: LoopParameters) -> None:
        """Add the deviation to the machine's parameters."""
        p.sensor.matrix = p.sensor.matrix + np.array(self.error)
