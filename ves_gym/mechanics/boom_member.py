"""Members of a boom: joints and hinges, and the rigid pieces between them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ves_gym._util.params import (
    Array,
    ParameterError,
    Vector,
    finite,
    freeze_arrays,
    require_positive,
    unit,
)
from ves_gym.mechanics.chain import LinkMass, Lump
from ves_gym.mechanics.section import Material, Section, Tube
from ves_gym.mechanics.serial_chain import Inertial


@dataclass(frozen=True, kw_only=True)
class BoomJoint:
    """A revolute joint at a member's start: a motor, or its brake, and a housing beyond it."""

    axis: Vector = unit("1")  # (3,) at zero, in the boom's axes
    mass: float = unit("kg")  # of the housing, a homogeneous ball
    radius: float = unit("m")  # of it
    q_min: float = unit("rad")
    q_max: float = unit("rad")
    v_max: float = unit("rad/s")
    a_max: float = unit("rad/s^2")
    tau_max: float = unit("N m")
    stiffness: float = unit("N m/rad")  # of the joint on its brake
    damping: float = unit("N m s/rad", default=0.0)  # of the same
    rotor_inertia: float = unit("kg m^2", default=0.0)  # of the motor, through its gear
    name: str | None = None

    def __post_init__(self) -> None:
        freeze_arrays(self)
        require_positive(self, "radius", "v_max", "a_max", "tau_max", "stiffness")
        require_positive(self, "mass", "damping", "rotor_inertia", zero=True)
        if not np.linalg.norm(finite(self.axis, (3,), "BoomJoint.axis")) > 0:
            raise ParameterError(f"BoomJoint.axis must not be zero, got {self.axis}")


@dataclass(frozen=True, kw_only=True)
class BoomMember:
    """A straight flexible member, with the joints at its start in their order.

    `loss` is the time constant of its damping, damping over stiffness: 2 zeta / w damps a
    mode of frequency w by the ratio zeta, faster ones more.
    """

    joints: tuple[BoomJoint, ...] = ()
    vector: Vector = unit("m")  # (3,) from start to end at zero, in the boom's axes
    section: Tube | Section
    material: Material
    hinges: int = 2  # in either plane
    loss: float = unit("s", default=0.0)

    def __post_init__(self) -> None:
        freeze_arrays(self)
        if not np.linalg.norm(finite(self.vector, (3,), "BoomMember.vector")) > 0:
            raise ParameterError("BoomMember.vector must not have zero length")
        require_positive(self, "loss", zero=True)
        if isinstance(self.hinges, bool) or not 1 <= self.hinges <= 12:
            raise ParameterError(f"BoomMember.hinges must be 1 to 12, got {self.hinges!r}")

    @property
    def length(self) -> float:
        """From start to end [m]."""
        return float(np.linalg.norm(self.vector))

    def axes(self) -> Array:
        """(3, 3) columns: along the member, then the two that it bends about."""
        along = np.array(self.vector) / self.length
        section = self.section.of(self.material)
        up = np.array(section.up if section.up is not None else (0.0, 0.0, 1.0))
        if np.linalg.norm(np.cross(up, along)) < 1e-6:
            up = np.array([1.0, 0.0, 0.0])
        y = np.cross(up, along)
        y /= np.linalg.norm(y)
        return np.column_stack([along, y, np.cross(along, y)])


@dataclass
class Hinge:
    """A joint or a hinge of a boom in a pose, and the body beyond it."""

    origin: Array  # (3,) [m]
    axis: Array  # (3,)
    stiffness: float
    damping: float
    joint: BoomJoint | None  # None: a hinge
    body: Lump

    def turned(self, R: Array, p: Array) -> Hinge:
        """Return the same, turned about a point.

        Args:
            R: (3, 3) rotation.
            p: (3,) point [m].
        """
        return replace(
            self,
            origin=p + R @ (self.origin - p),
            axis=R @ self.axis,
            body=turned_lump(self.body, R, p),
        )


class Flange(NamedTuple):
    """A flange: its rotation (3, 3) and position (3,) in the boom's axes."""

    rotation: Array
    position: Array


