"""From joint axes and bodies at one configuration to an arm.

What files of URDF and MJCF lead to, booms, and arms whose links bend.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, ParameterError, finite
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.dynamics import drawn_configurations, inertia
from ves_gym.mechanics.link import (
    BANDWIDTH,
    WEIGHTLESS,
    Capsule,
    Flexure,
    Follower,
    Inertial,
    Link,
    MeshFile,
    Mount,
    angles_of,
    matrix,
    rigid_moments,
    turned_about,
)

ENDLESS = 2 * math.pi  # rad either way, the range taken for a joint without limits
_NOTHING = 1e-13  # of an inertia
_LEAST = 1e-9  # share of a link's mass below which nothing is left of it
_ZERO = 1e-13  # m, rad: rounding of a file's angles
_SPEED = math.pi  # rad/s, v_max where a file gives none
_SLIDE_SPEED = 0.5  # m/s, the same of a joint that slides
_PACE = 20.0  # 1/s, a_max over v_max at most, where a file gives none; the PUMA has 7 to 19
_CREEP = 0.01  # rad/s over which Coulomb friction builds up (`joint/coulomb`)
_DECAY = 400.0  # 1/s, the fastest that a joint's friction may be: rk4 at 1.25 ms takes 2200
_PUSH = 10.0  # rad/s^2 that tau_max gives the largest inertia, where a file gives none

_UPRIGHT, _ORIGIN = np.eye(3), np.zeros(3)


@dataclass
class Lump:
    """Bodies that move as one, in the root's axes."""

    mass: float = 0.0
    com: Array = field(default_factory=lambda: np.zeros(3))
    moments: Array = field(default_factory=lambda: np.zeros((3, 3)))  # about it [kg m^2]
    capsules: list[Capsule] = field(default_factory=list)
    meshes: list[MeshFile] = field(default_factory=list)

    def add(self, mass: float, com: Array, moments: Array) -> None:
        """Add a body by its moments (3, 3) about its centre of mass; a negative one goes."""
        total, way = self.mass + mass, com - self.com
        if total:
            steiner = way @ way * np.eye(3) - np.outer(way, way)
            self.moments = self.moments + self.mass * mass / total * steiner
            self.com = self.com + mass / total * way
        self.mass, self.moments = total, self.moments + moments

    def add_body(
        self, body: Inertial, R: Array = _UPRIGHT, p: Array = _ORIGIN, sign: float = 1.0
    ) -> None:
        """Add a body whose frame has rotation R (3, 3) and position p (3,), or take it away
        (sign -1)."""
        body = body.placed(R, p)
        self.add(sign * body.mass, np.array(body.com), sign * np.array(body.inertia))

    def join(self, other: Lump) -> None:
        """Add all of another lump, its capsules included."""
        self.add(other.mass, other.com, other.moments)
        self.capsules += other.capsules

    def turned(self, R: Array, p: Array) -> Lump:
        """Return the lump turned by R (3, 3) about a point p (3,) [m]."""
        capsules = [k.placed(R, p - R @ p) for k in self.capsules]
        return Lump(self.mass, p + R @ (self.com - p), R @ self.moments @ R.T, capsules)

    def inertial(self, R: Array, p: Array) -> Inertial:
        """Return the mass properties in a frame of rotation (3, 3) and position (3,)."""
        if self.mass == 0:
            return WEIGHTLESS
        about = finite(self.moments, (3, 3), "the inertia of fixed links together")
        least = np.trace(about) / 2 - np.linalg.eigvalsh(about)[-1]
        if -_NOTHING * np.abs(about).max() <= least < 0:
            about = rigid_moments(about)  # of few point masses rounding leaves no body
        turned = R.T @ about @ R
        return Inertial(
            mass=self.mass,
            com=tuple((R.T @ (self.com - p)).tolist()),
            inertia=matrix((turned + turned.T) / 2),
        )

    def shape(self, R: Array, p: Array) -> tuple[Capsule, ...]:
        """Return the capsules in a frame of rotation (3, 3) and position (3,)."""
        return tuple(k.placed(R.T, -R.T @ p) for k in self.capsules)

    def drawn(self, R: Array, p: Array) -> tuple[MeshFile, ...] | None:
        """Return the meshes in a frame of rotation (3, 3) and position (3,)."""
        return tuple(k.placed(R.T, -R.T @ p) for k in self.meshes) or None


