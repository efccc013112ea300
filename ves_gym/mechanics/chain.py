"""From joint axes and bodies at one configuration to an arm: what URDF and MJCF lead to."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym.mechanics.dynamics import drawn_configurations, inertia
from ves_gym.mechanics.serial_chain import (
    BANDWIDTH,
    Capsule,
    Inertial,
    Link,
    Mount,
    SerialChain,
    matrix,
)

ENDLESS = 2 * math.pi  # rad either way, the range taken for a joint without limits
_NOTHING = 1e-13  # of m c^2
_ZERO = 1e-13  # m, rad: rounding of a file's angles
_SPEED = math.pi  # rad/s, v_max where a file gives none
_SLIDE_SPEED = 0.5  # m/s, the same of a joint that slides
_PACE = 20.0  # 1/s, a_max over v_max at most, where a file gives none; the PUMA has 7 to 19
_CREEP = 0.01  # rad/s over which Coulomb friction builds up (`joint/coulomb`)
_DECAY = 400.0  # 1/s, the fastest that a joint's friction may be: rk4 at 1.25 ms takes 2200
_PUSH = 10.0  # rad/s^2 that tau_max gives the largest inertia, where a file gives none
# Numbers beyond these look like mm, g and kg mm^2 (this project).
_REACH = 100.0  # m
_DENSITY = 1e4  # kg/m^3: moving mass over the cube of the reach; a PUMA has 60
_GYRATION = 10.0  # radius of gyration over the reach


class ChainChoice(NamedTuple):
    """The chain of a file that is taken, and how it is read; see `Arm.from_urdf`."""

    tip: str | None
    root: str | None
    locked: dict[str, float]  # name -> angle [rad]
    collision: bool
    check: bool
    rotors: dict[str, float]  # name -> inertia about the joint [kg m^2], where not the file's


@dataclass
class Lump:
    """Bodies that move as one, in the root's axes."""

    mass: float = 0.0
    moment: Array = field(default_factory=lambda: np.zeros(3))  # m c [kg m]
    second: Array = field(default_factory=lambda: np.zeros((3, 3)))  # about the root's origin
    capsules: list[tuple[Array, Array, float]] = field(default_factory=list)  # ends, radius

    def add(self, piece: LinkMass) -> None:
        """Add a link."""
        mass, c = piece.mass, piece.com
        self.mass += mass
        self.moment = self.moment + mass * c
        square = c @ c * np.eye(3) - np.outer(c, c)
        self.second = self.second + piece.moments + mass * square

    def inertial(self, R: Array, p: Array) -> Inertial:
        """Return the mass properties in a frame of rotation (3, 3) and position (3,)."""
        if self.mass == 0:
            return Inertial(mass=0.0, com=(0.0,) * 3, inertia=matrix(np.zeros((3, 3))))
        c = self.moment / self.mass
        square = self.mass * (c @ c * np.eye(3) - np.outer(c, c))
        about = self.second - square
        if np.abs(about).max() <= _NOTHING * np.abs(square).max(initial=0.0):
            about = np.zeros((3, 3))  # of a point mass, what rounding leaves is no inertia
        turned = R.T @ about @ R
        return Inertial(
            mass=self.mass,
            com=tuple((R.T @ (c - p)).tolist()),
            inertia=matrix((turned + turned.T) / 2),
        )

    def shape(self, R: Array, p: Array) -> tuple[Capsule, ...]:
        """Return the capsules in a frame of rotation (3, 3) and position (3,)."""
        return tuple(
            Capsule(
                start=tuple((R.T @ (a - p)).tolist()),
                end=tuple((R.T @ (b - p)).tolist()),
                radius=float(radius),
            )
            for a, b, radius in self.capsules
        )


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


def given_rotors(joints: Sequence[Joint], rotors: Mapping[str, float]) -> list[str]:
    """Set rotor inertias that the reader of a file gives, and return what is to be said of it.

    Args:
        joints: of the arm.
        rotors: inertia about the joint, by its name [kg m^2].

    Raises:
        ParameterError: no such joint among those that move, or no inertia.
    """
    named = {joint.name: joint for joint in joints}
    for name, value in rotors.items():
        if name not in named:
            raise ParameterError(
                f"rotors: no moving joint {name!r}; there are {', '.join(named)}"
            )
        if not (math.isfinite(value) and value >= 0):
            raise ParameterError(
                f"rotors: inertia about joint {name!r} must be >= 0 kg m^2, got {value!r}"
            )
    for name, value in rotors.items():
        named[name].rotor_inertia = float(value)
    if not rotors:
        return []
    values = (f"{name} {value:g} kg m^2" for name, value in rotors.items())
    return [f"rotor inertia given beside the file: {', '.join(values)}"]


