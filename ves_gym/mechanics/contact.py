"""Contact at the tool: shapes that meet, and the spring, damper and friction between them.

At every contact point, with the overlap d, its rate d' and the slip v across the normal,

    f = max(0, k d + c d'),    f_t = -min(c_t, mu f / |v|) v

a linear spring and damper that never pulls, and Coulomb friction over a tangential damper (Haff
and Werner, Powder Technology 48, 1986). It is a force of the state alone. docs/physics.md,
section 17.

Plain NumPy, batch first, traced into the equations of motion.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

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
from ves_gym.mechanics.arm_arrays import Chain
from ves_gym.mechanics.attitude import product, to_matrix
from ves_gym.mechanics.kinematics import frames, tool_motions
from ves_gym.mechanics.link import Mount
from ves_gym.mechanics.spatial import cross, matvec, rate_matrix, rotation, solve_symmetric

FORMS = {"sphere": 1, "capsule": 2, "box": 3, "cone": 3}  # numbers of its size
CARRIERS = ("payload", "base", "space")
FLOATING = 7  # coordinates of a payload that is touched: centre of mass, quaternion
_LEAST = 1e-12  # m, m/s: no direction below it


@dataclass(frozen=True, kw_only=True)
class ContactShape:
    """A body's surface, or a part of it.

    `size` of a sphere: its radius; of a capsule: radius and length (of the straight part) along
    its z; of a box: its edges; of a cone, the side of a funnel or tube around z, open at both
    ends: radii where it begins (low z) and ends, and length.
    """

    form: str
    size: Vector = unit("m")
    place: Mount = Mount()  # noqa: RUF009  # of its centre and axes in those of the body

    def __post_init__(self) -> None:
        freeze_arrays(self)
        require_choice(self, "form", tuple(FORMS))
        numbers = finite(self.size, (FORMS[self.form],), f"ContactShape.size of a {self.form}")
        if not (numbers > 0).all():
            raise ParameterError(f"ContactShape.size must be > 0 m, got {self.size}")

    @property
    def lever(self) -> float:
        """Distance of a point on it from the body's origin, at most [m]."""
        size = np.array(self.size)
        around = {
            "sphere": size[0],
            "capsule": size[0] + size[-1] / 2,
            "box": np.linalg.norm(size) / 2,
            "cone": math.hypot(size[:2].max(), size[-1] / 2),
        }[self.form]
        return float(np.linalg.norm(self.place.position) + around)


@dataclass(frozen=True, kw_only=True)
class Contact:
    """Shapes at the tool, shapes that they meet, and the law of the force between them.

    `on` says what the other shapes are fixed to: the system's payload, which floats freely
    until a latch closes; the base (platform axes); or space (inertial axes). Each contact
    point is a spring of its own: a sphere in a cone has two, at the wall near it and at the
    one across. Of two shapes that meet one is a sphere, or both are capsules.
    """

    tool: tuple[ContactShape, ...]  # in the tool's frame
    target: tuple[ContactShape, ...]
    on: str = "payload"
    stiffness: float = unit("N/m")
    damping: float = unit("N s/m", default=0.0)
    friction: float = unit("1", default=0.0)
    tangential_damping: float = unit("N s/m", default=0.0)

    def __post_init__(self) -> None:
        freeze_arrays(self)
        require_choice(self, "on", CARRIERS)
        require_positive(self, "stiffness")
        require_positive(self, "damping", "friction", "tangential_damping", zero=True)
        if bool(self.friction) != bool(self.tangential_damping):
            raise ParameterError(
                "Contact.friction and tangential_damping must be > 0 together, got"
                f" {self.friction:g} and {self.tangential_damping:g} N s/m"
            )
        for name in ("tool", "target"):
            shapes = getattr(self, name)
            if not shapes or not all(isinstance(k, ContactShape) for k in shapes):
                raise ParameterError(
                    f"Contact.{name} must be one shape (ContactShape) or more, got {shapes!r}"
                )
        for a in self.tool:
            for b in self.target:
                if not _supported(a.form, b.form):
                    raise ParameterError(
                        f"Contact has no law for a {a.form} that meets a {b.form}: one of two"
                        " shapes must be a sphere, or both capsules"
                    )

    @property
    def points(self) -> int:
        """Contact points at once: of each shape of the tool, with one of the others."""
        flares = any(k.form == "cone" for k in (*self.tool, *self.target))
        return (1 + flares) * len(self.tool)


def _supported(a: str, b: str) -> bool:
    return "sphere" in (a, b) or (a, b) == ("capsule", "capsule")


# --------------------------------------------------------------------------- distances


