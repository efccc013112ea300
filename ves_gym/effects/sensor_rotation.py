"""Force sensor: mounted with a small turn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ves_gym._util.params import Vector
from ves_gym.system.deviations import LoopParameters
from ves_gym.system.effect import LaboratoryEffect, parameter, register


@register("sensor/rotation")
@dataclass(frozen=True, kw_only=True)
class SensorRotation(LaboratoryEffect):
    """The sensor is turned by the small `angles` about its x, y, z against its stated frame."""

    port = "wrench"
    angles: Vector = parameter("rad", bounds=(-0.1, 0.1), shape=(3,), start=0.01)

    def edit(self, p: LoopParameters) -> None:
        """Add the deviation to the machine's parameters."""
        x, y, z = np.array(self.angles)
        o = np.zeros_like(x)
        turn = [[o, z, -y], [-z, o, x], [y, -x, o]]  # -angles x, of force and moment
        blocks = [[*row, o, o, o] for row in turn] + [[o, o, o, *row] for row in turn]
        p.sensor.matrix = p.sensor.matrix + np.array(blocks)
