"""Joint torque: ripple of motor and gear."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

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

_MOST = 500.0  # periods per turn


def _overtone(turned: float, ripple: JointRipple) -> JointRipple:
    """A ripple's second harmonic, `turned` [rad] against the first."""
    cycles = tuple(min(2 * k, _MOST) for k in ripple.cycles)
    phase = (2 * np.array(ripple.phase) + turned + np.pi) % (2 * np.pi) - np.pi
    return dataclasses.replace(ripple, cycles=cycles, phase=tuple(phase.tolist()))


@register("joint/ripple")
@dataclass(frozen=True, kw_only=True)
class JointRipple(TorqueEffect):
    """Torque that repeats `cycles` times per turn of the joint (cogging, gear teeth).

    One harmonic; the PUMA's gears turn their motors 62.6, 107.8 and 53.7 times per turn
    (Corke's Robotics Toolbox model). Several effects make several harmonics; a diagnosis takes
    a second one as a form that the first may have in part.
    """

    modes = ("ideal", "emulated")
    port = "joint"
    forms = (partial(_overtone, 0.0), partial(_overtone, np.pi / 2))
    amplitude: Vector = parameter("N m", bounds=(0.0, 20.0), shape=(None,))
    cycles: Vector = parameter(
        "1",
        bounds=(0.5, _MOST),
        null=None,
        shape=(None,),
        start=tuple(np.arange(2.0, 130.0, 2.5).tolist()),
    )
    phase: Vector = parameter("rad", bounds=(-7.0, 7.0), null=None, shape=(None,))

    def check(self, system: System) -> None:
        """One number per joint."""
        self._require_per_joint(system, "amplitude", "cycles", "phase")

    @classmethod
    def candidates(cls, scope: Scope) -> Iterator[Candidate]:
        """Sine and cosine in place of amplitude and phase: a fit has no corner at zero."""
        waves = [Number(k, "N m", (-14.0, 14.0), (1.0,)) for k in ("sine", "cosine")]
        numbers = [*waves, number_of(cls, "cycles")]
        for joint in range(scope.joints):

            def fields(x: Array, joint: int = joint) -> dict[str, Any]:
                n = scope.joints
                return {
                    "amplitude": at_joint(joint, n, np.hypot(x[0], x[1])),
                    "phase": at_joint(joint, n, np.arctan2(x[1], x[0])),
                    "cycles": at_joint(joint, n, x[2], elsewhere=1.0),
                }

            def periods(x: Array, joint: int = joint) -> float:
                return float(x[2]) * scope.travel[joint] / (2 * np.pi)

            candidate = placed(cls, f"joint {joint + 1}", numbers, fields)
            seen = periods if scope.travel else None
            yield dataclasses.replace(candidate, periods=seen)

    def law(self, xp: Any, q: Any, v: Any, tau: Any) -> Any:
        """amplitude sin(cycles q + phase)."""
        amplitude: Any = self.amplitude
        return amplitude * xp.sin(self.cycles * q + self.phase)