def hinges_of(member: BoomMember, start: Array, inner: list[Hinge]) -> list[Hinge]:
    """Return a member's joints and hinges at zero, each with the body up to the next.

    Args:
        member: the next one.
        start: (3,) where it begins [m].
        inner: of the members before; the last takes a body from a member without joints.
    """
    out = []
    for joint in member.joints:
        housing = Lump()
        moment = 2 / 5 * joint.mass * joint.radius**2
        housing.add(LinkMass("", joint.mass, start, moment * np.eye(3)))
        axis = np.array(joint.axis) / np.linalg.norm(joint.axis)
        out.append(Hinge(start, axis, joint.stiffness, joint.damping, joint, housing))
    section, length, axes = member.section.of(member.material), member.length, member.axes()
    E, G = member.material.youngs_modulus, member.material.shear_modulus
    x, w = np.polynomial.legendre.leggauss(member.hinges)
    hinges = [(0.5, 0, G * section.torsion / length)]
    for at, share in zip((1 + x) / 2, w / 2, strict=True):
        # up is the third axis, along which second_y resists
        hinges.append((float(at), 1, E * section.second_y / (share * length)))
        hinges.append((float(at), 2, E * section.second_z / (share * length)))
    hinges.sort(key=lambda hinge: hinge[:2])
    before = [*inner, *out]  # nothing: the root itself, which does not move
    if before:
        join(before[-1].body, _rod(member, start, 0.0, hinges[0][0]))
    for k, (at, axis, stiffness) in enumerate(hinges):
        end = hinges[k + 1][0] if k + 1 < len(hinges) else 1.0
        origin = start + at * length * axes[:, 0]
        loss = member.loss * stiffness
        body = _rod(member, start, at, end)
        out.append(Hinge(origin, axes[:, axis], stiffness, loss, None, body))
    return out


def _rod(member: BoomMember, start: Array, first: float, last: float) -> Lump:
    """A piece of a member, by shares of its length, as a rigid body."""
    lump, length = Lump(), (last - first) * member.length
    if length <= 0:
        return lump
    section, axes, density = (
        member.section.of(member.material),
        member.axes(),
        member.material.density,
    )
    mass = density * section.area * length
    bent = density * length * np.array([section.second_y, section.second_z])
    moments = np.diag(
        [bent.sum(), mass * length**2 / 12 + bent[0], mass * length**2 / 12 + bent[1]]
    )
    middle = start + (first + last) / 2 * member.length * axes[:, 0]
    lump.add(LinkMass("", mass, middle, axes @ moments @ axes.T))
    near, far = (start + share * member.length * axes[:, 0] for share in (first, last))
    lump.capsules.append((near, far, diameter(member) / 2))
    return lump


def diameter(member: BoomMember) -> float:
    """Return the outer diameter of a member, or of the round bar of its area [m]."""
    section = member.section.of(member.material)
    return 2 * (section.fibre or math.sqrt(section.area / math.pi))


def add_body(lump: Lump, body: Inertial, frame: Flange) -> None:
    """Add a body to a lump.

    Args:
        lump: takes it.
        body: its mass properties in a frame.
        frame: where that is.
    """
    R, p = frame
    moments = R @ np.array(body.inertia) @ R.T
    lump.add(LinkMass("", body.mass, p + R @ np.array(body.com), moments))


def join(lump: Lump, other: Lump) -> None:
    """Add all of another lump to a lump.

    Args:
        lump: takes it.
        other: stays as it is.
    """
    lump.mass += other.mass
    lump.moment = lump.moment + other.moment
    lump.second = lump.second + other.second
    lump.capsules += other.capsules


def turned_lump(lump: Lump, R: Array, p: Array) -> Lump:
    """Return a lump turned about a point.

    Args:
        lump: stays as it is.
        R: (3, 3) rotation.
        p: (3,) point [m].
    """
    out = Lump()
    if lump.mass:
        body = lump.inertial(np.eye(3), np.zeros(3))
        add_body(out, body, Flange(R, p - R @ p))
    out.capsules = [(p + R @ (a - p), p + R @ (b - p), r) for a, b, r in lump.capsules]
    return out
