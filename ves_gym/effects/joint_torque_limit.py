"""Joint drive: saturates early."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ves_gym._util.params import Vector
from ves_gym.system.effect import TorqueEffect, parameter, register
from ves_gym.system.system import System


@register("joint/torque_limit")
@dataclass(frozen=True, kw_only=True)
class JointTorqueLimit(TorqueEffect):
    """Motors give at most (1 - `fraction`) of their stated limit (a current limit).

    The log shows the torque told (derived here).
    """

    modes = ("ideal", "emulated")
    port = "joint"
    sets_in = True
    fraction: Vector = parameter(
        "1",
        bounds=(0.0, 0.95),
        shape=(None,),
        start=tuple((1 - np.geomspace(0.9, 0.05, 16)).tolist()),
    )

    def check(self, system: System) -> None:
        """One number per joint, on motors."""
        self._require_per_joint(system, "fraction")
        self._require_motor(system)

    def law(self, xp: Any, q: Any, v: Any, tau: Any) -> Any:
        """Return the part of tau above (1 - fraction) tau_max, taken away."""
        fraction: Any = self.fraction
        most = (1 - fraction) * self.tau_max
        return xp.fmin(xp.fmax(tau, -most), most) - tau
