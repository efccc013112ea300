"""Booms: chains of jointed, flexible members that carry an arm.

A member bends in hinges with springs (rigid finite elements): k in either plane at the k
Gauss-Legendre points of its length L, compliance w_i L / EI each, and one in torsion in its
middle, L / GJ. An end load's bending moment is linear along the member, so two hinges give a
tip's statics exactly; what is approximate is how the member's own mass takes part
(docs/physics.md, section 15; scripts/hinges_needed.py says how far).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from ves_gym._util.params import (
    Array,
    ParameterError,
    Vector,
    finite,
    freeze_arrays,
    require_one_of,
    require_positive,
    unit,
)
from ves_gym._util.threads import on_one_thread
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.chain import Joint, Lump, arm_of
from ves_gym.mechanics.craig_bampton import reduce
from ves_gym.mechanics.finite_elements import Material, Section, Tube
from ves_gym.mechanics.flexible_base import REACH, FlexibleBase, Reduced
from ves_gym.mechanics.flexure import expand
from ves_gym.mechanics.kinematics import frames
from ves_gym.mechanics.link import WEIGHTLESS, Capsule, Flexure, Inertial, Link, Mount, diagonal

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
class _Hinge:
    """A joint or a hinge of a boom in a pose, and the body beyond it."""

    origin: Array  # (3,) [m]
    axis: Array  # (3,)
    stiffness: float
    damping: float
    joint: BoomJoint | None  # None: a hinge
    body: Lump

    def turned(self, R: Array, p: Array) -> _Hinge:
        """Return the same, turned by R (3, 3) about a point p (3,) [m]."""
        return replace(
            self,
            origin=p + R @ (self.origin - p),
            axis=R @ self.axis,
            body=self.body.turned(R, p),
        )


class Flange(NamedTuple):
    """A flange: its rotation (3, 3) and position (3,) in the boom's axes."""

    rotation: Array
    position: Array


def _hinges_of(member: BoomMember, start: Array, inner: list[_Hinge]) -> list[_Hinge]:
    """A member's joints and hinges at zero, each with the body up to the next; `inner` are
    those before, the last of which takes a body from a member without joints."""
    out = []
    for joint in member.joints:
        housing = Lump()
        moment = 2 / 5 * joint.mass * joint.radius**2
        housing.add(joint.mass, start, moment * np.eye(3))
        axis = np.array(joint.axis) / np.linalg.norm(joint.axis)
        out.append(_Hinge(start, axis, joint.stiffness, joint.damping, joint, housing))
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
        before[-1].body.join(_rod(member, start, 0.0, hinges[0][0]))
    for k, (at, axis, stiffness) in enumerate(hinges):
        end = hinges[k + 1][0] if k + 1 < len(hinges) else 1.0
        origin = start + at * length * axes[:, 0]
        loss = member.loss * stiffness
        body = _rod(member, start, at, end)
        out.append(_Hinge(origin, axes[:, axis], stiffness, loss, None, body))
    return out


def _rod(member: BoomMember, start: Array, first: float, last: float) -> Lump:
    """A piece of a member, by shares of its length, as a rigid body."""
    lump, length = Lump(), (last - first) * member.length
    if length <= 0:
        return lump
    section, axes = member.section.of(member.material), member.axes()
    density = member.material.density
    mass = density * section.area * length
    bent = density * length * np.array([section.second_y, section.second_z])
    moments = np.diag(
        [bent.sum(), mass * length**2 / 12 + bent[0], mass * length**2 / 12 + bent[1]]
    )
    middle = start + (first + last) / 2 * member.length * axes[:, 0]
    lump.add(mass, middle, axes @ moments @ axes.T)
    near, far = (start + share * member.length * axes[:, 0] for share in (first, last))
    lump.capsules.append(Capsule.of(near, far, section.diameter / 2))
    return lump


