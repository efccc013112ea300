"""Booms: chains of jointed, flexible members that carry an arm.

A member bends in hinges with springs (rigid finite elements): k in either plane at the k
Gauss-Legendre points of its length L, compliance w_i L / EI each, and one in torsion in its
middle, L / GJ. An end load's bending moment is linear along the member, so two hinges give a
tip's statics exactly; what is approximate is how the member's own mass takes part
(docs/physics.md, section 15; `hinges_needed` says how far).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, ParameterError, Vector, finite, require_positive, unit
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.chain import Joint, LinkMass, Lump, about_z, angles_of, arm_of, upright
from ves_gym.mechanics.craig_bampton import reduce
from ves_gym.mechanics.dynamics import frames
from ves_gym.mechanics.flexible_base import REACH, FlexibleBase, Reduced
from ves_gym.mechanics.flexure import unfold
from ves_gym.mechanics.section import Material, Section, Tube
from ves_gym.mechanics.serial_chain import Flexure, Inertial, Link, Mount, matrix

_SOFTEST = 1e-9  # of the flange's ways, in compliance over the largest: below it none
_EVENLY = 7  # points of a member that a picture shows


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
        object.__setattr__(self, "joints", tuple(self.joints))  # a list has no hash
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
class _Event:
    """A joint or a hinge of a boom in a pose, and the body beyond it."""

    origin: Array  # (3,) [m]
    axis: Array  # (3,)
    stiffness: float
    damping: float
    joint: BoomJoint | None  # None: a hinge
    body: Lump

    def turned(self, R: Array, p: Array) -> _Event:
        """The same, turned by R (3, 3) about p (3,)."""
        return replace(
            self,
            origin=p + R @ (self.origin - p),
            axis=R @ self.axis,
            body=_turned(self.body, R, p),
        )


class Flange(NamedTuple):
    """A flange: its rotation (3, 3) and position (3,) in the boom's axes."""

    rotation: Array
    position: Array


class _Pose(NamedTuple):
    """A boom at rest."""

    events: list[_Event]  # joints and hinges in their order
    flange: Flange
    line: list[tuple[Array, int]]  # points along it (3,), and the events before each


