"""Joint torque: constant offset."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ves_gym._util.params import Vector
from ves_gym.system.effect import TorqueEffect, parameter, register
from ves_gym.system.system import System


@register("joint/torque_offset")
@dataclass(frozen=True, kw_only=True)
class JointTorqueOffset(TorqueEffect):
    """A constant torque at the joint: an amplifier's offset, a cable's pull.

    Direction-dependent friction (`joint/asymmetry`) looks the same while the joint moves one
    way (derived here).
    """

    modes = ("ideal", "emulated")
    port = "joint"
    torque: Vector = parameter("N m", bounds=(-50.0, 50.0), shape=(None,), start=1.0)

    def check(self, system: System) -> None:
        """One number per joint."""
        self._require_per_joint(system, "torque")

    def law(self, xp: Any, q: Any, v: Any, tau: Any) -> Any:
        """Return the torque, whatever the state."""
        torque: Any = self.torque
        return torque
