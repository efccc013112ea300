"""Joint measurements: rates low-passed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ves_gym._util.params import Vector
from ves_gym.system.deviations import Delays
from ves_gym.system.effect import DelayEffect, parameter, register
from ves_gym.system.system import System


@register("joint/velocity_lag")
@dataclass(frozen=True, kw_only=True)
class JointVelocityLag(DelayEffect):
    """Servo and log see joint rates through a first-order low-pass; angles are as they are.

    How drives tell a rate from an encoder: differences, smoothed. Several effects add their
    time constants (derived here).
    """

    modes = ("ideal", "emulated")
    port = "joint"
    shows = ("servo", "velocity")
    time_constant: Vector = parameter(
        "s", bounds=(0.0, 1.0), shape=(None,), start=(0.02, 0.005, 0.2)
    )

    def check(self, system: System) -> None:
        """One number per joint; a joint that follows its command needs no measurement."""
        self._require_per_joint(system, "time_constant")
        self._require_motor(system)

    def wire(self, delays: Delays) -> None:
        """Add to the lag of all simulations."""
        delays.lag = delays.lag + np.array(self.time_constant)
