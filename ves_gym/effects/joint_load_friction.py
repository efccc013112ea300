"""Joint friction: in proportion to the load."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ves_gym._util.params import Vector
from ves_gym.system.effect import TorqueEffect, parameter, register
from ves_gym.system.system import System

CREEP = 1e-2  # rad/s over which friction builds up from rest


@register("joint/load_friction")
@dataclass(frozen=True, kw_only=True)
class JointLoadFriction(TorqueEffect):
    """Friction of the fraction `coefficient` of the motor's torque, against the motion.

    As of gears, whose teeth press harder the more they carry (Armstrong-Helouvry et al.,
    Automatica 30(7), 1994). Motor torque stands for tooth force: exact at steady speed.
    """

    modes = ("ideal", "emulated")
    port = "joint"
    builds_up = True
    creep = CREEP
    coefficient: Vector = parameter("1", bounds=(0.0, 0.5), shape=(None,), start=0.1)

    def check(self, system: System) -> None:
        """One number per joint, on motors."""
        self._require_per_joint(system, "coefficient")
        self._require_motor(system)

    def law(self, xp: Any, q: Any, v: Any, tau: Any) -> Any:
        """-coefficient |tau| tanh(v / CREEP)."""
        coefficient: Any = self.coefficient
        return -coefficient * xp.fabs(tau) * xp.tanh(v / CREEP)
