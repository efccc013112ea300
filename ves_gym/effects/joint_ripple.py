"""Joint torque: ripple of motor and gear."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ves_gym._util.params import Vector
from ves_gym.system.effect import TorqueEffect, parameter, register
from ves_gym.system.system import System


@register("joint/ripple")
@dataclass(frozen=True, kw_only=True)
class JointRipple(TorqueEffect):
    """Torque that repeats `cycles` times per turn of the joint (cogging, gear teeth).

    One harmonic; the PUMA's gears turn their motors 62.6, 107.8 and 53.7 times per turn
    (Corke's Robotics Toolbox model). Several effects make several harmonics.
    """

    modes = ("ideal", "emulated")
    port = "joint"
    amplitude: Vector = parameter("N m", bounds=(0.0, 20.0), shape=(None,))
    cycles: Vector = parameter("1", bounds=(0.5, 500.0), null=None, shape=(None,))
    phase: Vector = parameter("rad", bounds=(-7.0, 7.0), null=None, shape=(None,))

    def check(self, system: System) -> None:
        """One number per joint."""
        self._require_per_joint(system, "amplitude", "cycles", "phase")

    def law(self, xp: Any, q: Any, v: Any, tau: Any) -> Any:
        """amplitude sin(cycles q + phase)."""
        amplitude: Any = self.amplitude
        return amplitude * xp.sin(self.cycles * q + self.phase)