class LinkMass(NamedTuple):
    """A link's mass properties, in the root's axes."""

    link: str
    mass: float  # kg
    com: Array  # (3,) m
    moments: Array  # (3, 3) about the centre of mass [kg m^2]


@dataclass
class Joint:
    """A joint at zero and what it moves up to the next one, in the root's axes."""

    name: str
    origin: Array  # (3,) [m]
    axis: Array  # (3,) of length 1
    q_min: float  # rad
    q_max: float
    body: Lump
    rotor_inertia: float = 0.0  # kg m^2
    v_max: float | None = None  # rad/s
    a_max: float | None = None  # rad/s^2
    tau_max: float | None = None  # N m
    damping: float | None = None  # N m s/rad
    friction: float | None = None  # N m
    slides: bool = False  # along its axis; then m and N instead of rad and N m
    ratios: Array | None = None  # of one that follows those that are driven (n,)
    beside: bool = False  # it stands not between base and tool
    on: str | None = None  # beside them: the joint before it; None: the base


def arm_of(
    name: str,
    root: Lump,
    joints: list[Joint],
    tool: tuple[Array, Array],
    *,
    source: str,
    collision: bool = True,
    bandwidth: float = BANDWIDTH,
) -> Arm:
    """Return the arm of joint axes and bodies at zero.

    Args:
        name, bandwidth: of the arm, and of its servos [Hz].
        root: what stands on the platform.
        joints: from root to tip, then those beside them, each after what it stands on.
        tool: rotation (3, 3) and position (3,) [m] of the tool.
        source: where it comes from; what is derived is added.
        collision: False: leave the shapes out.
    """
    along, driven = (
        [k for k in joints if not k.beside],
        [k for k in joints if k.ratios is None],
    )
    mount = upright(along[0].axis)
    R, p = mount, along[0].origin
    links: dict[str, Link] = {}
    frames: dict[str | None, tuple[Array, Array]] = {None: (_UPRIGHT, _ORIGIN)}

    def add(joint: Joint, R: Array, p: Array, axis: Array, target: Array) -> None:
        """A link from its joint's frame to an axis (3,) at a target (3,)."""
        shape = far_end(R.T @ (target - p), R.T @ axis)
        link = _link(joint, shape)
        R, p = R @ turned_about(2, shape["offset"]) @ link.far_end[0], target
        try:
            inertial = joint.body.inertial(R, p)
        except ParameterError as error:
            raise ParameterError(f"what joint {joint.name!r} moves: {error}") from None
        capsules = joint.body.shape(R, p) if collision else None
        drawn = joint.body.drawn(R, p)
        links[joint.name] = replace(link, inertial=inertial, shape=capsules, meshes=drawn)
        frames[joint.name] = R, p

    for i, joint in enumerate(along):
        last = i == len(along) - 1
        axis = tool[0][:, 2] if last else along[i + 1].axis
        add(joint, R, p, axis, tool[1] if last else along[i + 1].origin)
        R, p = frames[joint.name]
    for joint in joints[len(along) :]:
        add(joint, upright(joint.axis), joint.origin, joint.axis, joint.origin)
    turn = R.T @ tool[0]
    angle = math.atan2(turn[1, 0], turn[0, 0])
    arm = Arm(
        name=name,
        base=root.inertial(_UPRIGHT, _ORIGIN),
        base_shape=root.shape(_UPRIGHT, _ORIGIN) if collision else None,
        base_meshes=root.drawn(_UPRIGHT, _ORIGIN),
        mount=_mount(mount, along[0].origin),
        links=tuple(links[joint.name] for joint in driven),
        followers=_followers(joints, links, frames) or None,
        tool_angle=angle if abs(angle) > _ZERO else None,
        bandwidth=bandwidth,
        source=source,
    )
    return _with_limits(arm, driven)


def _followers(
    joints: list[Joint], links: Mapping[str, Link], frames: Mapping[str | None, Any]
) -> tuple[Follower, ...]:
    """The joints that follow others; the frames are those of all links, by joint."""
    numbers = {None: -1} | {joint.name: i for i, joint in enumerate(joints)}
    out = []
    for i, joint in enumerate(joints):
        if joint.ratios is None:
            continue
        stands: dict[str, Any] = {"place": i}
        if joint.beside:
            R, p = frames[joint.on]
            mount = _mount(R.T @ upright(joint.axis), R.T @ (joint.origin - p))
            stands = {"on": numbers[joint.on], "mount": mount}
        ratios = tuple(float(k) for k in joint.ratios)
        out.append(Follower(link=links[joint.name], ratios=ratios, **stands))
    return tuple(out)