class Touch(NamedTuple):
    """Nearest points of two shapes, in the target's axes."""

    gap: Array  # (...,) m, negative where they overlap
    normal: Array  # (..., 3) out of the target's shape, on the tool's
    place: Array  # (..., 3) in the middle of gap or overlap [m]


def touches(contact: Contact, place: Array, turn: Array) -> Iterator[Touch]:
    """Yield every point where shapes may touch, the tool at a place (..., 3) and turn (..., 3,
    3) in the target's axes."""
    origin, identity = np.zeros(3), np.eye(3)
    for a in contact.tool:
        for b in contact.target:
            if a.form == "sphere":
                yield from _of_sphere(a, (place, turn), b, (origin, identity), 1.0)
            elif b.form == "sphere":
                yield from _of_sphere(b, (origin, identity), a, (place, turn), -1.0)
            else:
                yield _of_capsules(a, (place, turn), b)


Pose = tuple[Array, Array]  # origin and axes of a body, in the target's


def _at(shape: ContactShape, body: Pose) -> Pose:
    """Centre and axes of a shape."""
    place, turn = body
    return place + turn @ np.array(shape.place.position), turn @ shape.place.rotation


def _of_sphere(
    ball: ContactShape, mine: Pose, other: ContactShape, theirs: Pose, sign: float
) -> Iterator[Touch]:
    centre, (origin, axes), radius = _at(ball, mine)[0], _at(other, theirs), ball.size[0]
    local = matvec(np.swapaxes(axes, -1, -2), centre - origin)
    for distance, outward in _distances(other, local):
        normal, gap = matvec(axes, outward), distance - radius
        yield Touch(gap, sign * normal, centre - (radius + gap / 2)[..., None] * normal)


def _of_capsules(a: ContactShape, mine: Pose, b: ContactShape) -> Touch:
    (centre, turn), (origin, axes) = _at(a, mine), _at(b, (np.zeros(3), np.eye(3)))
    back = np.swapaxes(axes, -1, -2)
    c, u = matvec(back, centre - origin), (back @ turn)[..., 2]
    along, cosine = (c * u).sum(axis=-1), u[..., 2]
    first, second = a.size[1] / 2, b.size[1] / 2
    # the nearest points of two segments c + s u and t z; parallel ones meet in the middle
    square = np.maximum(1.0 - cosine * cosine, 1e-9)
    s = np.clip((cosine * c[..., 2] - along) / square, -first, first)
    t = np.clip(c[..., 2] + s * cosine, -second, second)
    s = np.clip(t * cosine - along, -first, first)
    point = c + s[..., None] * u
    away = np.stack([point[..., 0], point[..., 1], point[..., 2] - t], axis=-1)
    distance, outward = _length(away)
    normal, gap = matvec(axes, outward), distance - a.size[0] - b.size[0]
    inner = (a.size[0] + gap / 2)[..., None]
    return Touch(gap, normal, origin + matvec(axes, point) - inner * normal)


def _length(vector: Array) -> tuple[Array, Array]:
    """Length (...,) and direction (..., 3)."""
    size = np.sqrt((vector * vector).sum(axis=-1))
    return size, vector / np.maximum(size, _LEAST)[..., None]


def _distances(shape: ContactShape, c: Array) -> list[tuple[Array, Array]]:
    """Distances [m] of points c (..., 3) from a shape in its own axes, and ways out of it."""
    size = np.array(shape.size)
    if shape.form == "box":
        return [_from_box(size / 2, c)]
    if shape.form == "cone":
        return _from_cone(size, c)
    if shape.form == "capsule":
        beyond = c[..., 2] - np.clip(c[..., 2], -size[1] / 2, size[1] / 2)
        c = np.stack([c[..., 0], c[..., 1], beyond], axis=-1)
    distance, outward = _length(c)
    return [(distance - size[0], outward)]


def _from_box(half: Array, c: Array) -> tuple[Array, Array]:
    beyond, side = np.abs(c) - half, np.where(c < 0.0, -1.0, 1.0)
    outside, outward = _length(np.maximum(beyond, 0.0))
    face = np.maximum(np.maximum(beyond[..., 0], beyond[..., 1]), beyond[..., 2])
    # a centre inside leaves by the nearest face
    _, inward = _length(np.where(beyond >= face[..., None], 1.0, 0.0))
    normal = np.where((outside > 0.0)[..., None], outward, inward)
    return outside + np.minimum(face, 0.0), side * normal