class _Pose(NamedTuple):
    """A boom at rest."""

    events: list[_Hinge]  # joints and hinges in their order
    flange: Flange
    centreline: list[tuple[Array, int]]  # points along it (3,), and the events before each


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
        freeze_arrays(self)
        if not self.members:
            raise ParameterError("Boom.members must hold at least one, got none")

    @property
    def joints(self) -> tuple[BoomJoint, ...]:
        """All joints from the root outwards."""
        return tuple(joint for member in self.members for joint in member.joints)

    def carry(self, arm: Arm) -> Arm:
        """Return boom and arm, which stands on the flange, as one arm: joints of both driven,
        members bending. Without joints use `braked`."""
        arm.require_alone("a boom that is driven")
        arm.require_uncoupled("a boom that is driven")
        if not self.joints:
            raise ParameterError(f"boom {self.name} has no joints to drive: use Boom.braked")
        events, flange, _ = self._pose(np.zeros(len(self.joints)))
        if events[0].joint is None:
            raise ParameterError(
                f"boom {self.name} must begin with a joint to be driven, got a member without"
            )
        events[-1].body.add_body(arm.base, *flange)
        joints: list[Joint] = []
        within: list[list[_Hinge]] = []
        for event in events:
            if event.joint is not None:
                joints.append(_joint(event, len(joints)))
                within.append([])
            else:
                joints[-1].body.join(event.body)
                within[-1].append(event)
        mount = (arm.mount or Mount()).placed(*flange)
        foot = mount.rotation, np.array(mount.position)
        chain = arm_of(self.name, Lump(), joints, foot, source=self.source)
        at = frames(chain, np.zeros(chain.n))
        links = []
        parts = chain.links, at.rotation, at.position, within
        for link, turn, place, hinges in zip(*parts, strict=True):
            flexures = tuple(_flexure(k, turn, place) for k in hinges)
            links.append(replace(link, flexures=flexures or None))
        first = replace(arm.links[0], offset=arm.links[0].offset + (chain.tool_angle or 0.0))
        return replace(
            arm,
            name=f"{self.name}-{arm.name}",
            base=chain.base,
            base_shape=None,
            mount=chain.mount,
            links=(*links, first, *arm.links[1:]),
            bandwidth=self.bandwidth or arm.bandwidth,
            source=f"{chain.source}; on it {arm.source}",
        )

    def braked(self, q: npt.ArrayLike, arm: Arm) -> Arm:
        """Return the arm on the boom, whose joints are on their brakes at q (joints,) [rad].

        A braked joint is a spring and a damper at its angle, as a hinge of a member is: all of
        the boom is a base link that bends.
        """
        events, flange, _ = self._pose(q)
        events[-1].body.add_body(arm.base, *flange)
        total = Lump()
        for event in events:
            total.join(event.body)
        still = np.eye(3), np.zeros(3)
        return replace(
            arm,
            name=f"{self.name}-braked-{arm.name}",
            base=total.inertial(*still),
            base_shape=total.shape(*still),
            base_flexures=tuple(_flexure(k, *still) for k in events),
            mount=(arm.mount or Mount()).placed(*flange),
            source=f"{self.source}; on it {arm.source}",
        )

    def reach(self, q: npt.ArrayLike) -> Flange:
        """Return where the flange is at rest, joints at q (joints,) [rad]."""
        return self._pose(q).flange

    @on_one_thread(scipy=False)
    def at(self, q: npt.ArrayLike, modes: int = 6, fastest: float = REACH) -> FlexibleBase:
        """Return the braked boom at q (joints,) [rad] as a linear flexible base: flange and
        internal modes.

        The linear motion of all hinges and brakes, by Craig and Bampton's reduction to the
        flange's pose, in axes of the flange at rest; its root is fixed. Kept are `modes` of the
        internal modes, and of these the ones not faster than `fastest` [rad/s]. Refused where
        the flange cannot move along some direction, as that of a straight boom along itself.
        """
        beam = expand(self.braked(q, NO_ARM))
        events, flange, centreline = self._pose(q)
        p = len(beam.passive)
        M = beam.inertia(np.zeros(1), np.zeros(p))[6 : 6 + p, 6 : 6 + p]
        K, D = np.diag(beam.stiffness), np.diag(beam.damping)
        back = flange.rotation.T  # to the axes of the flange at rest
        J = np.vstack(
            [back @ _ways(events, flange.position), back @ np.array([k.axis for k in events]).T]
        )
        compliance = (J / beam.stiffness) @ J.T
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
        static = (J.T / beam.stiffness[:, None]) @ np.linalg.inv(compliance)
        null = np.linalg.svd(J)[2][6:].T
        T = np.hstack([static, null])
        parts = [T.T @ k @ T for k in (M, K, D)]
        M_z, K_z, D_z = ((k + k.T) / 2 for k in parts)
        reduction = reduce(M_z, K_z, np.arange(6), min(modes, p - 6), damping=D_z)
        moved = np.vstack([back @ _ways(events, at, n) for at, n in centreline]) @ T
        at_rest = np.array([at - flange.position for at, _ in centreline]) @ back.T
        line = at_rest, moved @ reduction.static, moved @ reduction.shapes
        diameters = (k.section.of(k.material).diameter for k in self.members)
        return FlexibleBase(
            structure=Reduced.of(reduction, line, max(diameters)),
            modes=reduction.m,
            fastest=fastest,
            source=f"{self.source}; joints on their brakes at"
            f" {np.round(np.rad2deg(np.asarray(q, float)), 1).tolist()} deg",
        )

    def _pose(self, q: npt.ArrayLike) -> _Pose:
        """The boom at rest with its joints at q."""
        angles = finite(q, (len(self.joints),), "q")
        events: list[_Hinge] = []
        centreline, at = [(np.zeros(3), 0)], np.zeros(3)
        for member in self.members:
            before = len(events)
            events += _hinges_of(member, at, events)
            way = np.array(member.vector)
            for share in np.arange(1, _EVENLY + 1) / _EVENLY:
                inner = [
                    k for k in events[before:] if (k.origin - at) @ way < share * way @ way
                ]
                centreline.append((at + share * way, before + len(inner)))
            at = at + way
        if self.tip is not None:
            events[-1].body.add_body(self.tip, p=at)
        flange = Flange(Mount(angles=self.flange).rotation, at)
        places = [i for i, event in enumerate(events) if event.joint is not None]
        # outermost joint first, so that the inner axes are still where they are at zero
        for i, angle in reversed(list(zip(places, angles.tolist(), strict=True))):
            R = (
                Rotation.from_rotvec(angle * events[i].axis).as_matrix().round(15)
            )  # keeps zeros
            p = events[i].origin
            events[i] = replace(events[i], body=events[i].body.turned(R, p))
            events[i + 1 :] = [event.turned(R, p) for event in events[i + 1 :]]
            centreline = [(p + R @ (k - p), n) if n > i else (k, n) for k, n in centreline]
            flange = Flange(R @ flange.rotation, p + R @ (flange.position - p))
        return _Pose(events, flange, centreline)


