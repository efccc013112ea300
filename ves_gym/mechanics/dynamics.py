"""Rigid-body dynamics of the arm on its base, vectorised over configurations.

Everything is written component by component, on tuples of three scalars, where a
scalar is a float, an array over configurations, or any other object with arithmetic
(a symbolic expression). One text therefore serves a million configurations in NumPy
and can be traced. Products with exact zeros and ones of the DH table are dropped.

Frame: the platform-top frame; wrench and twist at its origin, linear part first.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, ParameterError
from ves_gym.mechanics.serial_chain import SerialChain

Scalar = Any  # float, array over configurations, or symbol
Vec = tuple[Scalar, Scalar, Scalar]
ZERO: Vec = (0.0, 0.0, 0.0)


# ------------------------------------------------------- scalars and three-vectors


def _mul(a: Scalar, b: Scalar) -> Scalar:
    if isinstance(a, float) and a in (0.0, 1.0):
        return b if a else 0.0
    if isinstance(b, float) and b in (0.0, 1.0):
        return a if b else 0.0
    return a * b


def _add(a: Scalar, b: Scalar) -> Scalar:
    if isinstance(a, float) and a == 0.0:
        return b
    if isinstance(b, float) and b == 0.0:
        return a
    return a + b


def _sub(a: Scalar, b: Scalar) -> Scalar:
    if isinstance(b, float) and b == 0.0:
        return a
    return -b if isinstance(a, float) and a == 0.0 else a - b


def add(*vectors: Vec) -> Vec:
    """Sum of three-vectors."""
    x, y, z = ZERO
    for v in vectors:
        x, y, z = _add(x, v[0]), _add(y, v[1]), _add(z, v[2])
    return x, y, z


def scale(s: Scalar, v: Vec) -> Vec:
    """Scalar times vector."""
    return _mul(s, v[0]), _mul(s, v[1]), _mul(s, v[2])


def dot(a: Vec, b: Vec) -> Scalar:
    """Scalar product."""
    return _add(_add(_mul(a[0], b[0]), _mul(a[1], b[1])), _mul(a[2], b[2]))


def cross(a: Vec, b: Vec) -> Vec:
    """Vector product."""
    return (
        _sub(_mul(a[1], b[2]), _mul(a[2], b[1])),
        _sub(_mul(a[2], b[0]), _mul(a[0], b[2])),
        _sub(_mul(a[0], b[1]), _mul(a[1], b[0])),
    )


class Rotation(NamedTuple):
    """Rotation by its columns."""

    x: Vec
    y: Vec
    z: Vec

    def apply(self, v: Vec) -> Vec:
        """Turn a vector: R v."""
        return add(scale(v[0], self.x), scale(v[1], self.y), scale(v[2], self.z))


IDENTITY = Rotation((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


# ----------------------------------------------------------------------- kinematics


class Frame(NamedTuple):
    """Pose of a link's DH frame, and the joint that moves it."""

    rotation: Rotation
    position: Vec  # m
    axis: Vec  # joint axis
    origin: Vec  # a point on the joint axis [m]
    slides: bool = False  # the joint moves along its axis

    def moved(self, point: Vec) -> tuple[Vec, Vec]:
        """Return velocity of a point beyond the joint and angular velocity, per joint rate."""
        if self.slides:
            return self.axis, ZERO
        return cross(self.axis, add(point, scale(-1.0, self.origin))), self.axis


def start(arm: SerialChain) -> tuple[Rotation, Vec]:
    """Return the pose of the first joint's frame, before it turns, in the platform-top frame.

    Args:
        arm: with its mount.
    """
    if arm.mount is None:
        return IDENTITY, ZERO
    x, y, z = (tuple(column) for column in arm.mount.rotation.T.tolist())
    px, py, pz = (float(k) for k in arm.mount.position)
    return Rotation(x, y, z), (px, py, pz)


