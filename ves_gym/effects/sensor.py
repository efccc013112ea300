"""The force sensor."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ves_gym._util.params import Array, Matrix, ParameterError, Vector
from ves_gym.mechanics.spatial import WRENCH
from ves_gym.system.candidate import Candidate, Scope, number_of, placed
from ves_gym.system.deviations import LoopParameters
from ves_gym.system.effect import Effect, LaboratoryEffect, parameter, register_effect
from ves_gym.system.system import System


@register_effect("sensor/bias")
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
        p.sensor.bias = p.sensor.bias + np.array([*self.force, *self.moment])


@register_effect("sensor/calibration")
class SensorCalibration(LaboratoryEffect):
    """Signals are (1 + `error`) times the wrench in the sensor frame: gains on the diagonal,
    cross-talk beside it. Between forces and moments the unit is 1/m or m.
    """

    port = "wrench"
    error: Matrix = parameter("1", bounds=(-0.5, 0.5), shape=(6, 6), start=0.02)

    def edit(self, p: LoopParameters) -> None:
        p.sensor.matrix = p.sensor.matrix + np.array(self.error)


@register_effect("sensor/drift")
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
        if self.is_null:
            return
        added = np.array([*self.force, *self.moment])
        p.sensor.drift = np.sqrt(p.sensor.drift**2 + added**2)
        p.sensor.drift_time = np.full_like(p.sensor.drift_time, self.time)


@register_effect("sensor/lag")
class SensorLag(LaboratoryEffect):
    """The sensor filter's cut-off differs from the stated one by the fraction `error`."""

    port = "wrench"
    error: float = parameter("1", bounds=(-0.9, 10.0), start=(-0.3, 1.0))

    def edit(self, p: LoopParameters) -> None:
        p.sensor.cutoff = p.sensor.cutoff * (1 + self.error)


@register_effect("sensor/noise")
class SensorNoise(LaboratoryEffect):
    """Standard deviation of the signals' noise, as it is left after the sensor's filter."""

    port = "wrench"
    places = "axis"
    hidden = "all that a log shows is judged in units of its noise, which is read from the log"
    force: Vector = parameter("N", bounds=(0.0, 20.0), shape=(3,))
    moment: Vector = parameter("N m", bounds=(0.0, 10.0), shape=(3,))

    def edit(self, p: LoopParameters) -> None:
        added = np.array([*self.force, *self.moment])
        p.sensor.noise = np.sqrt(p.sensor.noise**2 + added**2)


@register_effect("sensor/rotation")
class SensorRotation(LaboratoryEffect):
    """The sensor is turned by the small `angles` about its x, y, z against its stated frame."""

    port = "wrench"
    angles: Vector = parameter("rad", bounds=(-0.1, 0.1), shape=(3,), start=0.01)

    def edit(self, p: LoopParameters) -> None:
        x, y, z = np.array(self.angles)
        o = np.zeros_like(x)
        turn = [[o, z, -y], [-z, o, x], [y, -x, o]]  # -angles x, of force and moment
        blocks = [[*row, o, o, o] for row in turn] + [[o, o, o, *row] for row in turn]
        p.sensor.matrix = p.sensor.matrix + np.array(blocks)


# The nominal error budget of the laboratory: what is left after careful calibration. The
# thesis prints no noise figures (App. F has lost its plots). These are nominal, this project:
# with them the Model Method leaves the errors of Table 3-1 (docs/claims.md).
LABORATORY_ERRORS: tuple[Effect, ...] = (
    SensorNoise(force=(0.35, 0.2, 0.4), moment=(0.3, 0.3, 0.05)),
    SensorDrift(force=(0.25, 0.12, 0.2), moment=(0.5, 0.72, 0.03), time=60.0),
)
