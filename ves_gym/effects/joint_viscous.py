"""Joint friction: viscous."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ves_gym._util.params import Vector
from ves_gym.system.effect import TorqueEffect, parameter, register
from ves_gym.system.system import System


def _cubed(friction: JointViscous) -> Cubed:
    """Return a friction that doubles its damping at 1 rad/s; a fit may have any share of it."""
    return Cubed(damping=friction.damping)


@register("joint/viscous")
@dataclass(frozen=True, kw_only=True)
class JointViscous(TorqueEffect):
    """Friction in proportion to the joint's rate.

    Grease thins or thickens with the rate; the cube is the next power that takes the same
    against motion either way (derived here). A diagnosis takes it as a form that the friction
    may have in part.
    """

    modes = ("ideal", "emulated")
    port = "joint"
    forms = (_cubed,)
    damping: Vector = parameter("N m s/rad", bounds=(0.0, 100.0), shape=(None,), start=3.0)

    def check(self, system: System) -> None:
        """One number per joint."""
        self._require_per_joint(system, "damping")

    def law(self, xp: Any, q: Any, v: Any, tau: Any) -> Any:
        """-damping v."""
        damping: Any = self.damping
        return -damping * v


@dataclass(frozen=True, kw_only=True)
class Cubed(JointViscous):
    """Viscous friction with as much again in proportion to the cube of the rate [rad/s]."""

    def law(self, xp: Any, q: Any, v: Any, tau: Any) -> Any:
        """-damping v (1 + v^2)."""
        return super().law(xp, q, v, tau) * (1 + v * v)
