"""Force sensor: constant offset of its signals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ves_gym._util.params import Vector
from ves_gym.system.deviations import LoopParameters
from ves_gym.system.effect import LaboratoryEffect, parameter, register


@register("sensor/bias")
@dataclass(frozen=True, kw_only=True)
class SensorBias(LaboratoryEffect):
    """Offset of the signals in the sensor frame. Zeroing the sensor takes it out."""

    port = "wrench"
    places = "axis"
    force: Vector = parameter(
        "N", bounds=(-100.0, 100.0), shape=(3,), start=2.0, search=(-50.0, 50.0), name="bias"
    )
    moment: Vector = parameter(
        "N m", bounds=(-50.0, 50.0), shape=(3,), start=2.0, search=(-20.0, 20.0), name="bias"
    )

    def edit(self, p: LoopParameters) -> None:
        """Add the deviation to the machine's parameters."""
        p.sensor.bias = p.sensor.bias + np.array([*self.force, *self.moment])
