"""Force sensor: mounted with a small turn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ves_gym._util.params import Vector
from ves_gym.mechanics.arm import skew
from ves_gym.system.deviations import LoopParameters
from ves_gym.system.effect import LaboratoryEffect, parameter, register


@register("sensor/rotation")
@dataclass(frozen=True, kw_only=True)
class SensorRotation(LaboratoryEffect):
    """The sensor is turned by the small `angles` about its x, y, z against its stated frame."""

    port = "wrench"
    angles: Vector = parameter("rad", bounds=(-0.1, 0.1), shape=(3,))

    def edit(self, p: LoopParameters) -> None:
        """Add the deviation to the machine's parameters."""
        turn = np.zeros((6, 6))
        turn[:3, :3] = turn[3:, 3:] = -skew(np.array(self.angles))
        p.sensor.matrix = p.sensor.matrix + turn
