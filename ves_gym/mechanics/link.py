"""Links of an arm as data: mass, joint, gear, flexures, shape, and where it is mounted."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np

from ves_gym._util.params import (
    Array,
    Matrix,
    ParameterError,
    Vector,
    finite,
    freeze_arrays,
    require_positive,
    unit,
)
from ves_gym.mechanics.spatial import rotation, skew

Turn = tuple[float, float]  # cosine and sine, to 15 digits: a right angle is exact
# Hz, of an arm that states none; the thesis's high gains: 2.2 to 3.4 (this project)
BANDWIDTH = 2.0
_ROUNDING = 1e-12  # relative slack of the inertia tests, kg m^2 per kg m^2


def diagonal(*moments: float) -> Matrix:
    """A diagonal matrix as nested tuples."""
    return matrix(np.diag(moments))


def matrix(values: Array) -> Matrix:
    """A 2-D array as nested tuples of float."""
    return tuple(map(tuple, np.asarray(values, float).tolist()))


def require_length_1(vector: Vector, name: str) -> None:
    """Refuse what is no unit vector (3,)."""
    length = float(np.linalg.norm(finite(vector, (3,), name)))
    if abs(length - 1) > 1e-9:
        raise ParameterError(f"{name} must have length 1, got {vector}")


def turn_by(angle: float) -> Turn:
    """Return cosine and sine."""
    return round(math.cos(angle), 15), round(math.sin(angle), 15)


def turned_about(axis: int, angle: float) -> Array:
    """(3, 3) rotation about x, y or z (0, 1, 2)."""
    out, i, j = np.eye(3), (axis + 1) % 3, (axis + 2) % 3
    out[i, i], out[j, i] = out[j, j], out[i, j] = turn_by(angle)
    out[i, j] *= -1.0
    return out


def angles_of(R: Array) -> tuple[float, float, float]:
    """Return roll, pitch and yaw of a rotation (3, 3): about x, then y, then z [rad]."""
    yaw = math.atan2(R[1, 0], R[0, 0])
    flat = turned_about(2, yaw).T @ R  # without yaw: exact also where x points along z
    return math.atan2(-flat[1, 2], flat[1, 1]), math.atan2(-flat[2, 0], flat[0, 0]), yaw


@dataclass(frozen=True, kw_only=True)
class Inertial:
    """Mass properties of a rigid body in its own frame."""

    mass: float = unit("kg")
    com: Vector = unit("m")  # (3,) centre of mass
    inertia: Matrix = unit("kg m^2")  # (3, 3) about the centre of mass

    def __post_init__(self) -> None:
        freeze_arrays(self)
        require_positive(self, "mass", zero=True)
        finite(self.com, (3,), "Inertial.com")
        moments = finite(self.inertia, (3, 3), "Inertial.inertia")
        size = max(float(np.abs(moments).max()), 1e-300)
        if np.abs(moments - moments.T).max() > _ROUNDING * size:
            raise ParameterError(f"Inertial.inertia must be symmetric, got {self.inertia}")
        a, b, c = np.linalg.eigvalsh(moments)
        if a < -_ROUNDING * size or c > a + b + _ROUNDING * size:
            raise ParameterError(
                "Inertial.inertia must be that of a rigid body (principal moments >= 0, none"
                f" larger than the sum of the others), got {a:.6g}, {b:.6g}, {c:.6g} kg m^2"
            )

    def placed(self, R: Array, p: Array) -> Self:
        """Return the body in axes in which its frame has rotation R (3, 3), position p (3,)."""
        com, inertia = p + R @ np.array(self.com), R @ np.array(self.inertia) @ R.T
        return replace(self, com=tuple(com.tolist()), inertia=matrix(inertia))

    def spatial(self) -> Array:
        """(6, 6) inertia at the frame's origin, linear part first [kg, kg m, kg m^2]."""
        c = skew(np.array(self.com))
        out = np.zeros((6, 6))
        out[:3, :3] = self.mass * np.eye(3)
        out[:3, 3:] = -self.mass * c
        out[3:, :3] = self.mass * c
        out[3:, 3:] = np.array(self.inertia) - self.mass * c @ c
        return out

    def box(self) -> tuple[Array, Array]:
        """Half sizes (3,) [m] and axes (3, 3) of the homogeneous box with these moments."""
        moments, axes = np.linalg.eigh(np.array(self.inertia))
        if np.linalg.det(axes) < 0:
            axes[:, 0] *= -1
        squares = 6 / max(self.mass, 1e-9) * (moments.sum() - 2 * moments)
        return np.sqrt(np.maximum(squares, 1e-4)) / 2, axes


