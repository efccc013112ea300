"""Torques at the joints that a diagnosis finds, and no law of the library has a name for."""

from __future__ import annotations

import dataclasses
from itertools import combinations_with_replacement, pairwise
from typing import Any

import numpy as np

from ves_gym._util.params import Array, ParameterError, Vector
from ves_gym.effects.joint_friction import CREEP
from ves_gym.system.deviations import Delays
from ves_gym.system.effect import DelayEffect, TorqueEffect, parameter, register_effect
from ves_gym.system.system import System

SLOW = 0.1  # rad/s over which friction at rest fades
CUBIC = 3  # joints up to which products of three angles are taken, beyond it of two
_FAR = (-50.0, 50.0)


def monomials(n: int) -> tuple[tuple[int, ...], ...]:
    """Return the products of angles of n joints that a surface has, by numbers of the joints.

    Args:
        n: joints.
    """
    degrees = range(1, (3 if n <= CUBIC else 2) + 1)
    return tuple(c for d in degrees for c in combinations_with_replacement(range(n), d))


@register_effect("joint/unknown")
class JointUnknown(TorqueEffect):
    """Torque regressed on the angles of all joints, and on the rate of its own.

    A diagnosis writes it where something is missing that is not in its library, so that the
    gap shrinks all the same. `surface` has the weights of the first products of
    x = (q - middle) / reach (`monomials`), n numbers each, one after the other. Outside the
    range that it was fitted on the torque goes on as at its ends.
    """

    places = "whole"
    needs_motor = True
    free_length = ("surface",)
    hidden = "it stands for what has no name; a diagnosis writes it where nothing else is left"
    middle: Vector = parameter("rad", bounds=(-100.0, 100.0), null=None, shape=(None,))
    reach: Vector = parameter("rad", bounds=(1e-3, 100.0), null=None, shape=(None,))
    surface: Vector = parameter("N m", bounds=_FAR, shape=(None,))
    level: Vector = parameter("N m", bounds=_FAR, shape=(None,))
    coulomb: Vector = parameter("N m", bounds=_FAR, shape=(None,))
    coulomb_along: Vector = parameter("N m", bounds=_FAR, shape=(None,))
    fading: Vector = parameter("N m", bounds=_FAR, shape=(None,))
    asymmetry: Vector = parameter("N m", bounds=_FAR, shape=(None,))
    viscous: Vector = parameter("N m s/rad", bounds=_FAR, shape=(None,))
    viscous_asymmetry: Vector = parameter("N m s/rad", bounds=_FAR, shape=(None,))
    quadratic: Vector = parameter("N m s^2/rad^2", bounds=_FAR, shape=(None,))

    @classmethod
    def unit_of(cls, name: str) -> str:
        """Unit of a weight.

        Args:
            name: of the parameter.
        """
        units = {f.name: f.metadata["unit"] for f in dataclasses.fields(cls)}
        return str(units[name])

    def check(self, system: System) -> None:
        """Of the surface one number per joint and product it has."""
        super().check(system)
        n, most = system.arm.n, len(monomials(system.arm.n))
        if len(self.surface) % n or not 0 < len(self.surface) <= n * most:
            raise ParameterError(
                f"{self.kind}.surface must be {n} numbers for each of the first products of"
                f" angles, of which there are {most}, got {len(self.surface)} numbers"
            )

    def law(self, q: Array, v: Array, tau: Array) -> Any:
        """Sum of the weights, each times its term."""
        p: Any = self
        x = (q - p.middle) / p.reach
        x = (np.abs(x + 1) - np.abs(x - 1)) / 2  # within -1 and 1
        n, size = x.shape[-1], p.surface.shape[-1]
        way, fast = np.tanh(v / CREEP), np.abs(v)
        out = p.level + p.asymmetry * np.abs(way)
        for k, factors in enumerate(monomials(n)[: size // n]):
            term = p.surface[..., k * n : (k + 1) * n]
            for joint in factors:
                term = term * x[..., joint, None]
            out = out + term
        friction = (p.coulomb + p.coulomb_along * x + p.fading * np.exp(-fast / SLOW)) * way
        curved = (
            p.quadratic * v / (1 + fast)
        )  # beyond 1 rad/s as a viscous friction: no run-away
        return out + friction + p.viscous * v + (p.viscous_asymmetry + curved) * fast


WEIGHTS = (
    *("level", "coulomb", "coulomb_along", "fading", "asymmetry"),
    *("viscous", "viscous_asymmetry", "quadratic"),
)


KNOTS = {"over_angle": 30, "over_angle_turning": 24, "over_rate": 16}  # that a diagnosis takes


@register_effect("joint/curves")
class JointCurves(TorqueEffect):
    """Torque over a joint's angle, over its angle against the way it turns, and over its rate.

    A diagnosis writes it where something is missing that is not in its library: a detent, a
    friction in patches, a cable. Each curve is of straight lines between knots that lie evenly
    over the range it was fitted on, level beyond: of the angle from middle - reach to
    middle + reach, of the rate from -fastest to fastest. A curve is n numbers for each of its
    knots, one knot after the other, or empty.
    """

    places = "whole"
    needs_motor = True
    free_length = tuple(KNOTS)
    hidden = "it stands for what has no name; a diagnosis writes it where nothing else is left"
    middle: Vector = parameter("rad", bounds=(-100.0, 100.0), null=None, shape=(None,))
    reach: Vector = parameter("rad", bounds=(1e-3, 100.0), null=None, shape=(None,))
    fastest: Vector = parameter("rad/s", bounds=(1e-3, 100.0), null=None, shape=(None,))
    over_angle: Vector = parameter("N m", bounds=_FAR, shape=(None,), default=())
    over_angle_turning: Vector = parameter("N m", bounds=_FAR, shape=(None,), default=())
    over_rate: Vector = parameter("N m", bounds=_FAR, shape=(None,), default=())

    def check(self, system: System) -> None:
        """One number per joint for each knot."""
        super().check(system)
        n = system.arm.n
        for name in KNOTS:
            if len(getattr(self, name)) % n:
                raise ParameterError(
                    f"{self.kind}.{name} must be {n} numbers, one per joint, for each knot, or"
                    f" empty, got {len(getattr(self, name))} numbers"
                )

    def law(self, q: Array, v: Array, tau: Array) -> Any:
        """Sum of the three curves; the second against the way the joint turns."""
        p: Any = self
        x, rate = (q - p.middle) / p.reach, v / p.fastest
        out = _curve(p.over_angle, x) + _curve(p.over_rate, rate)
        return out - _curve(p.over_angle_turning, x) * np.tanh(v / CREEP)


def _curve(heights: Array, x: Array) -> Any:
    """Straight lines between heights at knots that lie evenly over -1 to 1, level beyond."""
    n, size = x.shape[-1], heights.shape[-1]
    if not size:
        return 0 * x
    knots = size // n
    at = [heights[..., k * n : (k + 1) * n] for k in range(knots)]
    u = ((np.abs(x + 1) - np.abs(x - 1)) / 2 + 1) * (knots - 1) / 2  # 0 to knots - 1
    out, before = at[0] + 0 * x, 0 * at[0]
    for k, (low, high) in enumerate(pairwise(at)):  # slopes change at the knots
        beyond = u if k == 0 else (np.abs(u - k) + u - k) / 2
        out, before = out + (high - low - before) * beyond, high - low
    return out


_FARTHER = (-500.0, 500.0)
LEVELS = ("lasting", "rested_fast", "rested", "rested_slow")  # in the order of `RESTING`


@register_effect("joint/memory")
class JointMemory(DelayEffect):
    """Friction that builds up over a distance after a reversal and grows while a joint rests.

    A diagnosis writes it where something is missing that is not in its library. The torque is
    -z max(0, lasting + sum of rested_k a_k), z a bristle's deflection, z' = (v - |v| z) / b,
    and the age a_k of the rest in parts of 1, a_k' = (1 - a_k) / T_k - |v| a_k / c
    (`rest_friction`). |z| <= 1, so it is bounded; it takes energy out but for what the bristles
    hold, the level times b / 2 at most.
    """

    shows = ("joint",)
    needs_motor = True
    hidden = "it stands for what has no name; a diagnosis writes it where nothing else is left"
    lasting: Vector = parameter("N m", bounds=_FARTHER, shape=(None,))
    rested_fast: Vector = parameter("N m", bounds=_FARTHER, shape=(None,))  # T of 0.5 s
    rested: Vector = parameter("N m", bounds=_FARTHER, shape=(None,))  # 1.5 s
    rested_slow: Vector = parameter("N m", bounds=_FARTHER, shape=(None,))  # 5 s

    @property
    def levels(self) -> Array:
        """(joints, 1 + K, ...) lasting friction, and that of each time of rest [N m]."""
        return np.stack([np.asarray(getattr(self, name), float) for name in LEVELS], axis=1)

    def wire(self, delays: Delays) -> None:
        delays.friction = delays.friction + self.levels
