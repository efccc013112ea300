"""Joint torque along curves of no shape: found by a diagnosis, without a name."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from ves_gym._util.params import ParameterError, Vector
from ves_gym.effects.joint_unknown import CREEP, part
from ves_gym.system.effect import TorqueEffect, parameter, register
from ves_gym.system.system import System

_FAR = (-50.0, 50.0)
KNOTS = {"over_angle": 30, "over_angle_turning": 24, "over_rate": 16}  # that a diagnosis takes


@register("joint/curves")
@dataclass(frozen=True, kw_only=True)
class JointCurves(TorqueEffect):
    """Torque over a joint's angle, over its angle against the way it turns, and over its rate.

    A diagnosis writes it where something is missing that is not in its library: a detent, a
    friction in patches, a cable. Each curve is of straight lines between knots that lie evenly
    over the range it was fitted on, level beyond: of the angle from middle - reach to
    middle + reach, of the rate from -fastest to fastest. A curve is n numbers for each of its
    knots, one knot after the other, or empty.
    """

    modes = ("ideal", "emulated")
    port = "joint"
    places = "whole"
    hidden = "it stands for what has no name; a diagnosis writes it where nothing else is left"
    middle: Vector = parameter("rad", bounds=(-100.0, 100.0), null=None, shape=(None,))
    reach: Vector = parameter("rad", bounds=(1e-3, 100.0), null=None, shape=(None,))
    fastest: Vector = parameter("rad/s", bounds=(1e-3, 100.0), null=None, shape=(None,))
    over_angle: Vector = parameter("N m", bounds=_FAR, shape=(None,), default=())
    over_angle_turning: Vector = parameter("N m", bounds=_FAR, shape=(None,), default=())
    over_rate: Vector = parameter("N m", bounds=_FAR, shape=(None,), default=())

    def check(self, system: System) -> None:
        """One number per joint for each knot, on motors."""
        self._require_per_joint(system, "middle", "reach", "fastest")
        n = system.arm.n
        for name in KNOTS:
            if len(getattr(self, name)) % n:
                raise ParameterError(
                    f"{self.kind}.{name} must be {n} numbers, one per joint, for each knot, or"
                    f" empty, got {len(getattr(self, name))} numbers"
                )
        self._require_motor(system)

    def law(self, xp: Any, q: Any, v: Any, tau: Any) -> Any:
        """Sum of the three curves; the second against the way the joint turns."""
        p: Any = self
        x, rate = (q - p.middle) / p.reach, v / p.fastest
        out = _curve(xp, p.over_angle, x) + _curve(xp, p.over_rate, rate)
        return out - _curve(xp, p.over_angle_turning, x) * xp.tanh(v / CREEP)


def _curve(xp: Any, heights: Any, x: Any) -> Any:
    """Straight lines between heights at knots that lie evenly over -1 to 1, level beyond."""
    array = isinstance(x, np.ndarray)
    n, size = (k.shape[-1] if array else k.shape[0] for k in (x, heights))
    if not size:
        return 0 * x
    knots = size // n
    at = [part(heights, k * n, (k + 1) * n) for k in range(knots)]
    u = ((xp.fabs(x + 1) - xp.fabs(x - 1)) / 2 + 1) * (knots - 1) / 2  # 0 to knots - 1
    out, before = at[0] + 0 * x, 0.0
    for k, (low, high) in enumerate(pairwise(at)):  # slopes change at the knots
        beyond = u if k == 0 else (xp.fabs(u - k) + u - k) / 2
        out, before = out + (high - low - before) * beyond, high - low
    return out
