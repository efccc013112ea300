"""What a free body carries on one joint each: reaction wheels, panels, sloshing masses.

Exact multibody terms, not a linearised mode: a carried body turns or slides on the satellite,
whatever the satellite does (docs/spacecraft.md derives them). Component by component, as in
`dynamics`, so that one text serves NumPy and the kernel's graph. Frame: the platform's, wrench
and twist at its origin, linear part first.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from ves_gym._util.params import (
    Array,
    ParameterError,
    Vector,
    finite,
    freeze_arrays,
    require_choice,
    require_positive,
    unit,
)
from ves_gym.mechanics.dynamics import ZERO, Rotation, Scalar, Vec, add, cross, dot, scale
from ves_gym.mechanics.serial_chain import Inertial


def _require_unit(vector: Vector, name: str) -> None:
    length = float(np.linalg.norm(finite(vector, (3,), name)))
    if abs(length - 1) > 1e-9:
        raise ParameterError(f"{name} must have length 1, got {vector}")


@dataclass(frozen=True, kw_only=True)
class ReactionWheel:
    """A balanced rotor with a motor; at rest its mass and inertia are the satellite's own.

    Torque on the rotor: what the motor gives, within `torque_max`, less `viscous` times the
    speed, less `coulomb` against it (`pointing.on_rotors`). At `momentum_max` (inertia times
    speed) the motor only brakes.
    """

    kind: ClassVar[str] = "wheel"
    axis: Vector = unit("1")  # (3,) unit vector, of positive speed
    inertia: float = unit("kg m^2")  # about the axis
    torque_max: float = unit("N m")
    momentum_max: float = unit("N m s")
    viscous: float = unit("N m s", default=0.0)
    coulomb: float = unit("N m", default=0.0)

    def __post_init__(self) -> None:
        freeze_arrays(self)
        _require_unit(self.axis, "ReactionWheel.axis")
        require_positive(self, "inertia", "torque_max", "momentum_max")
        require_positive(self, "viscous", "coulomb", zero=True)

    @property
    def speed_max(self) -> float:
        """Speed at which the wheel is saturated [rad/s]."""
        return self.momentum_max / self.inertia


@dataclass(frozen=True, kw_only=True)
class Appendage:
    """A rigid body on a spring and a damper: a panel on a hinge, a sloshing mass on a slide.

    `hinge` turns about `axis` through `point`, `slide` moves along `axis`. The mass properties
    are those with the spring relaxed, in platform axes, beside those of the satellite's body.
    """

    kind: ClassVar[str] = "appendage"
    joint: str  # hinge or slide
    axis: Vector = unit("1")  # (3,) unit vector
    point: Vector = unit("m", default=(0.0, 0.0, 0.0))  # on the axis of a hinge
    body: Inertial
    stiffness: float = unit("N m/rad, N/m")
    damping: float = unit("N m s/rad, N s/m", default=0.0)

    def __post_init__(self) -> None:
        freeze_arrays(self)
        require_choice(self, "joint", ("hinge", "slide"))
        _require_unit(self.axis, "Appendage.axis")
        finite(self.point, (3,), "Appendage.point")
        require_positive(self, "stiffness")
        require_positive(self, "damping", zero=True)
        if not self.inertia > 0:
            raise ParameterError(
                f"Appendage.body must have inertia about its {self.joint}, got {self.body}"
            )

    @property
    def inertia(self) -> float:
        """Inertia that its spring moves, the satellite at rest [kg m^2, kg]."""
        return float(inertia_of(self, 0.0, math).joint)

    @property
    def frequency(self) -> float:
        """Natural frequency, the satellite at rest [Hz]."""
        return math.sqrt(self.stiffness / self.inertia) / (2 * math.pi)


Carried = ReactionWheel | Appendage


class CarriedInertia(NamedTuple):
    """A carried body's part of the inertia matrix, as scalars."""

    locked: list[list[Scalar]] | None  # (6, 6) with its joint locked; None: in the body's
    across: list[Scalar]  # (6,) momentum per unit rate of its joint
    joint: Scalar  # inertia of the joint [kg m^2, kg]