def _from_cone(size: Array, c: Array) -> list[tuple[Array, Array]]:
    """The wall beside the point, then the one across the axis, in the plane of both."""
    low, high, length = size
    across = np.sqrt(c[..., 0] * c[..., 0] + c[..., 1] * c[..., 1])
    radial = [c[..., k] / np.maximum(across, _LEAST) for k in (0, 1)]
    slope, square = high - low, (high - low) ** 2 + length**2
    height, out = c[..., 2] + length / 2, []
    for r in (across, -across):
        share = np.clip(((r - low) * slope + height * length) / square, 0.0, 1.0)
        away_r, away_z = r - low - share * slope, height - share * length
        distance = np.sqrt(away_r * away_r + away_z * away_z)
        inverse = 1.0 / np.maximum(distance, _LEAST)
        outward = (away_r if r is across else -away_r) * inverse
        normal = [outward * radial[0], outward * radial[1], away_z * inverse]
        out.append((distance, np.stack(normal, axis=-1)))
    return out


# -------------------------------------------------------------------------------- law


class Law(NamedTuple):
    """Numbers of the law."""

    stiffness: Array  # () N/m
    damping: Array  # () N s/m
    friction: Array  # ()
    tangential: Array  # () N s/m


def contact_wrench(
    contact: Contact, law: Law, place: Array, turn: Array, motion: Array
) -> tuple[Array, Array]:
    """Return the wrench on the tool (..., 6), about it, and what the springs store (...,) [J].

    Place (..., 3), turn (..., 3, 3) and twist (..., 6) of the tool against the target, at the
    tool, are in the target's axes.
    """
    force, moment, energy = 0.0 * place, 0.0 * place, 0.0 * place[..., 0]
    for gap, normal, at in touches(contact, place, turn):
        lever, depth = at - place, np.maximum(-gap, 0.0)
        velocity = motion[..., :3] + cross(motion[..., 3:], lever)
        opening = (velocity * normal).sum(axis=-1)
        push = np.maximum(law.stiffness * depth - law.damping * opening, 0.0)
        push = np.where(depth > 0.0, push, 0.0)
        push_at = push[..., None] * normal
        if contact.friction:
            slip = velocity - opening[..., None] * normal
            speed = np.maximum(np.sqrt((slip * slip).sum(axis=-1)), _LEAST)
            drag = np.minimum(law.tangential, law.friction * push / speed)
            push_at = push_at - drag[..., None] * slip
        force, moment = force + push_at, moment + cross(lever, push_at)
        energy = energy + 0.5 * law.stiffness * depth * depth
    return np.concatenate([force, moment], axis=-1), energy


# ------------------------------------------------------------------------ in a system


@dataclass(frozen=True)
class ContactModel:
    """A system's contact as numbers, or symbols."""

    contact: Contact
    law: Law
    tool: Array  # (3, 3) from the tool's axes to the last link's
    frame: Pose | None  # of what is fixed in space
    body: tuple[Array, Array, Array] | None  # mass, centre of mass, inertia of what floats
    touching: Array | float  # 0: shapes pass through each other

    @property
    def floating(self) -> int:
        """Coordinates of the payload."""
        return 0 if self.body is None else FLOATING


class ContactLoad(NamedTuple):
    """Load of a contact."""

    base: Array  # (..., 6) generalised force on Y
    joints: Array  # (..., joints of the chain)
    floating: Array  # (..., 7) second derivatives of the payload's coordinates
    wrench: Array  # (..., 6) on the tool, about it, inertial axes
    energy: Array  # (...,) in its springs [J]


def contact_load(
    model: ContactModel, chain: Chain, z: Array, zd: Array, b: Array, bd: Array
) -> ContactLoad:
    """Return what contact does to arm, base and payload.

    Of state and rate (..., 6 + joints of the chain, those of its springs too), and of the
    payload's centre of mass and quaternion and their rates (..., 7), or (..., 0).
    """
    at, T, R = frames(chain, z[..., 6:]), rate_matrix(z[..., :6]), rotation(z[..., :6])
    along = tool_motions(chain, at)
    tool = at.position[..., -1, :], at.rotation[..., -1, :, :] @ model.tool
    motion = (zd[..., 6:, None] * along).sum(axis=-2)
    if model.contact.on == "base":
        wrench, energy = contact_wrench(model.contact, model.law, *tool, motion)
        load, floating = wrench, b
    else:
        base = matvec(T, zd[..., :6])
        motion = motion + base
        motion[..., :3] += cross(base[..., 3:], tool[0])
        target = _target(model, b, bd)
        to_target = np.swapaxes(target.turn, -1, -2) @ R
        relative = _relative_motion(target, z[..., :3], R, tool, motion)
        wrench, energy = contact_wrench(model.contact, model.law, *relative)
        wrench, energy = model.touching * wrench, model.touching * energy
        load = _turned(np.swapaxes(to_target, -1, -2), wrench)
        floating = b if model.body is None else _floating(model, b, bd, relative[0], wrench)
    moment = load[..., 3:] + cross(tool[0], load[..., :3])
    at_base = np.concatenate([load[..., :3], moment], axis=-1)
    push = matvec(np.swapaxes(T, -1, -2), at_base)
    return ContactLoad(push, matvec(along, load), floating, _turned(R, load), energy)