def arm_of(
    name: str,
    root: Lump,
    joints: list[Joint],
    tool: tuple[Array, Array],
    *,
    source: str,
    collision: bool = True,
    bandwidth: float = BANDWIDTH,
) -> SerialChain:
    """Return the arm of joint axes and bodies at zero.

    Args:
        name: of the arm.
        root: what stands on the platform.
        joints: from root to tip.
        tool: rotation (3, 3) and position (3,) [m] of the tool.
        source: where it comes from; what is derived is added.
        collision: False: leave the shapes out.
        bandwidth: of the servos [Hz].

    Raises:
        ParameterError: names the joint.
    """
    mount = upright(joints[0].axis)
    R, p = mount, joints[0].origin
    links = []
    for i, joint in enumerate(joints):
        last = i == len(joints) - 1
        axis = tool[0][:, 2] if last else joints[i + 1].axis
        target = tool[1] if last else joints[i + 1].origin
        shape = far_end(R.T @ (target - p), R.T @ axis)
        turned = about_z(shape["offset"])
        link = _link(joint, shape)
        R, p = R @ turned @ link.far_end[0], target
        try:
            inertial = joint.body.inertial(R, p)
        except ParameterError as error:
            raise ParameterError(f"what joint {joint.name!r} moves: {error}") from None
        capsules = joint.body.shape(R, p) if collision else None
        links.append(replace(link, inertial=inertial, shape=capsules))
    rest = R.T @ tool[0]
    angle = math.atan2(rest[1, 0], rest[0, 0])
    arm = SerialChain(
        name=name,
        base=root.inertial(np.eye(3), np.zeros(3)),
        base_shape=root.shape(np.eye(3), np.zeros(3)) if collision else None,
        mount=_mount(mount, joints[0].origin),
        links=tuple(links),
        tool_angle=angle if abs(angle) > _ZERO else None,
        bandwidth=bandwidth,
        source=source,
    )
    return _with_limits(arm, joints)


def require_body(piece: LinkMass) -> None:
    """Refuse mass properties that no rigid body has.

    Args:
        piece: a link.

    Raises:
        ParameterError: names the link.
    """
    try:
        Inertial(mass=piece.mass, com=(0.0, 0.0, 0.0), inertia=matrix(piece.moments))
    except ParameterError as error:
        raise ParameterError(f"link {piece.link!r}: {error}") from None
    if piece.mass == 0 and piece.moments.any():
        raise ParameterError(f"link {piece.link!r} has an inertia, but no mass")


def require_plausible(joints: list[Joint], tool: Array, pieces: list[LinkMass]) -> None:
    """Refuse lengths, masses and inertias that look like mm, g and kg mm^2.

    Args:
        joints: from root to tip.
        tool: (3,) position [m].
        pieces: the links that move.

    Raises:
        ParameterError: names the joint or the link.
    """
    points = np.array([*(joint.origin for joint in joints), tool])
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    reach = float(steps.sum())
    if reach > _REACH:
        k = int(steps.argmax())
        raise ParameterError(
            f"what joint {joints[k].name!r} moves is {steps[k]:.4g} m long and the whole arm"
            f" {reach:.4g} m: lengths must be in m, these look like mm (check=False takes them)"
        )
    apart = [np.linalg.norm(k.com - points, axis=1).min() for k in pieces if k.mass]
    size = max([reach, 1e-3, *(2 * float(k) for k in apart)])
    for piece in pieces:
        largest = float(np.abs(piece.moments).max())
        if largest > piece.mass * (_GYRATION * size) ** 2:
            raise ParameterError(
                f"link {piece.link!r} of {piece.mass:.4g} kg has an inertia of {largest:.4g}"
                f" kg m^2, a radius of gyration of {math.sqrt(largest / piece.mass):.3g} m on"
                f" an arm of {size:.3g} m: inertias must be in kg m^2, these look like kg mm^2"
                " (check=False takes them)"
            )
    total = sum(piece.mass for piece in pieces)
    if total > _DENSITY * size**3:
        heaviest = max(pieces, key=lambda piece: piece.mass)
        raise ParameterError(
            f"link {heaviest.link!r} has {heaviest.mass:.4g} kg and all that moves {total:.4g}"
            f" kg on {size:.3g} m: masses must be in kg, these look like g (check=False takes"
            " them)"
        )