def _ways(events: list[_Hinge], point: Array, count: int | None = None) -> Array:
    """(3, p) ways of a point per angle of the joints and hinges, the first `count` of them."""
    out = np.zeros((3, len(events)))
    for k, event in enumerate(events[:count]):
        out[:, k] = np.cross(event.axis, point - event.origin)
    return out


def _flexure(event: _Hinge, R: Array, p: Array) -> Flexure:
    """A joint or hinge as a passive joint in a frame of rotation R and position p."""
    axis = R.T @ event.axis
    return Flexure(
        origin=tuple((R.T @ (event.origin - p)).tolist()),
        axis=tuple((axis / np.linalg.norm(axis)).tolist()),
        stiffness=event.stiffness,
        damping=event.damping,
        beyond=event.body.inertial(R, p),
    )


def _joint(event: _Hinge, number: int) -> Joint:
    """A joint as it is driven."""
    joint = event.joint
    assert joint is not None
    body = Lump()
    body.join(event.body)
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


NO_ARM = Arm(
    name="nothing",
    base=WEIGHTLESS,
    links=(
        Link(
            d=0.0,
            a=0.0,
            alpha=0.0,
            inertial=WEIGHTLESS,
            q_min=-1.0,
            q_max=1.0,
            v_max=1.0,
            a_max=1.0,
            tau_max=1.0,
        ),
    ),
    source="no arm",
)


# ------------------------------------------------------------------- booms by name

QUASI_ISOTROPIC = Material(
    youngs_modulus=70e9,
    shear_modulus=27e9,
    density=1600.0,
    source="nominal, this project: quasi-isotropic graphite-epoxy",
)

_TUBE = Tube(outer_diameter=0.33, wall=0.005)
_LOSS = 0.003  # s: ratio 0.005 at 0.5 Hz
_PACE = math.radians(5.0)  # rad/s, approximately, of the Shuttle's arm without a payload


def _shuttle_joint(
    name: str, axis: tuple[float, float, float], torque: float, k: float
) -> BoomJoint:
    least, most = (-math.pi, math.pi) if name == "shoulder_yaw" else (-2.8, 2.8)
    return BoomJoint(
        name=name,
        axis=axis,
        mass=60.0 if name == "elbow_pitch" else 55.0,
        radius=0.2,
        q_min=least,
        q_max=most,
        v_max=_PACE,
        a_max=0.02,
        tau_max=torque,
        stiffness=k,
        damping=_LOSS * k,
        rotor_inertia=torque / 1.5,  # 1000 kg m^2 at the shoulder: a gear of some thousand
    )


SHUTTLE_LIKE = Boom(
    name="shuttle-like",
    members=(
        BoomMember(
            joints=(
                _shuttle_joint("shoulder_yaw", (0.0, 0.0, 1.0), 1500.0, 1.2e6),
                _shuttle_joint("shoulder_pitch", (0.0, 1.0, 0.0), 1500.0, 1.2e6),
            ),
            vector=(6.4, 0.0, 0.0),
            section=_TUBE,
            material=QUASI_ISOTROPIC,
            loss=_LOSS,
        ),
        BoomMember(
            joints=(_shuttle_joint("elbow_pitch", (0.0, 1.0, 0.0), 750.0, 6e5),),
            vector=(7.0, 0.0, 0.0),
            section=_TUBE,
            material=QUASI_ISOTROPIC,
            loss=_LOSS,
        ),
    ),
    flange=(0.0, math.pi / 2, 0.0),  # the arm's z continues the boom
    tip=Inertial(mass=130.0, com=(-0.3, 0.0, 0.0), inertia=diagonal(2.6, 5.2, 5.2)),
    bandwidth=0.5,
    source="nominal, this project, at the size of the Shuttle's arm (15.2 m with its wrist,"
    " 410 kg, two graphite-epoxy booms of 0.33 m, 5 deg/s: NASA, JAXA): two members of 6.4"
    " and 7.0 m, EI 4.7e6 N m^2, three joints, what was its wrist a body at the tip",
)

# Bent so that the flange gives along all six axes, above its root and to the side.
REACHING_OUT = (0.3, -1.1, 1.7)  # rad

BOOMS: dict[str, Boom] = {SHUTTLE_LIKE.name: SHUTTLE_LIKE}


def get_boom(name: str) -> Boom:
    """Return a boom that comes with the package, by name."""
    require_one_of("boom", name, BOOMS)
    return BOOMS[name]
