"""Joint friction: in proportion to the load."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ves_gym._util.params import Vector
from ves_gym.system.effect import TorqueEffect, parameter, register
from ves_gym.system.system import System

CREEP = 1e-2  # rad/s over which friction builds up from rest
_PRESSED = 0.01  # of the motor's limit: what teeth may carry without a load


def _pressed(friction: JointLoadFriction) -> Pressed:
    """Return a friction whose teeth are pressed together; a fit may have any share of it."""
    return Pressed(coefficient=friction.coefficient)


@register("joint/load_friction")
@dataclass(frozen=True, kw_only=True)
class JointLoadFriction(TorqueEffect):
    """Friction of the fraction `coefficient` of the motor's torque, against the motion.

    As of gears, whose teeth press harder the more they carry (Armstrong-Helouvry et al.,
    Automatica 30(7), 1994). Motor torque stands for tooth force: exact at steady speed. Teeth
    that are pressed together rub under no load, too (no-load friction of gears; ibid.): a
    diagnosis takes that as a form that the friction may have in part.
    """

    modes = ("ideal", "emulated")
    port = "joint"
    builds_up = True
    forms = (_pressed,)
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


@dataclass(frozen=True, kw_only=True)
class Pressed(JointLoadFriction):
    """Friction of the fraction `coefficient` of torque and what presses the teeth together."""

    def law(self, xp: Any, q: Any, v: Any, tau: Any) -> Any:
        """-coefficient (|tau| + what presses) tanh(v / CREEP)."""
        coefficient: Any = self.coefficient
        more = coefficient * _PRESSED * self.tau_max * xp.tanh(v / CREEP)
        return super().law(xp, q, v, tau) - more
