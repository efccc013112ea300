"""Joint drive: torque constant other than stated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ves_gym._util.params import Vector
from ves_gym.system.effect import TorqueEffect, parameter, register
from ves_gym.system.system import System


@register("joint/drive_gain")
@dataclass(frozen=True, kw_only=True)
class JointDriveGain(TorqueEffect):
    """Motors give (1 + `error`) times the torque they are told to.

    An error of torque constant, gear ratio or current calibration (derived here). The log
    shows the torque told.
    """

    modes = ("ideal", "emulated")
    port = "joint"
    error: Vector = parameter("1", bounds=(-0.5, 0.5), shape=(None,), start=0.05)

    def check(self, system: System) -> None:
        """One number per joint, on motors."""
        self._require_per_joint(system, "error")
        self._require_motor(system)

    def law(self, xp: Any, q: Any, v: Any, tau: Any) -> Any:
        """error tau."""
        error: Any = self.error
        return error * tau
