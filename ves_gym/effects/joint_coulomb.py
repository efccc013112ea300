"""Joint friction: Coulomb."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ves_gym._util.params import Vector
from ves_gym.system.effect import TorqueEffect, parameter, register
from ves_gym.system.system import System

CREEP = 1e-2  # rad/s over which friction builds up from rest


@register("joint/coulomb")
@dataclass(frozen=True, kw_only=True)
class JointCoulomb(TorqueEffect):
    """Friction of constant size against the motion; smooth at rest, so a joint creeps."""

    modes = ("ideal", "emulated")
    port = "joint"
    builds_up = True
    creep = CREEP
    torque: Vector = parameter("N m", bounds=(0.0, 50.0), shape=(None,), start=2.0)

    def check(self, system: System) -> None:
        """One number per joint."""
        self._require_per_joint(system, "torque")

    def law(self, xp: Any, q: Any, v: Any, tau: Any) -> Any:
        """Return -torque tanh(v / CREEP)."""
        torque: Any = self.torque
        return -torque * xp.tanh(v / CREEP)