@dataclass(frozen=True, kw_only=True)
class Boom:
    """Members one after the other from a fixed root; an arm stands on the flange at the tip.

    All lengths at zero, in the axes of its root.
    """

    name: str
    members: tuple[BoomMember, ...]
    flange: Vector = unit("rad", default=(0.0, 0.0, 0.0))  # its turn about x, then y, then z
    tip: Inertial | None = None  # a body at the tip, in the root's axes, from the tip
    bandwidth: float | None = unit("Hz", default=None)  # of the servos, see `own_gains`
    source: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "members", tuple(self.members))
        if not self.members:
            raise ParameterError("Boom.members must hold at least one, got none")

    @property
    def joints(self) -> tuple[BoomJoint, ...]:
        """All joints from the root outwards."""
        return tuple(joint for member in self.members for joint in member.joints)

    def carry(self, arm: Arm) -> Arm:
        """Return boom and arm as one arm: joints of both driven, members bending.

        Args:
            arm: stands on the flange.

        Raises:
            ParameterError: the boom has no joints (`braked` needs none).
        """
        if not self.joints:
            raise ParameterError(f"boom {self.name} has no joints to drive: use Boom.braked")
        events, flange, _ = self._pose(np.zeros(len(self.joints)))
        if events[0].joint is None:
            raise ParameterError(
                f"boom {self.name} must begin with a joint to be driven, got a member without"
            )
        _stand(events[-1].body, arm.base, flange)
        joints: list[Joint] = []
        within: list[list[_Event]] = []
        for event in events:
            if event.joint is not None:
                joints.append(_joint(event, len(joints)))
                within.append([])
            else:
                _join(joints[-1].body, event.body)
                within[-1].append(event)
        R, p = _mounted(arm, flange)
        whole = arm_of(self.name, Lump(), joints, (R, p), source=self.source)
        at_rest = frames(whole, [0.0] * whole.n)
        links = []
        for link, frame, hinges in zip(whole.links, at_rest, within, strict=True):
            turn = np.column_stack(frame.rotation)
            flexures = tuple(_flexure(k, turn, np.array(frame.position)) for k in hinges)
            links.append(replace(link, flexures=flexures or None))
        first = replace(arm.links[0], offset=arm.links[0].offset + (whole.tool_angle or 0.0))
        return replace(
            arm,
            name=f"{self.name}-{arm.name}",
            base=whole.base,
            base_shape=None,
            mount=whole.mount,
            links=(*links, first, *arm.links[1:]),
            bandwidth=self.bandwidth or arm.bandwidth,
            source=f"{whole.source}; on it {arm.source}",
        )

    def braked(self, q: npt.ArrayLike, arm: Arm) -> Arm:
        """Return the arm on the boom, whose joints are on their brakes at q.

        A braked joint is a spring and a damper at its angle, as a hinge of a member is: all
        of the boom is a base link that bends.

        Args:
            q: (joints,) where the boom's joints stand [rad].
            arm: stands on the flange.
        """
        events, flange, _ = self._pose(q)
        _stand(events[-1].body, arm.base, flange)
        total = Lump()
        for event in events:
            _join(total, event.body)
        R, p = _mounted(arm, flange)
        still = np.eye(3), np.zeros(3)
        return replace(
            arm,
            name=f"{self.name}-braked-{arm.name}",
            base=total.inertial(*still),
            base_shape=total.shape(*still),
            base_flexures=tuple(_flexure(k, *still) for k in events),
            mount=Mount(position=tuple(p.tolist()), angles=angles_of(R)),
            source=f"{self.source}; on it {arm.source}",
        )

    def reach(self, q: npt.ArrayLike) -> Flange:
        """Return where the flange is at rest.

        Args:
            q: (joints,) [rad].
        """
        return self._pose(q).flange

    def at(self, q: npt.ArrayLike, modes: int = 6, fastest: float = REACH) -> FlexibleBase:
        """Return the braked boom at q as a linear flexible base: flange and internal modes.

        The linear motion of all hinges and brakes, by Craig and Bampton's reduction to the
        flange's pose. In axes of the flange at rest; its root is fixed.

        Args:
            q: (joints,) where the joints stand [rad].
            modes: internal modes to keep, all where there are fewer.
            fastest: modes faster than this follow the flange [rad/s].

        Raises:
            ParameterError: the flange cannot move along some direction, as that of a straight
                boom along itself.
        """
        whole = unfold(self.braked(q, NOTHING))
        events, flange, line = self._pose(q)
        p = len(whole.passive)
        M = whole.inertia(np.zeros(1), np.zeros(p))[6 : 6 + p, 6 : 6 + p]
        K, D = np.diag(whole.stiffness), np.diag(whole.damping)
        back = flange.rotation.T  # to the axes of the flange at rest
        J = np.vstack(
            [back @ _ways(events, flange.position), back @ np.array([k.axis for k in events]).T]
        )
        compliance = (J / whole.stiffness) @ J.T
        size = np.sqrt(np.maximum(np.diag(compliance), 1e-300))
        values, vectors = np.linalg.eigh(compliance / np.outer(size, size))
        if p < 6 or values[0] < _SOFTEST:
            stiff = ", ".join(f"{k:.3g}" for k in vectors[:, 0])
            raise ParameterError(
                f"boom {self.name} at {np.round(np.rad2deg(np.asarray(q, float)), 1).tolist()}"
                f" deg holds its flange rigidly along ({stiff}) of (x, y, z, phi_x, phi_y,"
                " phi_z): a linear base needs all six to give; bend the boom, or simulate"
                " Boom.braked"
            )
        static = (J.T / whole.stiffness[:, None]) @ np.linalg.inv(compliance)
        null = np.linalg.svd(J)[2][6:].T
        T = np.hstack([static, null])
        parts = [T.T @ k @ T for k in (M, K, D)]
        M_z, K_z, D_z = ((k + k.T) / 2 for k in parts)
        found = reduce(M_z, K_z, np.arange(6), min(modes, p - 6), damping=D_z)
        moved = np.vstack([back @ _ways(events, at, n) for at, n in line]) @ T
        return FlexibleBase(
            structure=Reduced(
                K=matrix(found.K),
                M=matrix(found.M),
                coupling=matrix(found.coupling),
                omega=tuple(found.omega.tolist()),
                damping=matrix(found.damping if found.damping is not None else D_z),
                centreline=matrix(np.array([at - flange.position for at, _ in line]) @ back.T),
                static=matrix(moved @ found.static),
                shapes=matrix(moved @ found.shapes),
                diameter=max(_diameter(member) for member in self.members),
            ),
            modes=found.m,
            fastest=fastest,
            source=f"{self.source}; joints on their brakes at"
            f" {np.round(np.rad2deg(np.asarray(q, float)), 1).tolist()} deg",
        )

    def _pose(self, q: npt.ArrayLike) -> _Pose:
        """The boom at rest with its joints at q."""
        angles = finite(q, (len(self.joints),), "q")
        events: list[_Event] = []
        line, at = [(np.zeros(3), 0)], np.zeros(3)
        for member in self.members:
            before = len(events)
            events += _events(member, at, events)
            way = np.array(member.vector)
            for share in np.arange(1, _EVENLY + 1) / _EVENLY:
                inner = [
                    k for k in events[before:] if (k.origin - at) @ way < share * way @ way
                ]
                line.append((at + share * way, before + len(inner)))
            at = at + way
        if self.tip is not None:
            _stand(events[-1].body, self.tip, Flange(np.eye(3), at))
        flange = Flange(Mount(angles=self.flange).rotation, at)
        places = [i for i, event in enumerate(events) if event.joint is not None]
        # outermost joint first, so that the inner axes are still where they are at zero
        for i, angle in reversed(list(zip(places, angles.tolist(), strict=True))):
            R, p = _about(events[i].axis, angle), events[i].origin
            events[i] = replace(events[i], body=_turned(events[i].body, R, p))
            events[i + 1 :] = [event.turned(R, p) for event in events[i + 1 :]]
            line = [(p + R @ (k - p), n) if n > i else (k, n) for k, n in line]
            flange = Flange(R @ flange.rotation, p + R @ (flange.position - p))
        return _Pose(events, flange, line)