def frames(arm: SerialChain, q: list[Scalar], xp: Any = np) -> list[Frame]:
    """Return the pose of every link frame in the platform-top frame (thesis B.3).

    Args:
        arm: the arm.
        q: n joint angles [rad], numbers, arrays or symbols.
        xp: namespace of sin and cos: NumPy, CasADi.

    Returns:
        One frame per link, first link first.
    """
    out = []
    R, p = start(arm)
    for link, value in zip(arm.links, q, strict=True):
        axis, origin, d = R.z, p, link.d
        if link.slides:
            c, s = round(math.cos(link.offset), 15), round(math.sin(link.offset), 15)
            d = d + value
        else:
            angle = value + link.offset if link.offset else value
            c, s = xp.cos(angle), xp.sin(angle)
        x = add(scale(c, R.x), scale(s, R.y))
        y = add(scale(-s, R.x), scale(c, R.y))
        p = add(p, scale(d, axis), scale(link.a, x))
        ca, sa = round(math.cos(link.alpha), 15), round(math.sin(link.alpha), 15)
        R = Rotation(x, add(scale(ca, y), scale(sa, axis)), add(scale(-sa, y), scale(ca, axis)))
        if link.beta:
            cb, sb = round(math.cos(link.beta), 15), round(math.sin(link.beta), 15)
            x, z = R.x, R.z
            R = Rotation(add(scale(cb, x), scale(-sb, z)), R.y, add(scale(sb, x), scale(cb, z)))
        out.append(Frame(R, p, axis, origin, bool(link.slides)))
    return out


def joint_positions(arm: SerialChain, q: npt.ArrayLike) -> Array:
    """Return the origins of the platform frame and of every link frame.

    Args:
        arm: the arm.
        q: (..., n) joint angles [rad].

    Returns:
        (..., n + 1, 3) points [m]; the last is the tool (the far end of the last link).
    """
    angles = _columns(arm, q)
    shape = angles[0].shape
    out = np.zeros((*shape, arm.n + 1, 3))
    for i, frame in enumerate(frames(arm, angles)):
        for k in range(3):
            out[..., i + 1, k] = frame.position[k]
    return out


def _columns(arm: SerialChain, q: npt.ArrayLike, name: str = "q") -> list[Array]:
    array = np.asarray(q, float)
    if array.ndim == 0 or array.shape[-1] != arm.n:
        raise ParameterError(f"{name} must have shape (..., {arm.n}), got {array.shape}")
    return list(np.moveaxis(array, -1, 0).copy())


# ------------------------------------------------------------------- inertia matrix


class _Composite(NamedTuple):
    """Mass, first moment and second moment of a set of bodies about the origin."""

    mass: float
    moment: Vec  # kg m
    xx: Scalar  # second moment [kg m^2]
    yy: Scalar
    zz: Scalar
    xy: Scalar
    xz: Scalar
    yz: Scalar

    def plus(self, other: _Composite) -> _Composite:
        return _Composite(
            self.mass + other.mass,
            add(self.moment, other.moment),
            *(_add(a, b) for a, b in zip(self[2:], other[2:], strict=True)),
        )

    def turn(self, w: Vec) -> Vec:
        """Angular momentum about the origin of a rotation w about the origin."""
        return (
            dot((self.xx, self.xy, self.xz), w),
            dot((self.xy, self.yy, self.yz), w),
            dot((self.xz, self.yz, self.zz), w),
        )


def _body(
    mass: float, com: Vec, R: Rotation, inertia: tuple[tuple[float, ...], ...]
) -> _Composite:
    """A rigid body at `com` [m], turned by R, seen from the origin."""
    cols = [R.apply((row[0], row[1], row[2])) for row in inertia]  # R I, by columns (I = I^T)

    def moment(i: int, j: int) -> Scalar:
        turned = dot((cols[0][i], cols[1][i], cols[2][i]), (R.x[j], R.y[j], R.z[j]))
        return _sub(turned, _mul(mass, _mul(com[i], com[j])))

    square = _mul(mass, dot(com, com))
    return _Composite(
        mass,
        scale(mass, com),
        *(_add(moment(i, i), square) for i in range(3)),
        *(moment(i, j) for i, j in ((0, 1), (0, 2), (1, 2))),
    )


def _base_body(arm: SerialChain) -> _Composite:
    x, y, z = arm.base.com
    return _body(arm.base.mass, (x, y, z), IDENTITY, arm.base.inertia)


class InertiaEntries(NamedTuple):
    """The inertia matrix by its parts, as scalars."""

    base: list[list[Scalar]]  # (6, 6) spatial inertia of all bodies at the origin
    across: list[list[Scalar]]  # (n, 6) momentum of all bodies per unit joint rate
    joints: list[list[Scalar]]  # (n, n) rotors included


