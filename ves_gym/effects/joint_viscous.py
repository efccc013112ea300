"""Joint friction: viscous."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from ves_gym._util.params import Vector
from ves_gym.system.effect import TorqueEffect, parameter, register
from ves_gym.system.system import System


def _cubed(friction: JointViscous) -> JointViscous:
    """Return a friction that doubles its damping at 1 rad/s; a fit may have any share of it."""
    return replace(friction, cubic=friction.cubic + 1.0)


@register("joint/viscous")
@dataclass(frozen=True, kw_only=True)
class JointViscous(TorqueEffect):
    """Friction in proportion to the joint's rate, and in part to its cube.

    Grease thins or thickens with the rate; the cube is the next power that takes the same
    against motion either way (derived here). A diagnosis takes it as a form that the friction
    may have in part.
    """

    modes = ("ideal", "emulated")
    port = "joint"
    forms = (_cubed,)
    damping: Vector = parameter("N m s/rad", bounds=(0.0, 100.0), shape=(None,), start=3.0)
    cubic: float = parameter("s^2/rad^2", bounds=(-10.0, 10.0), null=None, default=0.0)

    def check(self, system: System) -> None:
        """One number per joint."""
        self._require_per_joint(system, "damping")

    def law(self, xp: Any, q: Any, v: Any, tau: Any) -> Any:
        """-damping v (1 + cubic v^2)."""
        damping: Any = self.damping
        cubic: Any = self.cubic
        return -damping * v * (1 + cubic * v * v)