def _events(member: BoomMember, start: Array, inner: list[_Event]) -> list[_Event]:
    """A member's joints and hinges at zero, each with the body up to the next.

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
        out.append(_Event(start, axis, joint.stiffness, joint.damping, joint, housing))
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
        _join(before[-1].body, _rod(member, start, 0.0, hinges[0][0]))
    for k, (at, axis, stiffness) in enumerate(hinges):
        end = hinges[k + 1][0] if k + 1 < len(hinges) else 1.0
        origin = start + at * length * axes[:, 0]
        loss = member.loss * stiffness
        body = _rod(member, start, at, end)
        out.append(_Event(origin, axes[:, axis], stiffness, loss, None, body))
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
    lump.capsules.append((near, far, _diameter(member) / 2))
    return lump


def _diameter(member: BoomMember) -> float:
    section = member.section.of(member.material)
    return 2 * (section.fibre or math.sqrt(section.area / math.pi))


def _ways(events: list[_Event], point: Array, count: int | None = None) -> Array:
    """(3, p) ways of a point per angle of the joints and hinges, the first `count` of them."""
    out = np.zeros((3, len(events)))
    for k, event in enumerate(events[:count]):
        out[:, k] = np.cross(event.axis, point - event.origin)
    return out


def _flexure(event: _Event, R: Array, p: Array) -> Flexure:
    """A joint or hinge as a passive joint in a frame of rotation R and position p."""
    axis = R.T @ event.axis
    return Flexure(
        origin=tuple((R.T @ (event.origin - p)).tolist()),
        axis=tuple((axis / np.linalg.norm(axis)).tolist()),
        stiffness=event.stiffness,
        damping=event.damping,
        beyond=event.body.inertial(R, p),
    )


def _joint(event: _Event, number: int) -> Joint:
    """A joint as it is driven."""
    joint = event.joint
    assert joint is not None
    body = Lump()
    _join(body, event.body)
    return Joint(
        name=joint.name or f"boom_{number + 1}",
        origin=event.origin,
        axis=event.axis,
        q_min=joint.q_min,
        q_max=joint.q_max,
        body=body,
        rotor_inertia=joint.rotor_inertia,
        v_max=joint.v_max,
        a_max=joint.a_max,
        tau_max=joint.tau_max,
    )


def _mounted(arm: Arm, flange: Flange) -> tuple[Array, Array]:
    """Rotation and position of an arm's first joint on a flange."""
    R, p = flange
    if arm.mount is None:
        return R, p
    return R @ arm.mount.rotation, p + R @ np.array(arm.mount.position)


def _stand(lump: Lump, body: Inertial, frame: Flange) -> None:
    """Add a body in a frame to a lump."""
    R, p = frame
    moments = R @ np.array(body.inertia) @ R.T
    lump.add(LinkMass("", body.mass, p + R @ np.array(body.com), moments))


def _join(lump: Lump, other: Lump) -> None:
    lump.mass += other.mass
    lump.moment = lump.moment + other.moment
    lump.second = lump.second + other.second
    lump.capsules += other.capsules


def _turned(lump: Lump, R: Array, p: Array) -> Lump:
    """A lump turned by R about p."""
    out = Lump()
    if lump.mass:
        body = lump.inertial(np.eye(3), np.zeros(3))
        _stand(out, body, Flange(R, p - R @ p))
    out.capsules = [(p + R @ (a - p), p + R @ (b - p), r) for a, b, r in lump.capsules]
    return out


def _about(axis: Array, angle: float) -> Array:
    """(3, 3) rotation about an axis of length 1."""
    to_z = upright(axis)
    out: Array = to_z @ about_z(angle) @ to_z.T
    return out


NOTHING = Arm(
    name="nothing",
    base=Inertial(mass=0.0, com=(0.0,) * 3, inertia=matrix(np.zeros((3, 3)))),
    links=(
        Link(
            d=0.0,
            a=0.0,
            alpha=0.0,
            inertial=Inertial(mass=0.0, com=(0.0,) * 3, inertia=matrix(np.zeros((3, 3)))),
            q_min=-1.0,
            q_max=1.0,
            v_max=1.0,
            a_max=1.0,
            tau_max=1.0,
        ),
    ),
    source="no arm",
)
