"""Joint friction: viscous."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ves_gym._util.params import Vector
from ves_gym.system.effect import TorqueEffect, parameter, register
from ves_gym.system.system import System


@register("joint/viscous")
@dataclass(frozen=True, kw_only=True)
class JointViscous(TorqueEffect):
    """Friction in proportion to the joint's rate."""

    modes = ("ideal", "emulated")
    port = "joint"
    damping: Vector = parameter("N m s/rad", bounds=(0.0, 100.0), shape=(None,), start=3.0)

    def check(self, system: System) -> None:
        """One number per joint."""
        self._require_per_joint(system, "damping")

    def law(self, xp: Any, q: Any, v: Any, tau: Any) -> Any:
        """-damping v."""
        damping: Any = self.damping
        return -damping * v
