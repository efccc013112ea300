"""Joint friction: other one way than the other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ves_gym._util.params import Vector
from ves_gym.system.effect import TorqueEffect, parameter, register
from ves_gym.system.system import System

CREEP = 1e-2  # rad/s over which friction builds up from rest


@register("joint/asymmetry")
@dataclass(frozen=True, kw_only=True)
class JointAsymmetry(TorqueEffect):
    """Friction larger for v > 0 and smaller for v < 0: its even part.

    Half the difference of the two directions' Coulomb and viscous friction. Where the joint
    moves one way only, a constant torque looks the same (Armstrong-Helouvry et al.,
    Automatica 30(7), 1994; even part: derived here).
    """

    modes = ("ideal", "emulated")
    port = "joint"
    builds_up = True
    creep = CREEP
    coulomb: Vector = parameter("N m", bounds=(-20.0, 20.0), shape=(None,), start=1.0)
    viscous: Vector = parameter("N m s/rad", bounds=(-50.0, 50.0), shape=(None,), start=0.5)

    def check(self, system: System) -> None:
        """One number per joint."""
        self._require_per_joint(system, "coulomb", "viscous")

    def law(self, xp: Any, q: Any, v: Any, tau: Any) -> Any:
        """-coulomb |tanh(v / CREEP)| - viscous |v|."""
        coulomb: Any = self.coulomb
        viscous: Any = self.viscous
        return -coulomb * xp.fabs(xp.tanh(v / CREEP)) - viscous * xp.fabs(v)