def rigid_moments(moments: Array) -> Array:
    """Return the inertia of a rigid body (3, 3) nearest to one about its centre of mass.

    The second moments of mass along the axes, half the trace less the inertia, are none below
    zero (Wensing, Kim and Slotine, IEEE RA-L 3, 2018); those that are become zero.
    """
    symmetric = (moments + moments.T) / 2
    value, axes = np.linalg.eigh(np.trace(symmetric) / 2 * np.eye(3) - symmetric)
    second = (axes * np.maximum(value, 0.0)) @ axes.T
    out: Array = np.trace(second) * np.eye(3) - second
    return (out + out.T) / 2


WEIGHTLESS = Inertial(mass=0.0, com=(0.0, 0.0, 0.0), inertia=diagonal(0.0, 0.0, 0.0))


@dataclass(frozen=True, kw_only=True)
class Gear:
    """Spring with play between a rotor and its link, a damper beside it.

    Torque at a deflection d of the link against the rotor: -(d less the play) / compliance
    - damping d', the play being what of d lies within half the gap on either side.
    """

    compliance: float = unit("rad/(N m)")
    damping: float = unit("N m s/rad", default=0.0)
    gap: float = unit("rad", default=0.0)

    def __post_init__(self) -> None:
        require_positive(self, "compliance")
        require_positive(self, "damping", "gap", zero=True)

    @property
    def stiffness(self) -> float:
        """1 / compliance [N m/rad]."""
        return 1 / self.compliance


@dataclass(frozen=True, kw_only=True)
class Flexure:
    """Passive joint within a link: a spring and a damper about an axis, no motor.

    It divides the link: `beyond` is the part of the link's mass that lies between this
    flexure and the next one, or the link's end. All of it at rest, in the link's own frame.
    """

    origin: Vector = unit("m")  # a point on the axis
    axis: Vector = unit("1")  # (3,) unit vector
    stiffness: float = unit("N m/rad")
    damping: float = unit("N m s/rad", default=0.0)
    beyond: Inertial

    def __post_init__(self) -> None:
        freeze_arrays(self)
        finite(self.origin, (3,), "Flexure.origin")
        require_length_1(self.axis, "Flexure.axis")
        require_positive(self, "stiffness")
        require_positive(self, "damping", zero=True)


@dataclass(frozen=True, kw_only=True)
class Capsule:
    """All points within a radius of a line, in a body's own frame: its shape in collisions."""

    start: Vector = unit("m")
    end: Vector = unit("m")
    radius: float = unit("m")

    def __post_init__(self) -> None:
        freeze_arrays(self)
        finite(self.start, (3,), "Capsule.start")
        finite(self.end, (3,), "Capsule.end")
        require_positive(self, "radius")

    @staticmethod
    def of(start: Array, end: Array, radius: float) -> Capsule:
        """Return the capsule from one point (3,) to another."""
        first, last = np.asarray([start, end], float).tolist()
        return Capsule(start=tuple(first), end=tuple(last), radius=float(radius))

    def placed(self, R: Array, p: Array) -> Capsule:
        """Return the same in axes in which its frame has rotation R (3, 3), position p (3,)."""
        start, end = (p + R @ np.array(k) for k in (self.start, self.end))
        return Capsule.of(start, end, self.radius)


@dataclass(frozen=True, kw_only=True)
class Mount:
    """Place of an arm's first joint: its frame before it turns, z along the axis."""

    position: Vector = unit("m", default=(0.0, 0.0, 0.0))  # in the platform-top frame
    angles: Vector = unit("rad", default=(0.0, 0.0, 0.0))  # about its x, then y, then z

    def __post_init__(self) -> None:
        freeze_arrays(self)
        for name in ("position", "angles"):
            finite(getattr(self, name), (3,), f"{type(self).__name__}.{name}")

    @cached_property
    def rotation(self) -> Array:
        """(3, 3) from the first joint's frame to the platform-top frame."""
        turn = rotation(np.array([0.0, 0.0, 0.0, *self.angles]))
        return turn.round(15) + 0.0

    def placed(self, R: Array, p: Array) -> Self:
        """Return the same in axes in which its frame has rotation R (3, 3), position p (3,)."""
        position = (p + R @ np.array(self.position)).round(15) + 0.0
        return replace(
            self, position=tuple(position.tolist()), angles=angles_of(R @ self.rotation)
        )


@dataclass(frozen=True, kw_only=True)
class MeshFile(Mount):
    """A mesh that a body is drawn with, placed in the body's own frame: for views alone.

    Arms that differ in these are equal, and so are their systems' hashes.
    """

    file: str
    scale: Vector = unit("1", default=(1.0, 1.0, 1.0))

    def __post_init__(self) -> None:
        super().__post_init__()
        finite(self.scale, (3,), "MeshFile.scale")

    def points_at(self, points: Array) -> Array:
        """Return points (k, 3) of the file in the body's frame [m]."""
        return np.asarray(points * self.scale @ self.rotation.T + self.position, float)


