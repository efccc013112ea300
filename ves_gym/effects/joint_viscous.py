"""Joint friction: viscous."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ves_gym.core.effect import Effect, parameter, register
from ves_gym.core.params import ParameterError, Vector
from ves_gym.core.system import System


@register("joint/viscous")
@dataclass(frozen=True, kw_only=True)
class JointViscous(Effect):
    """Friction in proportion to the joint's rate."""

    modes = ("ideal", "emulated")
    damping: Vector = parameter("N m s/rad", bounds=(0.0, 100.0), shape=(None,))

    def check(self, system: System) -> None:
        """One number per joint."""
        n = system.arm.n
        for name in ("damping",):
            if len(getattr(self, name)) != n:
                raise ParameterError(
                    f"{self.kind}.{name} must be {n} numbers, one per joint, got"
                    f" {len(getattr(self, name))}"
                )

    def law(self, xp: Any, q: Any, v: Any) -> Any:
        """-damping v."""
        damping: Any = self.damping
        return -damping * v
