"""What a free body carries on one joint each: reaction wheels, panels, sloshing masses.

Exact multibody terms, not a linearised mode: a carried body turns or slides on the satellite,
whatever the satellite does (docs/spacecraft.md derives them). Plain NumPy, as `dynamics` is.
Frame: the platform's, wrench and twist at its origin, linear part first.
"""

from __future__ import annotations

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
from ves_gym.mechanics.dynamics import (
    body_loads,
    moments,
    packed,
    packed_matvec,
    spatial_inertia,
    swing,
    turned_inertia,
)
from ves_gym.mechanics.link import Inertial, require_length_1
from ves_gym.mechanics.spatial import cross, room, skew


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
        require_length_1(self.axis, "ReactionWheel.axis")
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
        require_length_1(self.axis, "Appendage.axis")
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
        return float(inertia_of(self, np.zeros(())).joint)


Carried = ReactionWheel | Appendage


class CarriedInertia(NamedTuple):
    """A carried body's part of the inertia matrix."""

    locked: Array | None  # (..., 6, 6) with its joint locked; None: in the satellite's body
    across: Array  # (..., 6) momentum per unit rate of its joint
    joint: Array  # (...) inertia of the joint [kg m^2, kg]


def _about(axis: Array, angle: Array) -> Array:
    """Rotation (..., 3, 3) about a fixed axis (Rodrigues)."""
    along = np.outer(axis, axis)
    s, c = np.sin(angle)[..., None, None], np.cos(angle)[..., None, None]
    return along + c * (np.eye(3) - along) + s * skew(axis)


def placed(part: Any, at: Array) -> tuple[Array, Array]:
    """Return centre of mass (..., 3) and inertia about it (..., 6) of an appendage, see
    `inertia_of`."""
    com, inertia = np.asanyarray(part.body.com), np.asanyarray(part.body.inertia)
    axis = np.array(part.axis)
    if part.joint == "slide":
        return com + at[..., None] * axis, packed(inertia)
    R, point = _about(axis, at), np.array(part.point)
    return point + (R * (com - point)).sum(axis=-1), turned_inertia(R, inertia)


def inertia_of(part: Any, at: Array) -> CarriedInertia:
    """Return the part of the inertia matrix of a `ReactionWheel` or `Appendage`, or the same
    with symbols for numbers, its joint at an angle or way (...)."""
    axis = np.array(part.axis)
    if part.kind == "wheel":
        spun = np.concatenate([np.zeros(3), np.asanyarray(part.inertia)[None] * axis])
        return CarriedInertia(None, spun, part.inertia)
    (com, turned), mass = placed(part, at), np.asanyarray(part.body.mass)
    locked = spatial_inertia(mass, *moments(mass, com, turned))
    if part.joint == "slide":
        linear = mass[..., None] * axis
        across = _side_by_side(linear, cross(com, linear))
        return CarriedInertia(locked, across, part.body.mass)
    arm = com - np.array(part.point)
    linear = mass[..., None] * cross(axis, arm)
    spun = packed_matvec(turned, axis)
    joint = (axis * (spun + cross(arm, linear))).sum(axis=-1)
    return CarriedInertia(locked, _side_by_side(linear, spun + cross(com, linear)), joint)


def _side_by_side(a: Array, b: Array) -> Array:
    """(..., 6) of two (..., 3)."""
    out = room(b, *b.shape[:-1], 6)
    out[..., :3], out[..., 3:] = a, b
    return out


