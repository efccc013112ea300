"""Joint friction: Stribeck."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ves_gym._util.params import Vector
from ves_gym.system.effect import TorqueEffect, parameter, register
from ves_gym.system.system import System

CREEP = 1e-2  # of fade_speed over which friction builds up from rest


@register("joint/stribeck")
@dataclass(frozen=True, kw_only=True)
class JointStribeck(TorqueEffect):
    """Friction that drops from stiction to Coulomb level with speed.

    Smooth at rest, so a loaded joint creeps instead of sticking (Armstrong-Helouvry et al.,
    Automatica 30(7), 1994).
    """

    modes = ("ideal", "emulated")
    port = "joint"
    coulomb: Vector = parameter("N m", bounds=(0.0, 50.0), shape=(None,))
    stiction: Vector = parameter("N m", bounds=(0.0, 80.0), shape=(None,))
    fade_speed: float = parameter("rad/s", bounds=(1e-2, 2.0), null=None, default=0.2)

    def check(self, system: System) -> None:
        """One number per joint."""
        self._require_per_joint(system, "coulomb", "stiction")

    def law(self, xp: Any, q: Any, v: Any, tau: Any) -> Any:
        """Level fading from stiction to Coulomb with (v / fade_speed)^2, against the motion."""
        coulomb: Any = self.coulomb
        stiction: Any = self.stiction
        fade = xp.exp(-((v / self.fade_speed) ** 2))
        level = coulomb + (stiction - coulomb) * fade
        return -level * xp.tanh(v / (CREEP * self.fade_speed))