def upright(axis: Array) -> Array:
    """(3, 3) a rotation that brings z to the axis; the smallest, where the axis points up."""
    if axis[2] < 0:  # 1 + z would cancel
        turned = np.diag([1.0, -1.0, -1.0])
        return turned @ upright(turned @ axis)
    x, y, z = axis
    k = 1 / (1 + z)
    return np.array(
        [[1 - k * x * x, -k * x * y, x], [-k * x * y, 1 - k * y * y, y], [-x, -y, z]]
    )


def _mount(R: Array, p: Array) -> Mount | None:
    """The mount of a first joint at (3, 3), (3,); None at the platform-top frame."""
    mount = Mount(position=tuple(p.tolist()), angles=angles_of(R))
    return None if mount == Mount() else mount


def far_end(p: Array, axis: Array) -> dict[str, float]:
    """d, a, alpha, beta and offset of a link whose far end is at p (3,) [m] in the frame at its
    joint, at zero, with z of the frame there along an axis (3,)."""
    a = math.hypot(p[0], p[1])
    if a < _ZERO:
        slant = math.hypot(axis[0], axis[1])
        offset = math.atan2(axis[0], -axis[1]) if slant > _ZERO else 0.0
        a = 0.0
    else:
        offset = math.atan2(p[1], p[0])
    if not -math.pi / 2 < offset <= math.pi / 2 + _ZERO:  # the other way round
        offset, a = offset - math.copysign(math.pi, offset), -a
    x, y, z = turned_about(2, offset).T @ axis
    if abs(x) < _ZERO:
        x = 0.0
    beta = math.atan2(x, math.hypot(y, z))
    alpha = math.atan2(-y, z) if math.hypot(y, z) > _ZERO else 0.0
    small = {"d": float(p[2]), "a": a, "alpha": alpha, "beta": beta, "offset": offset}
    return {k: 0.0 if abs(v) < _ZERO else v for k, v in small.items()}


def _link(joint: Joint, shape: dict[str, float]) -> Link:
    """A link without its mass, and with ones for the limits that are not given."""
    if not joint.q_min < joint.q_max:
        raise ParameterError(
            f"joint {joint.name!r}: its lower limit must be below the upper one, got"
            f" {joint.q_min:g} and {joint.q_max:g} {'m' if joint.slides else 'rad'}"
        )
    return Link(
        d=shape["d"],
        a=shape["a"],
        alpha=shape["alpha"],
        beta=shape["beta"] or None,
        offset=shape["offset"],
        inertial=WEIGHTLESS,
        rotor_inertia=joint.rotor_inertia,
        q_min=joint.q_min,
        q_max=joint.q_max,
        v_max=joint.v_max or 1.0,
        a_max=joint.a_max or 1.0,
        tau_max=joint.tau_max or 1.0,
        damping=joint.damping or None,
        friction=joint.friction or None,
        name=joint.name,
        slides=True if joint.slides else None,
    )