def inertia_entries(arm: SerialChain, q: list[Scalar], xp: Any = np) -> InertiaEntries:
    """Return the parts of `inertia` for one configuration of scalars.

    Args:
        arm: the arm.
        q: n joint angles [rad], numbers, arrays or symbols.
        xp: namespace of sin and cos.
    """
    n, chain = arm.n, frames(arm, q, xp)
    composite: _Composite | None = None
    across: list[list[Scalar]] = [[] for _ in range(n)]
    joints: list[list[Scalar]] = [[0.0] * n for _ in range(n)]
    for j in reversed(range(n)):
        link, frame = arm.links[j], chain[j]
        x, y, z = link.inertial.com
        com = add(frame.position, frame.rotation.apply((x, y, z)))
        body = _body(link.inertial.mass, com, frame.rotation, link.inertial.inertia)
        composite = body if composite is None else composite.plus(body)
        # unit rate of joint j: linear and angular momentum (about the origin) of what it moves
        if frame.slides:
            linear = scale(composite.mass, frame.axis)
            angular = cross(composite.moment, frame.axis)
        else:
            slide = cross(frame.origin, frame.axis)
            linear = add(scale(composite.mass, slide), cross(frame.axis, composite.moment))
            angular = add(cross(composite.moment, slide), composite.turn(frame.axis))
        across[j] = [*linear, *angular]
        for i in range(j + 1):
            value = _along(chain[i], linear, angular)
            joints[i][j] = joints[j][i] = value
        joints[j][j] = _add(joints[j][j], link.rotor_inertia)
    assert composite is not None  # an Arm has at least one link
    return InertiaEntries(_spatial(composite.plus(_base_body(arm))), across, joints)


def _along(joint: Frame, force: Vec, moment: Vec) -> Scalar:
    """Force, or moment about the origin, that a joint's coordinate feels."""
    if joint.slides:
        return dot(joint.axis, force)
    return _add(dot(joint.axis, moment), dot(cross(joint.origin, joint.axis), force))


def inertia(arm: SerialChain, q: npt.ArrayLike) -> Array:
    """Inertia matrix of the arm and its base link, base at the origin.

    Args:
        q: (..., n) joint angles [rad].

    Returns:
        (..., 6 + n, 6 + n): [[H_b, H_bm], [H_bm^T, H_m]] for the base twist (linear part
        first, platform-top frame) and the joint rates; rotors included in H_m.
    """
    angles = _columns(arm, q)
    n, shape = arm.n, angles[0].shape
    parts = inertia_entries(arm, angles)
    out = np.empty((*shape, 6 + n, 6 + n))
    for i in range(6):
        for j in range(6):
            out[..., i, j] = parts.base[i][j]
    for j in range(n):
        for k in range(6):
            out[..., k, 6 + j] = out[..., 6 + j, k] = parts.across[j][k]
        for i in range(n):
            out[..., 6 + i, 6 + j] = parts.joints[i][j]
    return out


def drawn_configurations(arm: SerialChain) -> Array:
    """(257, n) zero, or what is nearest to it, and angles drawn within the limits [rad].

    Args:
        arm: the arm.
    """
    low, high = arm.column("q_min"), arm.column("q_max")
    drawn = low + (high - low) * np.random.default_rng(0).uniform(size=(256, arm.n))
    return np.vstack([np.clip(0.0, low, high), drawn])


def _spatial(c: _Composite) -> list[list[Scalar]]:
    """(6, 6) spatial inertia of a composite at the origin."""
    x, y, z = c.moment
    out: list[list[Scalar]] = [[0.0] * 6 for _ in range(6)]
    for i in range(3):
        out[i][i] = c.mass
    for i, j, value in ((0, 4, z), (1, 5, x), (2, 3, y)):
        out[i][j] = out[j][i] = value
    for i, j, value in ((0, 5, y), (1, 3, z), (2, 4, x)):
        out[i][j] = out[j][i] = _sub(0.0, value)
    for i, j, value in (
        (3, 3, c.xx),
        (4, 4, c.yy),
        (5, 5, c.zz),
        (3, 4, c.xy),
        (3, 5, c.xz),
        (4, 5, c.yz),
    ):
        out[i][j] = out[j][i] = value
    return out


# ------------------------------------------------------------------ inverse dynamics


