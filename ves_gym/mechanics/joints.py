"""A chain of joints and bodies as arrays: what `dynamics` computes with.

Lengths and angles are numbers always, and an exact 0 or right angle among them is structure.
Masses are numbers or, where a graph is traced, symbols; leading axes are simulations whose
bodies differ.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, Protocol

import numpy as np

from ves_gym._util.params import Array

Turn = tuple[float, float]  # cosine and sine, to 15 digits: a right angle is exact


class JointFrame(NamedTuple):
    """Where a link's frame lies beyond its joint, as in `Link`."""

    d: float  # m
    a: float  # m
    alpha: Turn
    beta: Turn | None
    offset: float  # rad
    slides: bool

    @staticmethod
    def of(link: Any) -> JointFrame:
        """The joint of a `Link`."""
        beta = turn_by(link.beta) if link.beta else None
        offset, slides = link.offset, bool(link.slides)
        return JointFrame(link.d, link.a, turn_by(link.alpha), beta, offset, slides)


STILL = JointFrame(0.0, 0.0, (1.0, 0.0), None, 0.0, False)  # its link's frame stays where it is


class LinkBodies(NamedTuple):
    """Mass properties of the base link, then of the n links, each in its own frame."""

    mass: Array  # (..., n + 1) kg
    com: Array  # (..., n + 1, 3) m
    inertia: Array  # (..., n + 1, 3, 3) about the centre of mass [kg m^2]
    rotor: Array  # (..., n) kg m^2

    @staticmethod
    def of(base: Any, links: Any) -> LinkBodies:
        """The bodies of a base link's `Inertial` and of `Link`s."""
        parts = [base, *(link.inertial for link in links)]
        return LinkBodies(
            np.array([k.mass for k in parts]),
            np.array([k.com for k in parts]),
            np.array([k.inertia for k in parts]),
            np.array([k.rotor_inertia for k in links]),
        )


class Mechanism(Protocol):
    """Joints and bodies: an arm, or a `Chain`."""

    @property
    def joints(self) -> tuple[JointFrame, ...]:
        """The n joints, first one first."""

    @property
    def start(self) -> tuple[Array, Array]:
        """Rotation and position of the first joint's frame in the platform-top frame."""

    @property
    def bodies(self) -> LinkBodies:
        """What they weigh."""


class Chain(NamedTuple):
    """A `Mechanism` of its parts."""

    joints: tuple[JointFrame, ...]
    start: tuple[Array, Array]
    bodies: LinkBodies


def turn_by(angle: float) -> Turn:
    """Return cosine and sine."""
    return round(math.cos(angle), 15), round(math.sin(angle), 15)
