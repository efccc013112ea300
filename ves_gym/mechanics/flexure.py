"""Arms whose links bend: the chain of all joints, driven and passive.

An `Arm` with flexures is, for whatever does not ask, the arm with rigid links. `unfold`
returns the ordinary arm of n + p joints in which each flexure is a joint of its own.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, ParameterError
from ves_gym.mechanics.chain import LinkMass, Lump, about_z, angles_of, far_end, upright
from ves_gym.mechanics.dynamics import inertia, joint_positions
from ves_gym.mechanics.serial_chain import (
    Flexure,
    Inertial,
    Link,
    Mount,
    SerialChain,
    matrix,
)

_LEAST = 1e-9  # share of a link's mass below which nothing is left of it


class Whole(NamedTuple):
    """An arm with all its joints as links, and which of them are passive."""

    arm: SerialChain  # n + p links, none of them bends
    driven: tuple[int, ...]  # (n,) place of each driven joint among all
    passive: tuple[int, ...]  # (p,) of each flexure
    stiffness: Array  # (p,) [N m/rad]
    damping: Array  # (p,) [N m s/rad]

    def angles(self, q: npt.ArrayLike, d: npt.ArrayLike = 0.0) -> Array:
        """Return driven and passive coordinates, or rates, in the order of the chain.

        Args:
            q: (..., n) of the driven joints.
            d: (..., p) deflections.

        Returns:
            (..., n + p).
        """
        driven, bent = np.asarray(q, float), np.asarray(d, float)
        p = len(self.passive)
        bent = np.broadcast_to(bent, (*driven.shape[:-1], p) if bent.ndim == 0 else bent.shape)
        batch = np.broadcast_shapes(driven.shape[:-1], bent.shape[:-1])
        out = np.empty((*batch, self.arm.n))
        out[..., list(self.driven)], out[..., list(self.passive)] = driven, bent
        return out

    def inertia(self, q: npt.ArrayLike, d: npt.ArrayLike) -> Array:
        """Return the inertia matrix over base twist, flexures and driven joints.

        Args:
            q: (..., n) [rad].
            d: (..., p) deflections [rad].

        Returns:
            (..., 6 + p + n, 6 + p + n), rows in this order.
        """
        order = np.r_[:6, 6 + np.array(self.passive, int), 6 + np.array(self.driven, int)]
        H = inertia(self.arm, self.angles(q, d))
        out: Array = H[..., order[:, None], order]
        return out

    def tool(self, q: npt.ArrayLike, d: npt.ArrayLike) -> Array:
        """Return the tool's place in the platform-top frame.

        Args:
            q: (..., n) [rad].
            d: (..., p) deflections [rad].

        Returns:
            (..., 3) [m].
        """
        return joint_positions(self.arm, self.angles(q, d))[..., -1, :]


@lru_cache(maxsize=64)
def unfold(arm: SerialChain) -> Whole:
    """Return the chain of all joints of an arm whose links may bend.

    Raises:
        ParameterError: the parts beyond the flexures weigh more than their link.
    """
    links: list[Link] = []
    driven: list[int] = []
    springs: list[Flexure] = []
    passive: list[int] = []
    at_mount = _Frame(np.eye(3), np.zeros(3))
    mount, base, turn = arm.mount, arm.base, 0.0
    if arm.base_flexures:
        base = _remaining(arm.base, arm.base_flexures, at_mount, "base")
        R = np.eye(3) if mount is None else mount.rotation
        p = np.zeros(3) if mount is None else np.array(mount.position)
        first = arm.base_flexures[0]
        start = upright(np.array(first.axis))
        mount = Mount(position=first.origin, angles=angles_of(start))
        chain, turn = _hops(arm.base_flexures, _Frame(start, np.array(first.origin)), (R, p))
        passive += range(len(chain))
        springs += arm.base_flexures
        links += chain
    for i, link in enumerate(arm.links, start=1):
        offset, driven = link.offset + turn, [*driven, len(links)]
        turn = 0.0
        if not link.flexures:
            links.append(replace(link, offset=offset))
            continue
        # everything in the link's own frame, in which the joint lies at its far end's inverse
        R, p = link.far_end
        joint = _Frame(R.T, -R.T @ p)
        first = link.flexures[0]
        root, frame = joint.reach(first.origin, first.axis)
        rest = _remaining(link.inertial, link.flexures, frame, f"link {i}")
        offset += root.pop("offset")
        links.append(replace(link, **root, offset=offset, inertial=rest, flexures=None))
        chain, turn = _hops(link.flexures, frame, (np.eye(3), np.zeros(3)))
        passive += range(len(links), len(links) + len(chain))
        springs += link.flexures
        links += chain
    whole = replace(
        arm, base=base, base_flexures=None, mount=mount, links=tuple(links), base_shape=None
    )
    return Whole(
        whole,
        tuple(driven),
        tuple(passive),
        np.array([k.stiffness for k in springs]),
        np.array([k.damping for k in springs]),
    )


class _Frame(NamedTuple):
    """A joint's frame before it turns, z along its axis."""

    rotation: Array  # (3, 3)
    position: Array  # (3,) [m]

    def reach(
        self, origin: npt.ArrayLike, axis: npt.ArrayLike
    ) -> tuple[dict[str, Any], _Frame]:
        """Return the link that leads from this joint to a next one, and that one's frame."""
        R, p = self
        way = far_end(R.T @ (np.array(origin) - p), R.T @ np.array(axis))
        a, b = way["alpha"], way["beta"]
        about_x = np.array(
            [[1, 0, 0], [0, math.cos(a), -math.sin(a)], [0, math.sin(a), math.cos(a)]]
        )
        about_y = np.array(
            [[math.cos(b), 0, math.sin(b)], [0, 1, 0], [-math.sin(b), 0, math.cos(b)]]
        )
        turned = R @ about_z(way["offset"]) @ about_x @ about_y
        return way | {"beta": b or None}, _Frame(turned, np.array(origin, float))


