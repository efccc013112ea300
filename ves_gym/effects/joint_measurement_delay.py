"""Joint measurements: old."""

from __future__ import annotations

from dataclasses import dataclass

from ves_gym.system.deviations import Delays
from ves_gym.system.effect import DelayEffect, parameter, register
from ves_gym.system.system import System


@register("joint/measurement_delay")
@dataclass(frozen=True, kw_only=True)
class JointMeasurementDelay(DelayEffect):
    """Servo, gravity estimate and log see joint angles and rates of `delay` ago.

    Rates and angles are linear between two physics steps (derived here).
    """

    modes = ("ideal", "emulated")
    port = "joint"
    shows = ("joint", "wrench")
    delay: float = parameter("s", bounds=(0.0, 0.1), start=5e-3)

    def check(self, system: System) -> None:
        """A joint that follows its command exactly needs no measurement."""
        self._require_motor(system)

    def wire(self, delays: Delays) -> None:
        """Add to the delay of all simulations."""
        delays.measurement = delays.measurement + self.delay