def _turn(axis: Vec, angle: Scalar, xp: Any) -> Rotation:
    """Rotation about a fixed axis (Rodrigues)."""
    s, c = xp.sin(angle), xp.cos(angle)
    columns = []
    for unit_vector in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)):
        along = scale(dot(axis, unit_vector), axis)
        columns.append(
            add(
                along,
                scale(c, add(unit_vector, scale(-1.0, along))),
                scale(s, cross(axis, unit_vector)),
            )
        )
    return Rotation(*columns)


def _placed(part: Any, at: Scalar, xp: Any) -> tuple[Vec, list[list[Scalar]]]:
    """Centre of mass and inertia about it of an appendage at a deflection, platform axes."""
    com: Vec = (part.body.com[0], part.body.com[1], part.body.com[2])
    I = [list(row) for row in part.body.inertia]
    axis = _vec(part.axis)
    if part.joint == "slide":
        return add(com, scale(at, axis)), I
    R, point = _turn(axis, at, xp), _vec(part.point)
    arm = R.apply(add(com, scale(-1.0, point)))
    half = [R.apply((row[0], row[1], row[2])) for row in I]  # R I, by columns (I = I^T)
    rows = zip(*half, strict=True)
    turned = [[dot(_vec(row), (R.x[j], R.y[j], R.z[j])) for j in range(3)] for row in rows]
    return add(point, arm), turned


def _vec(v: Any) -> Vec:
    x, y, z = v
    return x, y, z


def _applied(matrix: list[list[Scalar]], v: Vec) -> Vec:
    x, y, z = (dot(_vec(row), v) for row in matrix)
    return x, y, z


def inertia_of(part: Any, at: Scalar, xp: Any = np) -> CarriedInertia:
    """Return a carried body's part of the inertia matrix.

    Args:
        part: a `ReactionWheel` or `Appendage`, or the same with symbols for numbers.
        at: angle or way of its joint.
        xp: namespace of sin and cos.
    """
    axis = _vec(part.axis)
    if part.kind == "wheel":
        return CarriedInertia(None, [0.0, 0.0, 0.0, *scale(part.inertia, axis)], part.inertia)
    com, I = _placed(part, at, xp)
    mass = part.body.mass
    x, y, z = scale(mass, com)
    locked: list[list[Scalar]] = [[0.0] * 6 for _ in range(6)]
    square = dot(com, com)
    for i in range(3):
        locked[i][i] = mass
        for j in range(3):
            shift = (square if i == j else 0.0) - com[i] * com[j]
            locked[3 + i][3 + j] = I[i][j] + mass * shift
    for i, j, value in ((0, 4, z), (1, 5, x), (2, 3, y), (0, 5, -y), (1, 3, -z), (2, 4, -x)):
        locked[i][j] = locked[j][i] = value
    if part.joint == "slide":
        linear = scale(mass, axis)
        return CarriedInertia(locked, [*linear, *cross(com, linear)], mass)
    arm = add(com, scale(-1.0, _vec(part.point)))
    linear, spun = scale(mass, cross(axis, arm)), _applied(I, axis)
    about = add(spun, cross(arm, linear))
    return CarriedInertia(locked, [*linear, *add(spun, cross(com, linear))], dot(axis, about))


def load_of(
    part: Any, at: Scalar, rate: Scalar, spin: Vec, turn: Vec, accel: Vec, xp: Any = np
) -> tuple[Vec, Vec, Scalar]:
    """Return what a carried body's motion takes, the rate of its joint constant.

    Args:
        part, at, xp: see `inertia_of`.
        rate: of its joint.
        spin, turn: angular velocity and acceleration of the platform, its axes.
        accel: acceleration of its origin, its axes.

    Returns:
        Force [N] and moment [N m] on it at the platform's origin, and effort of its joint.
    """
    axis = _vec(part.axis)
    if part.kind == "wheel":
        momentum = scale(part.inertia * rate, axis)
        return ZERO, cross(spin, momentum), part.inertia * dot(axis, turn)
    com, I = _placed(part, at, xp)
    w, dw, moving = spin, turn, scale(rate, axis)
    if part.joint == "slide":
        a = add(accel, cross(turn, com), cross(spin, cross(spin, com)))
        a = add(a, scale(2.0, cross(spin, moving)))
    else:
        point = _vec(part.point)
        arm = add(com, scale(-1.0, point))
        a = add(accel, cross(turn, point), cross(spin, cross(spin, point)))
        w, dw = add(spin, moving), add(turn, cross(spin, moving))
        a = add(a, cross(dw, arm), cross(w, cross(w, arm)))
    force = scale(part.body.mass, a)
    moment = add(_applied(I, dw), cross(w, _applied(I, w)))
    effort = dot(axis, force)
    if part.joint == "hinge":
        effort = dot(axis, add(moment, cross(arm, force)))
    return force, add(moment, cross(com, force)), effort