def _hops(
    flexures: tuple[Flexure, ...], frame: _Frame, end: tuple[Array, Array]
) -> tuple[list[Link], float]:
    """Links of the flexures up to a frame at the end, and what that is turned about its z."""
    out = []
    for k, flexure in enumerate(flexures):
        last = k + 1 == len(flexures)
        axis = end[0][:, 2] if last else flexures[k + 1].axis
        origin = end[1] if last else flexures[k + 1].origin
        way, frame = frame.reach(origin, axis)
        lump = _lump(flexure.beyond)
        out.append(
            Link(
                **way,
                inertial=lump.inertial(frame.rotation, frame.position),
                q_min=-math.pi,
                q_max=math.pi,
                v_max=1.0,
                a_max=1.0,
                tau_max=1.0,
            )
        )
    turned = frame.rotation.T @ end[0]
    return out, math.atan2(turned[1, 0], turned[0, 0])


def _lump(inertial: Inertial, sign: float = 1.0) -> Lump:
    lump = Lump()
    com, moments = np.array(inertial.com), np.array(inertial.inertia)
    lump.add(LinkMass("", sign * inertial.mass, com, sign * moments))
    return lump


def _remaining(
    whole: Inertial, flexures: tuple[Flexure, ...], frame: _Frame, what: str
) -> Inertial:
    """Part of a link before its first flexure, in a frame."""
    lump = _lump(whole)
    for flexure in flexures:
        part = _lump(flexure.beyond, -1.0)
        lump.mass += part.mass
        lump.moment = lump.moment + part.moment
        lump.second = lump.second + part.second
    if abs(lump.mass) <= _LEAST * whole.mass:
        return Inertial(mass=0.0, com=(0.0,) * 3, inertia=matrix(np.zeros((3, 3))))
    try:
        return lump.inertial(*frame)
    except ParameterError as error:
        raise ParameterError(
            f"{what}: the parts beyond its flexures must leave a rigid body of its"
            f" {whole.mass:.6g} kg: {error}"
        ) from None