@dataclass(frozen=True, kw_only=True)
class Limb:
    """One of several arms on one base: which of an arm's links it has, and where it stands."""

    name: str
    joints: int  # number of its links, after those of the arms before it
    mount: Mount | None = None  # of its first joint; None: at the platform-top frame
    tool_angle: float | None = unit("rad", default=None)  # of its tool, as in `Arm`

    def __post_init__(self) -> None:
        if self.joints < 1:
            raise ParameterError(f"Limb.joints must be >= 1, got {self.joints}")


@dataclass(frozen=True, kw_only=True)
class Link:
    """One joint and the link it moves; the frame sits at the link's far end.

    DH: frame i-1 -> i is Rot_z(q + offset) Trans_z(d) Trans_x(a) Rot_x(alpha), and Rot_y(beta)
    where one is given: the frame may then sit at any point of the next joint's axis, also
    where two axes are all but parallel (Hayati, CDC 1983). With a `gear` that gives way q is
    the rotor's angle and the link turns further by the gear's deflection, a coordinate of its
    own (Spong, J. Dyn. Sys. 109, 1987); without one rotor and link are rigidly one.
    """

    d: float = unit("m")
    a: float = unit("m")
    alpha: float = unit("rad")
    beta: float | None = unit("rad", default=None)
    offset: float = unit("rad", default=0.0)
    inertial: Inertial
    rotor_inertia: float = unit("kg m^2", default=0.0)  # reflected through the gear
    q_min: float = unit("rad")
    q_max: float = unit("rad")
    v_max: float = unit("rad/s")
    a_max: float = unit("rad/s^2")
    tau_max: float = unit("N m")
    gear: Gear | None = None
    damping: float | None = unit("N m s/rad", default=None)  # viscous friction of the joint
    friction: float | None = unit("N m", default=None)  # Coulomb friction of the joint
    shape: tuple[Capsule, ...] | None = None  # None: capsules along d and a
    meshes: tuple[MeshFile, ...] | None = field(default=None, compare=False)
    flexures: tuple[Flexure, ...] | None = None  # where it bends, joint to far end
    name: str | None = None  # of the joint, where it has another than its number
    # True: the joint slides along its axis, by d + q; its numbers are then in m, m/s, m/s^2, N,
    # kg (rotor_inertia), N s/m (damping) and N (friction)
    slides: bool | None = None

    def __post_init__(self) -> None:
        freeze_arrays(self)
        finite((self.d, self.a, self.alpha, self.offset, self.q_min, self.q_max), (6,), "Link")
        finite(self.beta or 0.0, (), "Link.beta")
        require_positive(self, "v_max", "a_max", "tau_max")
        for name in ("damping", "friction"):
            if getattr(self, name) is not None:
                require_positive(self, name, zero=True)
        require_positive(self, "rotor_inertia", zero=True)
        if self.gear is not None and self.rotor_inertia == 0:
            raise ParameterError(
                "a Link with a gear needs rotor_inertia > 0 kg m^2: the gear turns against it"
            )
        if self.slides and (self.gear is not None or self.flexures):
            raise ParameterError(
                "a Link whose joint slides must have neither gear nor flexures"
            )
        if not self.q_min < self.q_max:
            raise ParameterError(f"Link needs q_min < q_max, got {self.q_min} and {self.q_max}")

    @property
    def far_end(self) -> tuple[Array, Array]:
        """Rotation (3, 3) and position (3,) of the link frame in the frame at its joint."""
        rotation = turned_about(0, self.alpha)
        if self.beta:
            rotation = rotation @ turned_about(1, self.beta)
        return rotation, np.array([self.a, 0.0, self.d])

    @property
    def inertial_at_joint(self) -> Inertial:
        """The same mass properties in the frame at the joint (z along its axis)."""
        return self.inertial.placed(*self.far_end)


@dataclass(frozen=True, kw_only=True)
class Follower:
    """A joint that is geared to the arm's joints, and the link it moves: q = ratios . q_arm.

    It stands in the chain from base to tool at a `place`, or beside the chain `on` a link. Its
    zero is where it stands while they all are at zero. It has neither limits nor friction of
    its own: what it follows has both joints'.
    """

    link: Link
    ratios: Vector = unit("1")  # (n,) rad or m per rad or m of each of the arm's joints
    place: int | None = None  # among the links from base to tool, from 0; None: beside them
    on: int | None = None  # -1: the base link; a place; past these, followers beside, in order
    mount: Mount | None = None  # beside the chain: its joint's frame in what carries it

    def __post_init__(self) -> None:
        freeze_arrays(self)
        finite(self.ratios, (len(self.ratios),), "Follower.ratios")
        if (self.place is None) == (self.on is None):
            raise ParameterError(
                f"a Follower needs place (in the chain) or on (beside it), got {self.place} and"
                f" {self.on}"
            )
        if self.link.gear is not None or self.link.flexures:
            raise ParameterError("a Follower's link must have neither gear nor flexures")
        if not any(self.ratios):
            raise ParameterError("Follower.ratios must not all be 0: it would follow nothing")
