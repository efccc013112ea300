"""Force sensor: constant offset of its signals."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ves_gym._util.params import Array, Vector
from ves_gym.mechanics.spatial import WRENCH
from ves_gym.system.candidate import Candidate, Scope, number_of, placed
from ves_gym.system.deviations import LoopParameters
from ves_gym.system.effect import LaboratoryEffect, parameter, register


@register("sensor/bias")
@dataclass(frozen=True, kw_only=True)
class SensorBias(LaboratoryEffect):
    """Offset of the signals in the sensor frame. Zeroing the sensor takes it out."""

    port = "wrench"
    force: Vector = parameter(
        "N", bounds=(-100.0, 100.0), shape=(3,), start=2.0, search=(-50.0, 50.0)
    )
    moment: Vector = parameter(
        "N m", bounds=(-50.0, 50.0), shape=(3,), start=2.0, search=(-20.0, 20.0)
    )

    @classmethod
    def candidates(cls, scope: Scope) -> Iterator[Candidate]:
        """All six signals together, as a sensor that was zeroed elsewhere has them."""
        fields = ("force",) * 3 + ("moment",) * 3
        numbers = [number_of(cls, f, axis) for f, axis in zip(fields, WRENCH, strict=True)]

        def halves(x: Array) -> dict[str, list[float]]:
            return {"force": x[:3].tolist(), "moment": x[3:].tolist()}

        yield placed(cls, "", numbers, halves, sparse=True)

    def edit(self, p: LoopParameters) -> None:
        """Add the deviation to the machine's parameters."""
        p.sensor.bias = p.sensor.bias + np.array([*self.force, *self.moment])