def load_of(
    part: Any, at: Array, rate: Array, spin: Array, turn: Array, accel: Array
) -> tuple[Array, Array]:
    """Return what a carried body's motion takes, the rate (...) of its joint constant: wrench
    (..., 6) on it at the platform's origin [N, N m], and effort (...) of its joint.

    In axes of the platform, of angular velocity `spin` and acceleration `turn`, whose origin
    has the acceleration `accel` (..., 3).
    """
    axis = np.array(part.axis)
    if part.kind == "wheel":
        momentum = (part.inertia * rate)[..., None] * axis
        effort = part.inertia * (axis * turn).sum(axis=-1)
        return _side_by_side(np.zeros(3), cross(spin, momentum)), effort
    com, turned = placed(part, at)
    w, dw, moving = spin, turn, rate[..., None] * axis
    if part.joint == "slide":
        a = accel + swing(spin, turn, com) + 2.0 * cross(spin, moving)
    else:
        point = np.array(part.point)
        arm = com - point
        w, dw = spin + moving, turn + cross(spin, moving)
        a = accel + swing(spin, turn, point) + swing(w, dw, arm)
    force, moment = body_loads(np.asanyarray(part.body.mass), com, turned, w, dw, a)
    effort = (axis * force).sum(axis=-1)
    if part.joint == "hinge":
        effort = (axis * (moment - cross(point, force))).sum(axis=-1)
    return _side_by_side(force, moment), effort


def passive_effort(part: Any, at: Array, rate: Array) -> Any:
    """Return the effort of spring and damper on a carried body's joint [N m, N]."""
    if part.kind == "appendage":
        return -part.stiffness * at - part.damping * rate
    return -part.viscous * rate


# ------------------------------------------------------------------------ on arrays


def carried_inertia(carried: tuple[Carried, ...], at: Array) -> tuple[Array, Array, Array]:
    """Return the parts of k carried bodies of the inertia matrix, their joints `at` (..., k):
    sum of the locked ones (..., 6, 6), across (..., 6, k), joints (..., k)."""
    shape, k = at.shape[:-1], len(carried)
    locked, across = np.zeros((*shape, 6, 6)), np.zeros((*shape, 6, k))
    joints = np.zeros((*shape, k))
    for c, part in enumerate(carried):
        entries = inertia_of(part, at[..., c])
        across[..., c], joints[..., c] = entries.across, entries.joint
        if entries.locked is not None:
            locked += entries.locked
    return locked, across, joints


def linear_joints(carried: tuple[Carried, ...]) -> tuple[Array, Array, Array, Array]:
    """Return momentum per rate across (6, k), inertia, damping and stiffness of k joints (k,)
    near rest: a wheel's Coulomb friction is left out."""
    at = np.zeros(len(carried))
    _, across, inertia = carried_inertia(carried, at)
    damping, stiffness = at.copy(), at.copy()
    for c, part in enumerate(carried):
        damping[c] = -passive_effort(part, np.zeros(()), np.ones(()))
        stiffness[c] = -passive_effort(part, np.ones(()), np.zeros(()))
    return across, inertia, damping, stiffness


def carried_energy(
    carried: tuple[Carried, ...], twist: Array, at: Array, rate: Array
) -> tuple[Array, Array, Array]:
    """Return strain energy, kinetic energy and power lost (...) of k carried bodies [J], [W],
    their joints and rates (..., k), the platform's twist (..., 6) in its axes; the kinetic
    energy is what they add to that of the satellite's body."""
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
    """Return the wrench (n, 6) that the motion of carried bodies takes at the platform's
    origin, its axes [N, N m].

    Args:
        carried: k of them, the w wheels first; `at` and `rate` (n, k) are of their joints.
        twist, twist_rate: (n, 6) of the platform and its rate, components in its axes.
        motor: (n, w) torque of the wheels' motors [N m].
    """
    out = np.zeros(twist.shape)
    spin, turn = twist[:, 3:], twist_rate[:, 3:]
    accel = twist_rate[:, :3] + cross(spin, twist[:, :3])
    for c, part in enumerate(carried):
        entries = inertia_of(part, at[:, c])
        wrench, effort = load_of(part, at[:, c], rate[:, c], spin, turn, accel)
        drive = motor[:, c] if c < motor.shape[1] else 0.0
        pushed = passive_effort(part, at[:, c], rate[:, c]) + drive - effort
        joint = pushed / entries.joint  # what the motion of the platform leaves it
        out += wrench + entries.across * joint[:, None]
    return out
