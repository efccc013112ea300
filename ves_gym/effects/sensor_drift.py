"""Force sensor: slow thermal drift (thesis 3.2.4, App. F)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ves_gym._util.params import ParameterError, Vector
from ves_gym.system.deviations import LoopParameters
from ves_gym.system.effect import LaboratoryEffect, parameter, register
from ves_gym.system.system import System


@register("sensor/drift")
@dataclass(frozen=True, kw_only=True)
class SensorDrift(LaboratoryEffect):
    """A first-order Gauss-Markov process on the signals, zero when the sensor is reset.

    Its standard deviation grows towards that given over the correlation time.
    """

    port = "wrench"
    places = "axis"
    wanders = True
    force: Vector = parameter("N", bounds=(0.0, 20.0), shape=(3,))
    moment: Vector = parameter("N m", bounds=(0.0, 10.0), shape=(3,))
    time: float = parameter("s", bounds=(1.0, 3600.0), null=None, default=60.0)

    def check(self, system: System) -> None:
        """A sensor has one correlation time."""
        times = {e.time for e in system.effects if isinstance(e, SensorDrift) and not e.is_null}
        if len(times) > 1:
            stated = ", ".join(f"{t:g} s" for t in sorted(times))
            raise ParameterError(f"effects {self.kind} must share one time, got {stated}")

    def edit(self, p: LoopParameters) -> None:
        """Add the deviation to the machine's parameters."""
        if self.is_null:
            return
        added = np.array([*self.force, *self.moment])
        p.sensor.drift = np.sqrt(p.sensor.drift**2 + added**2)
        p.sensor.drift_time = np.full_like(p.sensor.drift_time, self.time)
