"""What `dynamics` computes with: an arm as arrays.

Lengths and angles are numbers always, and an exact 0 or right angle among them is structure;
masses are numbers or, where a graph is traced, symbols.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ves_gym._util.params import Array
from ves_gym.mechanics.link import Mount, Turn
from ves_gym.mechanics.spatial import room


class JointCoupling(NamedTuple):
    """All joints' q = G q of the n that are driven: each one's (joint, ratio) pairs."""

    rows: tuple[tuple[tuple[int, float], ...], ...]
    n: int

    def full(self, q: Array) -> Array:
        """G q (..., all joints) of q (..., n), or of rates."""
        out = room(q, *q.shape[:-1], len(self.rows))
        for i, row in enumerate(self.rows):
            for j, ratio in row:
                out[..., i] += ratio * q[..., j]
        return out

    def reduced(self, x: Array) -> Array:
        """G^T x (..., n, k) of x (..., all joints, k)."""
        out = room(x, *x.shape[:-2], self.n, x.shape[-1])
        for i, row in enumerate(self.rows):
            for j, ratio in row:
                out[..., j, :] += ratio * x[..., i, :]
        return out


class JointFrame(NamedTuple):
    """Position of a link's frame beyond its joint, as in `Link`."""

    d: float  # m
    a: float  # m
    alpha: Turn
    beta: Turn | None
    offset: float  # rad
    slides: bool


STILL = JointFrame(0.0, 0.0, (1.0, 0.0), None, 0.0, False)  # its link's frame stays where it is


class LinkBodies(NamedTuple):
    """Mass properties of the base link, then of the n links, each in its own frame."""

    mass: Array  # (..., n + 1) kg
    com: Array  # (..., n + 1, 3) m
    inertia: Array  # (..., n + 1, 3, 3) about the centre of mass [kg m^2]
    rotor: Array  # (..., n) kg m^2


class Root(NamedTuple):
    """Pose of an arm's first joint in the platform-top frame, before it turns."""

    first: int  # place of this joint among those of all arms
    rotation: Array  # (3, 3)
    position: Array  # (3,) m
    on: int | None = None  # of a follower: the joint, further back, whose link's frame it is in

    @classmethod
    def at(cls, first: int, mount: Mount | None) -> Root:
        """Of a joint on its mount; None: at the platform-top frame."""
        if mount is None:
            return cls(first, np.eye(3), np.zeros(3))
        return cls(first, mount.rotation, np.array(mount.position))


def spans(roots: Sequence[Root], n: int) -> tuple[slice, ...]:
    """Joints of each arm among the n of all."""
    ends = [*(root.first for root in roots), n]
    return tuple(slice(a, b) for a, b in pairwise(ends))


class Chain(NamedTuple):
    """Data of an arm for `dynamics`: joints, the root of each arm, and masses."""

    joints: tuple[JointFrame, ...]
    roots: tuple[Root, ...]  # one, of a single arm
    bodies: LinkBodies
    coupling: JointCoupling | None
