"""A body that the tool can grasp."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import (
    Array,
    ParameterError,
    Vector,
    finite,
    freeze_arrays,
    require_positive,
    unit,
)
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.dynamics import merged
from ves_gym.mechanics.link import Inertial, Mount, matrix

_ZERO = (0.0, 0.0, 0.0)
_AT_ORIGIN = Mount()


@dataclass(frozen=True, kw_only=True)
class Payload:
    """Rigid body, free in space until the tool's latch closes on its grapple fixture.

    Its own axes are those of `inertial`, `grip` and `size`. `position` and `angles` (Z-Y-X,
    as the base's) place their origin in space at the start; `velocity` is that of its centre
    of mass, `spin` its angular velocity in its own axes. The latch closes where the tool is
    within `latch_distance` of the fixture, and its axes within `latch_angle` of the fixture's
    (None: any turn); as it sits then, so it is carried.
    """

    inertial: Inertial
    grip: Mount = _AT_ORIGIN  # of the grapple fixture: the tool's frame, once grasped
    position: Vector = unit("m", default=_ZERO)
    angles: Vector = unit("rad", default=_ZERO)
    velocity: Vector = unit("m/s", default=_ZERO)
    spin: Vector = unit("rad/s", default=_ZERO)
    latch_distance: float = unit("m", default=0.05)
    latch_angle: float | None = unit("rad", default=None)
    size: Vector | None = unit(
        "m", default=None
    )  # edges of the box drawn; None: as its inertia
    source: str = "stated"

    def __post_init__(self) -> None:
        freeze_arrays(self)
        for name in ("position", "angles", "velocity", "spin"):
            finite(getattr(self, name), (3,), f"Payload.{name}")
        require_positive(self, "latch_distance")
        if self.latch_angle is not None:
            require_positive(self, "latch_angle")
        if self.inertial.mass <= 0:
            raise ParameterError(
                f"Payload.inertial.mass must be > 0 kg, got {self.inertial.mass!r}"
            )
        least = float(np.linalg.eigvalsh(np.array(self.inertial.inertia))[0])
        if not least > 0:  # a free body without one would turn at any rate
            raise ParameterError(
                "Payload.inertial.inertia must be positive definite, got a principal moment of"
                f" {least:.6g} kg m^2"
            )
        if self.size is not None and not (finite(self.size, (3,), "Payload.size") > 0).all():
            raise ParameterError(f"Payload.size must be > 0 m, got {self.size}")

    @cached_property
    def edges(self) -> Array:
        """(3,) edges of the box that stands for it in pictures and contacts [m]."""
        if self.size is not None:
            return np.array(self.size)
        a, b, c = np.diag(np.array(self.inertial.inertia)) * (6 / self.inertial.mass)
        squares = np.maximum([b + c - a, c + a - b, a + b - c], 1e-6)
        return np.asarray(np.sqrt(squares), np.float64)


def carrying(arm: Arm, body: Inertial, place: npt.ArrayLike, turn: npt.ArrayLike) -> Arm:
    """Return the arm with a body fixed to its last link, in whose frame its origin is at a
    place (3,) [m] and its axes at a turn (3, 3)."""
    last = arm.links[-1]
    mass, com, inertia = with_body(
        *numbers_of(last.inertial), *numbers_of(body), np.asarray(place), np.asarray(turn)
    )
    # of the link's own kind: a diagnosis also computes with numbers that no body has
    inertial = replace(
        last.inertial, mass=float(mass), com=tuple(com.tolist()), inertia=matrix(inertia)
    )
    return replace(arm, links=(*arm.links[:-1], replace(last, inertial=inertial)))


def numbers_of(body: Inertial) -> tuple[Array, Array, Array]:
    """Return mass (), centre of mass (3,) and inertia (3, 3) as arrays."""
    return np.array(body.mass), np.array(body.com), np.array(body.inertia)


def with_body(
    mass: Array,
    com: Array,
    inertia: Array,
    other_mass: Array,
    other_com: Array,
    other_inertia: Array,
    place: Array,
    turn: Array,
) -> tuple[Array, Array, Array]:
    """Return mass (...), centre of mass (..., 3) and inertia about it (..., 3, 3) of two bodies
    that are one (parallel axes), in the first one's axes, where the other's origin is at a
    place (..., 3) [m] and its axes at a turn (..., 3, 3)."""
    theirs = place + np.einsum("...ij,...j->...i", turn, other_com)
    turned = turn @ other_inertia @ np.swapaxes(turn, -1, -2)
    turned = (turned + np.swapaxes(turned, -1, -2)) / 2
    return merged([(mass, com, inertia), (other_mass, theirs, turned)])
