"""Joint friction: Stribeck."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from ves_gym._util.params import Array, Vector
from ves_gym.system.candidate import (
    Candidate,
    Number,
    Scope,
    at_joint,
    number_of,
    placed,
)
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
    builds_up = True
    within = "joint/coulomb"
    coulomb: Vector = parameter("N m", bounds=(0.0, 50.0), shape=(None,), start=2.0)
    stiction: Vector = parameter("N m", bounds=(0.0, 80.0), shape=(None,))
    fade_speed: float = parameter(
        "rad/s", bounds=(1e-2, 2.0), null=None, default=0.2, start=(0.05, 0.2)
    )

    @property
    def creep(self) -> float:
        """Rate over which it builds up from rest [rad/s]."""
        return CREEP * self.fade_speed

    def check(self, system: System) -> None:
        """One number per joint."""
        self._require_per_joint(system, "coulomb", "stiction")

    @classmethod
    def candidates(cls, scope: Scope) -> Iterator[Candidate]:
        """Stiction by what it is above Coulomb's level, in parts of that: no corner between."""
        breakaway = Number("breakaway", "1", (0.0, 3.0), (1.0,), factor=False)
        numbers = [number_of(cls, "coulomb"), breakaway, number_of(cls, "fade_speed")]
        for joint in range(scope.joints):

            def fields(x: Array, joint: int = joint) -> dict[str, Any]:
                levels = x[0], x[0] * (1 + x[1])
                coulomb, stiction = (at_joint(joint, scope.joints, k) for k in levels)
                return {"coulomb": coulomb, "stiction": stiction, "fade_speed": float(x[2])}

            yield placed(cls, f"joint {joint + 1}", numbers, fields)

    def law(self, xp: Any, q: Any, v: Any, tau: Any) -> Any:
        """Level fading from stiction to Coulomb with (v / fade_speed)^2, against the motion."""
        coulomb: Any = self.coulomb
        stiction: Any = self.stiction
        fade = xp.exp(-((v / self.fade_speed) ** 2))
        level = coulomb + (stiction - coulomb) * fade
        return -level * xp.tanh(v / self.creep)
