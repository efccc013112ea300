"""Joint torque: found by a diagnosis, and no law of the library has a name for it."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import Any

import numpy as np

from ves_gym._util.params import ParameterError, Vector
from ves_gym.system.effect import TorqueEffect, parameter, register
from ves_gym.system.system import System

CREEP = 1e-2  # rad/s over which friction builds up from rest
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


@register("joint/unknown")
@dataclass(frozen=True, kw_only=True)
class JointUnknown(TorqueEffect):
    """Torque regressed on the angles of all joints, and on the rate of its own.

    A diagnosis writes it where something is missing that is not in its library, so that the
    gap shrinks all the same. `surface` has the weights of the first products of
    x = (q - middle) / reach (`monomials`), n numbers each, one after the other. Outside the
    range that it was fitted on the torque goes on as at its ends.
    """

    modes = ("ideal", "emulated")
    port = "joint"
    places = "whole"
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
        """One number per joint, of the surface one per joint and product it has, on motors."""
        self._require_per_joint(system, "middle", "reach", *WEIGHTS)
        n, most = system.arm.n, len(monomials(system.arm.n))
        if len(self.surface) % n or not 0 < len(self.surface) <= n * most:
            raise ParameterError(
                f"{self.kind}.surface must be {n} numbers for each of the first products of"
                f" angles, of which there are {most}, got {len(self.surface)} numbers"
            )
        self._require_motor(system)

    def law(self, xp: Any, q: Any, v: Any, tau: Any) -> Any:
        """Sum of the weights, each times its term."""
        p: Any = self
        x = (q - p.middle) / p.reach
        x = (xp.fabs(x + 1) - xp.fabs(x - 1)) / 2  # within -1 and 1
        array = isinstance(x, np.ndarray)
        n, size = (k.shape[-1] if array else k.shape[0] for k in (x, p.surface))
        way, fast = xp.tanh(v / CREEP), xp.fabs(v)
        out = p.level + p.asymmetry * xp.fabs(way)
        for k, factors in enumerate(monomials(n)[: size // n]):
            term = part(p.surface, k * n, (k + 1) * n)
            for joint in factors:
                term = term * part(x, joint, joint + 1)
            out = out + term
        friction = (p.coulomb + p.coulomb_along * x + p.fading * xp.exp(-fast / SLOW)) * way
        curved = (
            p.quadratic * v / (1 + fast)
        )  # beyond 1 rad/s as a viscous friction: no run-away
        return out + friction + p.viscous * v + (p.viscous_asymmetry + curved) * fast


def part(x: Any, begin: int, end: int) -> Any:
    """Return entries of a vector: the last axis of an array, the rows of a symbol.

    Args:
        x: array or symbol.
        begin, end: of the entries.
    """
    return x[..., begin:end] if isinstance(x, np.ndarray) else x[begin:end]


WEIGHTS = (
    *("level", "coulomb", "coulomb_along", "fading", "asymmetry"),
    *("viscous", "viscous_asymmetry", "quadratic"),
)