def passive_effort(part: Any, at: Scalar, rate: Scalar) -> Scalar:
    """Return the effort of spring and damper on a carried body's joint [N m, N].

    Args:
        part, at, rate: see `load_of`.
    """
    if part.kind == "appendage":
        return -part.stiffness * at - part.damping * rate
    return -part.viscous * rate


# ------------------------------------------------------------------------ on arrays


def carried_inertia(carried: tuple[Carried, ...], at: Array) -> tuple[Array, Array, Array]:
    """Return the parts of all carried bodies of the inertia matrix.

    Args:
        carried: k of them.
        at: (..., k) angles and ways of their joints.

    Returns:
        Sum of the locked ones (..., 6, 6), across (..., 6, k), joints (..., k).
    """
    shape, k = at.shape[:-1], len(carried)
    locked, across = np.zeros((*shape, 6, 6)), np.zeros((*shape, 6, k))
    joints = np.zeros((*shape, k))
    for c, part in enumerate(carried):
        entries = inertia_of(part, at[..., c])
        for i in range(6):
            across[..., i, c] = entries.across[i]
            for j in range(6 if entries.locked is not None else 0):
                locked[..., i, j] += entries.locked[i][j]  # type: ignore[index]
        joints[..., c] = entries.joint
    return locked, across, joints


def carried_energy(
    carried: tuple[Carried, ...], twist: Array, at: Array, rate: Array
) -> tuple[Array, Array, Array]:
    """Return strain energy, kinetic energy and power lost of carried bodies [J], [W].

    Args:
        carried: k of them.
        twist: (..., 6) of the platform in its axes.
        at, rate: (..., k) of their joints.

    Returns:
        (...,) each; the kinetic energy is what they add to that of the satellite's body.
    """
    locked, across, joints = carried_inertia(carried, at)
    kinetic = 0.5 * np.einsum("...i,...ij,...j->...", twist, locked, twist)
    kinetic += np.einsum("...i,...ij,...j->...", twist, across, rate)
    kinetic += 0.5 * np.sum(joints * rate**2, axis=-1)
    strain, power = np.zeros(kinetic.shape), np.zeros(kinetic.shape)
    for c, part in enumerate(carried):
        effort = passive_effort(part, 0.0 * at[..., c], rate[..., c])
        power -= effort * rate[..., c]
        if isinstance(part, Appendage):
            strain += 0.5 * part.stiffness * at[..., c] ** 2
    return strain, kinetic, power


def carried_wrench(
    carried: tuple[Carried, ...],
    at: Array,
    rate: Array,
    twist: Array,
    twist_rate: Array,
    motor: Array,
) -> Array:
    """Return the wrench that the motion of carried bodies takes at the platform's origin.

    Args:
        carried: k of them, the w wheels first.
        at, rate: (n, k) of their joints.
        twist, twist_rate: (n, 6) of the platform and its rate, components in its axes.
        motor: (n, w) torque of the wheels' motors [N m].

    Returns:
        (n, 6) in platform axes [N, N m].
    """
    out = np.zeros(twist.shape)
    spin, turn = _vec(twist[:, 3:].T), _vec(twist_rate[:, 3:].T)
    accel = _vec((twist_rate[:, :3] + np.cross(twist[:, 3:], twist[:, :3])).T)
    for c, part in enumerate(carried):
        entries = inertia_of(part, at[:, c])
        force, moment, effort = load_of(part, at[:, c], rate[:, c], spin, turn, accel)
        drive = motor[:, c] if c < motor.shape[1] else 0.0
        pushed = passive_effort(part, at[:, c], rate[:, c]) + drive - effort
        joint = pushed / entries.joint  # what the motion of the platform leaves it
        for i, value in enumerate((*force, *moment)):
            out[:, i] += value + entries.across[i] * joint
    return out