def _with_limits(arm: Arm, joints: list[Joint]) -> Arm:
    """The arm with limits derived where none are given, which its source then says."""
    H = inertia(arm, drawn_configurations(arm))[:, 6:, 6:]
    most = np.diagonal(H, axis1=1, axis2=2).max(axis=0)  # about each joint, others at rest
    for joint, value in zip(joints, most, strict=True):
        if value <= 1e-12:
            raise ParameterError(
                f"nothing that joint {joint.name!r} moves has an inertia about its axis, nor"
                " has its rotor: give the links an inertia, merge them (fixed joints), or say"
                f" what the rotor has about the joint: --rotor {joint.name}=0.01, in Python"
                f" rotors={{{joint.name!r}: 0.01}}, kg m^2"
            )
    links, notes = [], []
    for link, joint, J in zip(arm.links, joints, most, strict=True):
        tau = joint.tau_max or _down(_PUSH * J)
        v_max = joint.v_max or (_SLIDE_SPEED if joint.slides else _SPEED)
        links.append(
            replace(
                link,
                v_max=v_max,
                tau_max=tau,
                a_max=joint.a_max or _down(min(tau / J, _PACE * v_max)),
            )
        )
    for field_name, text in (
        ("v_max", f"pi rad/s, or {_SLIDE_SPEED:g} m/s"),
        ("tau_max", f"{_PUSH:g} rad/s^2 (m/s^2) times the largest inertia"),
        ("a_max", f"tau_max over the largest inertia, at most {_PACE:g}/s times v_max"),
    ):
        missing = [joint.name for joint in joints if not getattr(joint, field_name)]
        if missing:
            where = "" if len(missing) == len(joints) else f" of {', '.join(missing)}"
            notes.append(f"{field_name}{where} not given, taken: {text}")
    # joints whose friction brakes what they move faster than a physics step resolves
    rubbing = np.array([(k.damping or 0.0) + (k.friction or 0.0) / _CREEP for k in arm.links])
    too_fast: list[int] = []
    if rubbing.any():  # else H may be singular
        moved = 1 / np.diagonal(np.linalg.inv(H), axis1=1, axis2=2).max(axis=0)
        too_fast = np.flatnonzero(rubbing > _DECAY * moved).tolist()
    for i in too_fast:
        links[i] = replace(links[i], damping=None, friction=None)
    if too_fast:
        names = ", ".join(joints[i].name for i in too_fast)
        notes.append(f"damping and friction left out of {names}: on links so light, without a"
                     " rotor, they act faster than a physics step")  # fmt: skip
    source = "; ".join([arm.source, *notes])
    return replace(arm, links=tuple(links), source=source)


def _down(value: float) -> float:
    """The number rounded down to two digits."""
    scale = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.floor(value / scale + 1e-9) * scale:.3g}")


# ------------------------------------------------------------------- flexures as joints


def flexures_as_links(arm: Arm) -> tuple[Arm, list[int], list[int], list[Flexure]]:
    """Return the rigid arm of n + p links in which each of p flexures is a joint of its own.

    Then the places of the driven joints and of the flexures among them, and the flexures.
    Refused where parts beyond flexures weigh more than their link.
    """
    links: list[Link] = []
    driven: list[int] = []
    springs: list[Flexure] = []
    passive: list[int] = []
    at_mount = _Frame(np.eye(3), np.zeros(3))
    mount, base, turn = arm.mount, arm.base, 0.0
    if arm.base_flexures:
        base = _remaining(arm.base, arm.base_flexures, at_mount, "base")
        first = arm.base_flexures[0]
        start = upright(np.array(first.axis))
        mount = Mount(position=first.origin, angles=angles_of(start))
        foot = _Frame(start, np.array(first.origin))
        chain, turn = _hops(arm.base_flexures, foot, arm.feet[0][1:3])
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
        remainder = _remaining(link.inertial, link.flexures, frame, f"link {i}")
        offset += root.pop("offset")
        links.append(replace(link, **root, offset=offset, inertial=remainder, flexures=None))
        chain, turn = _hops(link.flexures, frame, (np.eye(3), np.zeros(3)))
        passive += range(len(links), len(links) + len(chain))
        springs += link.flexures
        links += chain
    rigid = replace(
        arm, base=base, base_flexures=None, mount=mount, links=tuple(links), base_shape=None
    )
    return rigid, driven, passive, springs


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
        turns = zip((2, 0, 1), ("offset", "alpha", "beta"), strict=True)
        for axis_, angle in turns:
            R = R @ turned_about(axis_, way[angle])
        return way | {"beta": way["beta"] or None}, _Frame(R, np.array(origin, float))


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
        lump = Lump()
        lump.add_body(flexure.beyond)
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


def _remaining(
    full: Inertial, flexures: tuple[Flexure, ...], frame: _Frame, what: str
) -> Inertial:
    """Part of a link before its first flexure, in a frame."""
    lump = Lump()
    lump.add_body(full)
    for flexure in flexures:
        lump.add_body(flexure.beyond, sign=-1.0)
    if abs(lump.mass) <= _LEAST * full.mass:
        return WEIGHTLESS
    try:
        return lump.inertial(*frame)
    except ParameterError as error:
        raise ParameterError(
            f"{what}: the parts beyond its flexures must leave a rigid body of its"
            f" {full.mass:.6g} kg: {error}"
        ) from None