def upright(axis: Array) -> Array:
    """(3, 3) a rotation that brings z to the axis; the smallest, where the axis points up."""
    if axis[2] < 0:  # 1 + z would cancel
        turned = np.diag([1.0, -1.0, -1.0])
        out: Array = turned @ upright(turned @ axis)
        return out
    x, y, z = axis
    k = 1 / (1 + z)
    return np.array(
        [[1 - k * x * x, -k * x * y, x], [-k * x * y, 1 - k * y * y, y], [-x, -y, z]]
    )


def about_z(angle: float) -> Array:
    c, s = round(math.cos(angle), 15), round(math.sin(angle), 15)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def angles_of(R: Array) -> tuple[float, float, float]:
    """Return roll, pitch and yaw of a rotation (3, 3): about x, then y, then z [rad]."""
    yaw = math.atan2(R[1, 0], R[0, 0])
    rest = about_z(yaw).T @ R  # without yaw: exact also where x points along z
    return math.atan2(-rest[1, 2], rest[1, 1]), math.atan2(-rest[2, 0], rest[0, 0]), yaw


def _mount(R: Array, p: Array) -> Mount | None:
    """The mount of a first joint at (3, 3), (3,); None at the platform-top frame."""
    mount = Mount(position=tuple(p.tolist()), angles=angles_of(R))
    return None if mount == Mount() else mount


def far_end(p: Array, axis: Array) -> dict[str, float]:
    """d, a, alpha, beta and offset of a link.

    Args:
        p: (3,) far end in the frame at the joint, at zero [m].
        axis: (3,) z of the frame there.
    """
    a = math.hypot(p[0], p[1])
    if a < _ZERO:
        slant = math.hypot(axis[0], axis[1])
        offset = math.atan2(axis[0], -axis[1]) if slant > _ZERO else 0.0
        a = 0.0
    else:
        offset = math.atan2(p[1], p[0])
    if not -math.pi / 2 < offset <= math.pi / 2 + _ZERO:  # the other way round
        offset, a = offset - math.copysign(math.pi, offset), -a
    x, y, z = about_z(offset).T @ axis
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
        inertial=Inertial(mass=0.0, com=(0.0,) * 3, inertia=matrix(np.zeros((3, 3)))),
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


def largest_inertia(arm: SerialChain) -> Array:
    """(n,) largest inertia about each joint, the others at rest [kg m^2].

    Of configurations drawn within the limits, among them zero or what is nearest to it.

    Args:
        arm: the arm.
    """
    H = inertia(arm, drawn_configurations(arm))[:, 6:, 6:]
    out: Array = np.diagonal(H, axis1=1, axis2=2).max(axis=0)
    return out


def _with_limits(arm: SerialChain, joints: list[Joint]) -> SerialChain:
    """The arm with limits derived where none are given, which its source then says."""
    most = largest_inertia(arm)
    for joint, value in zip(joints, most, strict=True):
        if value <= 1e-12:
            raise ParameterError(
                f"nothing that joint {joint.name!r} moves has an inertia about its axis, nor"
                " has its rotor: give the links an inertia, merge them (fixed joints), or say"
                f" what the rotor has about the joint: rotors={{{joint.name!r}: 0.01}} kg m^2"
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
    too_fast = _too_fast(arm)
    for i in too_fast:
        links[i] = replace(links[i], damping=None, friction=None)
    if too_fast:
        names = ", ".join(joints[i].name for i in too_fast)
        notes.append(f"damping and friction left out of {names}: on links so light, without a"
                     " rotor, they act faster than a physics step")  # fmt: skip
    source = "; ".join([arm.source, *notes])
    return replace(arm, links=tuple(links), source=source)


def _too_fast(arm: SerialChain) -> list[int]:
    """Joints whose friction brakes what they move faster than a physics step resolves."""
    rubbing = [(k.damping or 0.0) + (k.friction or 0.0) / _CREEP for k in arm.links]
    if not any(rubbing):
        return []
    H = inertia(arm, drawn_configurations(arm))[:, 6:, 6:]
    felt = 1 / np.diagonal(np.linalg.inv(H), axis1=1, axis2=2).max(axis=0)
    return [i for i, (c, J) in enumerate(zip(rubbing, felt, strict=True)) if c > _DECAY * J]


def _down(value: float) -> float:
    """The number rounded down to two digits."""
    scale = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.floor(value / scale + 1e-9) * scale:.3g}")
