"""Gravity gradient: what the Earth's attraction does to bodies around a point of an orbit.

Space is seen from a point on a circular orbit, in axes that do not turn. That point falls
freely, so what is felt beside it is the difference of the attraction, to first order in the
distance x from it, with u the direction from the Earth:

    x'' = n^2 (3 u (u . x) - x),

the equations of Clohessy and Wiltshire (1960) before they are written in turning axes. Summed
over a rigid body: the force of its mass at its centre, and the torque 3 n^2 u x (I u) (Wertz,
Spacecraft Attitude Determination and Control, 1978, section 17.2; Hughes, Spacecraft Attitude
Dynamics, 1986, chapter 8). What is left out is 3 |x| / radius of it: 4e-6 at 10 m.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from ves_gym._util.params import (
    Array,
    ParameterError,
    Vector,
    freeze_arrays,
    require_positive,
    unit,
)
from ves_gym.mechanics.arm import Mechanism
from ves_gym.mechanics.carried import placed
from ves_gym.mechanics.dynamics import composites, moments, packed_matvec
from ves_gym.mechanics.link import require_length_1
from ves_gym.mechanics.spatial import cross, matvec, rate_matrix, room, rotation

EARTH = 3.986004418e14  # m^3/s^2, gravitational parameter (WGS 84)
EARTH_RADIUS = 6_378_137.0  # m, at the equator (WGS 84)


@dataclass(frozen=True, kw_only=True)
class Orbit:
    """A circular orbit around the Earth, by its height or its mean motion.

    The origin of space moves along it; axes do not turn. `radial` points away from the Earth at
    time zero, `along` the way the orbit goes.
    """

    kind: ClassVar[str] = "orbit"
    altitude: float | None = unit("m", default=None)  # above the equator's radius
    mean_motion: float | None = unit("rad/s", default=None)
    radial: Vector = unit("1", default=(1.0, 0.0, 0.0))
    along: Vector = unit("1", default=(0.0, 1.0, 0.0))

    def __post_init__(self) -> None:
        freeze_arrays(self)
        stated = [k for k in ("altitude", "mean_motion") if getattr(self, k) is not None]
        require_positive(self, *stated)
        if len(stated) != 1:
            raise ParameterError(
                "Orbit takes altitude [m] or mean_motion [rad/s], got"
                f" altitude={self.altitude}, mean_motion={self.mean_motion}"
            )
        for name in ("radial", "along"):
            require_length_1(getattr(self, name), f"Orbit.{name}")
        if abs(np.dot(self.radial, self.along)) > 1e-9:
            raise ParameterError(
                f"Orbit.along must be square to radial {self.radial}, got {self.along}"
            )

    def __str__(self) -> str:
        return f"orbit of {self.rate:.4g} rad/s ({2 * math.pi / self.rate / 60:.4g} min)"

    @property
    def rate(self) -> float:
        """Mean motion n [rad/s]."""
        if self.mean_motion is not None:
            return self.mean_motion
        assert self.altitude is not None
        return math.sqrt(EARTH / (EARTH_RADIUS + self.altitude) ** 3)

    def up(self, time: Array) -> Array:
        """Direction away from the Earth (..., 3) at times (...) [s]."""
        angle = np.asarray(self.rate * time)[..., None]
        radial, along = np.array(self.radial), np.array(self.along)
        return np.asarray(np.cos(angle) * radial + np.sin(angle) * along, np.float64)


class Tide(NamedTuple):
    """Gravity gradient at an instant, as the equations take it."""

    rate: Array  # (...) n [rad/s]
    up: Array  # (..., 3) u, axes of the pose
    place: Array  # (..., 3) of the pose's origin from the orbit's point [m], its axes


class TidalLoad(NamedTuple):
    """Generalised forces of the gravity gradient."""

    base: Array  # (..., 6) on Y
    joints: Array  # (..., n)
    carried: Array  # (..., k)


def tidal_load(
    tide: Tide, arm: Mechanism, carried: tuple[Any, ...], z: Array, at: Array
) -> TidalLoad:
    """Return what the gravity gradient does at an instant to an arm of all joints, its base
    link with the satellite's body, and k wheels and appendages: pose and joints z (..., 6 + n),
    theirs (..., k)."""
    y, back = z[..., :6], np.swapaxes(rotation(z[..., :6]), -1, -2)
    up, origin = matvec(back, tide.up), matvec(back, y[..., :3] + tide.place)
    square = tide.rate * tide.rate

    def pull(x: Array) -> Array:
        out: Array = square * (3.0 * up * (up * x).sum(axis=-1)[..., None] - x)
        return out

    def load(mass: Array, first: Array, second: Array) -> tuple[Array, Array]:
        """Force and moment about the platform's origin, of bodies with these moments there."""
        force = mass[..., None] * pull(origin) + pull(first)
        turn = 3.0 * square * cross(up, packed_matvec(second, up))
        return force, cross(first, pull(origin)) + turn

    parts = composites(arm, z[..., 6:])
    force, moment = load(*parts.total)
    rows = []
    for i in range(parts.mass.shape[-1]):
        tidal, about = load(parts.mass[..., i], parts.first[..., i, :], parts.second[..., i, :])
        effort = parts.moving[..., i, :] * tidal + parts.turning[..., i, :] * about
        rows.append(effort.sum(axis=-1))
    joints = np.stack(rows, axis=-1)
    if arm.coupling is not None:
        joints = arm.coupling.reduced(joints[..., None])[..., 0]
    efforts = room(at, *at.shape)
    for c, part in enumerate(carried):
        if part.kind == "appendage":  # a wheel's mass is the satellite's own
            com, turned = placed(part, at[..., c])
            mass, axis = np.asanyarray(part.body.mass), np.array(part.axis)
            tidal, about = load(mass, *moments(mass, com, turned))
            force, moment = force + tidal, moment + about
            hinge = about - cross(np.array(part.point), tidal)
            efforts[..., c] = (axis * (hinge if part.joint == "hinge" else tidal)).sum(axis=-1)
    wrench = np.concatenate([force, moment], axis=-1)
    base = matvec(np.swapaxes(rate_matrix(y), -1, -2), wrench)
    return TidalLoad(base, joints, efforts)