def newton_euler(
    arm: SerialChain,
    q: list[Scalar],
    v: list[Scalar],
    a: list[Scalar],
    *,
    spin: Vec = ZERO,
    turn: Vec = ZERO,
    accel: Vec = ZERO,
    xp: Any = np,
) -> tuple[list[Scalar], Vec, Vec]:
    """Torques of a motion, and force and moment that move the whole arm with its base link.

    Args:
        spin, turn: angular velocity and acceleration of the base, platform axes.
        accel: acceleration of its origin less that of free fall, platform axes.

    Returns:
        tau (n) [N m], rotors included; force [N] and moment [N m] on the base link at the
        platform-top origin, platform axes. What the arm exerts on the base is their negative.
    """
    chain = frames(arm, q, xp)
    forces: list[tuple[Vec, Vec]] = []  # of each body: force, moment about the origin

    def body(inertial: Any, R: Rotation, com: Vec, w: Vec, dw: Vec, at_com: Vec) -> None:
        force = scale(inertial.mass, at_com)
        moment = _body(0.0, ZERO, R, inertial.inertia)
        spun = add(moment.turn(dw), cross(w, moment.turn(w)))
        forces.append((force, add(spun, cross(com, force))))

    def moved(a0: Vec, w: Vec, dw: Vec, r: Vec) -> Vec:
        return add(a0, cross(dw, r), cross(w, cross(w, r)))

    x, y, z = arm.base.com
    body(arm.base, IDENTITY, (x, y, z), spin, turn, moved(accel, spin, turn, (x, y, z)))
    w, dw, point = spin, turn, start(arm)[1]  # motion of the frame reached so far
    accel = moved(accel, w, dw, point)
    for i, frame in enumerate(chain):
        rate = scale(v[i], frame.axis)
        if frame.slides:
            accel = add(accel, scale(a[i], frame.axis), scale(2.0, cross(w, rate)))
        else:
            dw = add(dw, scale(a[i], frame.axis), cross(w, rate))
            w = add(w, rate)
        x, y, z = arm.links[i].inertial.com
        com = add(frame.position, frame.rotation.apply((x, y, z)))
        at_com = moved(accel, w, dw, add(com, scale(-1.0, point)))
        body(arm.links[i].inertial, frame.rotation, com, w, dw, at_com)
        accel = moved(accel, w, dw, add(frame.position, scale(-1.0, point)))
        point = frame.position

    tau: list[Scalar] = [0.0] * arm.n
    force, moment = ZERO, ZERO  # what the links from i outwards need
    for i in reversed(range(arm.n)):
        force, moment = add(force, forces[i + 1][0]), add(moment, forces[i + 1][1])
        along = _along(chain[i], force, moment)
        tau[i] = _add(along, _mul(arm.links[i].rotor_inertia, a[i]))
    return tau, add(force, forces[0][0]), add(moment, forces[0][1])


def inverse_dynamics(
    arm: SerialChain,
    q: npt.ArrayLike,
    v: npt.ArrayLike,
    a: npt.ArrayLike,
    gravity: tuple[float, float, float] = ZERO,
) -> tuple[Array, Array]:
    """Torque and base wrench of a motion on a base that stands still (Newton-Euler).

    Args:
        q, v, a: (..., n) joint angles [rad], rates [rad/s], accelerations [rad/s^2].
        gravity: acceleration of free fall in the platform frame [m/s^2].

    Returns:
        tau (..., n) [N m], rotors included, and the wrench (..., 6) [N, N m] that the arm
        exerts on the base at the platform-top origin.
    """
    angles = _columns(arm, q)
    rates, accelerations = _columns(arm, v, "v"), _columns(arm, a, "a")
    lift: Vec = (-gravity[0], -gravity[1], -gravity[2])
    torques, force, moment = newton_euler(arm, angles, rates, accelerations, accel=lift)
    shape = np.broadcast_shapes(angles[0].shape, rates[0].shape, accelerations[0].shape)
    tau, wrench = np.empty((*shape, arm.n)), np.empty((*shape, 6))
    for i, value in enumerate(torques):
        tau[..., i] = value
    for k, value in enumerate((*force, *moment)):  # reaction
        wrench[..., k] = -value if not _is_zero(value) else 0.0
    return tau, wrench


def _is_zero(s: Scalar) -> bool:
    return isinstance(s, float) and s == 0.0