def _turned(turn: Array, vectors: Array) -> Array:
    """(..., 6) two vectors in other axes."""
    parts = [matvec(turn, vectors[..., :3]), matvec(turn, vectors[..., 3:])]
    return np.concatenate(parts, axis=-1)


class _Target(NamedTuple):
    """A body that is touched, in space."""

    place: Array  # (..., 3) of its origin [m]
    turn: Array  # (..., 3, 3) from its own axes
    velocity: Array  # (..., 3) of the origin [m/s]
    spin: Array  # (..., 3) in its own axes [rad/s]


def _target(model: ContactModel, b: Array, bd: Array) -> _Target:
    if model.body is None:
        assert model.frame is not None
        return _Target(*model.frame, np.zeros(3), np.zeros(3))
    _, com, _ = model.body
    q, spin = payload_attitude(b, bd)
    turn = to_matrix(q)
    away = matvec(turn, com), matvec(turn, cross(spin, com))
    return _Target(b[..., :3] - away[0], turn, bd[..., :3] - away[1], spin)


def _relative_motion(
    target: _Target, y: Array, R: Array, tool: Pose, motion: Array
) -> tuple[Array, Array, Array]:
    """Pose and twist of the tool, given in the base's axes, against a target in space, in its
    axes; y (..., 3) and R (..., 3, 3) are the base's pose."""
    back = np.swapaxes(target.turn, -1, -2)
    turn, (place, axes) = back @ R, tool
    relative = matvec(back, y + matvec(R, place) - target.place)
    against = _turned(turn, motion)
    against[..., :3] -= matvec(back, target.velocity) + cross(target.spin, relative)
    against[..., 3:] -= target.spin
    return relative, turn @ axes, against


def payload_attitude(b: Array, bd: Array) -> tuple[Array, Array]:
    """Return a payload's unit quaternion and its spin in own axes, from its coordinates."""
    p, square = b[..., 3:], (b[..., 3:] * b[..., 3:]).sum(axis=-1)
    inverse = 1.0 / np.maximum(square, _LEAST)
    back = p * np.array([1.0, -1.0, -1.0, -1.0])
    spin = 2.0 * inverse[..., None] * product(back, bd[..., 3:])[..., 1:]
    return p * np.sqrt(inverse)[..., None], spin


def payload_coordinates(bodies: Array, com: Array) -> tuple[Array, Array]:
    """Return the coordinates (..., 7) of payloads and their rates, of rows (..., 13) of
    `latch.BODY` and centres of mass (..., 3) in own axes [m]."""
    place, q, velocity, spin = np.split(bodies, [3, 7, 10], axis=-1)
    rate = 0.5 * product(q, np.concatenate([0.0 * spin[..., :1], spin], axis=-1))
    centre = place + matvec(to_matrix(q), com)
    return np.concatenate([centre, q], axis=-1), np.concatenate([velocity, rate], axis=-1)


def payload_of(b: Array, bd: Array, com: Array) -> Array:
    """Return payloads as rows of `latch.BODY` (..., 13) from their coordinates and rates (...,
    7)."""
    q, spin = payload_attitude(b, bd)
    origin = b[..., :3] - matvec(to_matrix(q), com)
    return np.concatenate([origin, q, bd[..., :3], spin], axis=-1)


def _floating(model: ContactModel, b: Array, bd: Array, point: Array, wrench: Array) -> Array:
    """(..., 7) accelerations of a payload, which feels the opposite of the tool's wrench."""
    assert model.body is not None
    mass, com, inertia = model.body
    (q, spin), force = payload_attitude(b, bd), wrench[..., :3]
    moment = -wrench[..., 3:] - cross(point - com, force) - cross(spin, matvec(inertia, spin))
    J = inertia + 0.0 * moment[..., None]  # one for each simulation
    turn = solve_symmetric(J, moment[..., None])[..., 0]
    none = 0.0 * spin[..., :1]
    bent = product(bd[..., 3:], np.concatenate([none, spin], axis=-1))
    pushed = product(b[..., 3:], np.concatenate([none, turn], axis=-1))
    linear = -matvec(to_matrix(q), force) / mass
    return np.concatenate([linear, 0.5 * (bent + pushed)], axis=-1)
