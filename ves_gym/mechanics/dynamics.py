"""Rigid-body dynamics of the arm on its base, batch first: plain NumPy.

The same text runs on numbers and is traced into graphs (`engine.kernel.symbolic`), where an
exact 0 or 1 of the DH table leaves no instruction. Sums go element by element, so that a
configuration's numbers do not depend on how many others there are.

Frame: the platform-top frame; wrench and twist at its origin, linear part first.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array
from ves_gym.mechanics.arm import Arm, Mechanism
from ves_gym.mechanics.arm_arrays import Root, spans
from ves_gym.mechanics.kinematics import frames, joint_values, outwards, twists
from ves_gym.mechanics.spatial import base_motion, cross, room

# Spatial inertia (6, 6) by places in (0, m, h, -h, second moments), h the first moment
_SPATIAL = [
    [1, 0, 0, 0, 4, 6],
    [0, 1, 0, 7, 0, 2],
    [0, 0, 1, 3, 5, 0],
    [0, 7, 3, 8, 11, 13],
    [4, 0, 5, 11, 9, 12],
    [6, 2, 0, 13, 12, 10],
]
# Joints of some configurations at a time: what lies between stays in the cache, and its arrays
# below the size from which the system hands out pages of memory one by one (128 KiB)
_CHUNK = 3600
_NONE = np.zeros(3)


# --------------------------------------------------------------------- rigid bodies
# Symmetric matrices are packed as xx, yy, zz, xy, yz, xz


def packed(matrix: Array) -> Array:
    """Symmetric matrices (..., 3, 3) as (..., 6)."""
    return matrix[..., [0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]]


def _products(a: Array, b: Array) -> Array:
    """a_i b_j (..., 6) of vectors (..., 3)."""
    out = room(a, *a.shape[:-1], 6)
    np.multiply(a, b, out=out[..., :3])
    np.multiply(a[..., :2], b[..., 1:], out=out[..., 3:5])
    np.multiply(a[..., 0], b[..., 2], out=out[..., 5])
    return out


def packed_matvec(matrix: Array, vector: Array) -> Array:
    """Symmetric matrices (..., 6) times vectors (..., 3)."""
    out = matrix[..., :3] * vector
    out[..., :2] += matrix[..., 3:5] * vector[..., 1:]
    out[..., 1:] += matrix[..., 3:5] * vector[..., :2]
    out[..., ::2] += matrix[..., 5, None] * vector[..., ::-2]
    return out


def turned_inertia(rotation: Array, inertia: Array) -> Array:
    """R I R^T (..., 6) of bodies about their centres of mass, I (..., 3, 3) in their own
    axes."""
    diagonal = inertia.dtype != object and not packed(inertia)[..., 3:].any()
    if diagonal:
        half = rotation * packed(inertia)[..., None, :3]
    else:
        half = room(rotation, *rotation.shape)
        for k in range(3):
            half[..., k] = (rotation * inertia[..., None, k, :]).sum(axis=-1)
    x, y, z = (_products(half[..., k], rotation[..., k]) for k in range(3))
    return x + y + z


def moments(mass: Array, com: Array, turned: Array) -> tuple[Array, Array]:
    """First moment (..., 3) and second moments (..., 6) about the origin of bodies of mass
    (...) [kg], centre (..., 3) [m] and `turned_inertia` (..., 6)."""
    first = mass[..., None] * com
    across = _products(first, com)
    second = turned - across
    second[..., :3] += across[..., :3].sum(axis=-1)[..., None]
    return first, second


def spatial_inertia(mass: Array, first: Array, second: Array) -> Array:
    """(..., 6, 6) at the origin, of mass (...) and moments (..., 3), (..., 6)."""
    parts = room(first, *first.shape[:-1], 14)
    parts[..., 1], parts[..., 2:5], parts[..., 5:8] = mass, first, -first
    parts[..., 8:] = second
    return parts[..., _SPATIAL]


def merged(bodies: Sequence[tuple[Any, Any, Any]]) -> tuple[Any, Any, Any]:
    """Mass (...), centre of mass (..., 3) and inertia about it (..., 3, 3) of bodies, each by
    the same in common axes."""
    mass = sum(k[0] for k in bodies)
    com = sum(k[0][..., None] * k[1] for k in bodies) / mass[..., None]
    inertia = 0.0
    for share, centre, moments in bodies:
        r = centre - com
        square = (r * r).sum(axis=-1)[..., None, None] * np.eye(3)
        away = square - r[..., :, None] * r[..., None, :]
        inertia = inertia + moments + share[..., None, None] * away
    return mass, com, inertia


def swing(w: Array, dw: Array, arm: Array) -> Array:
    """Acceleration of a point relative to another of the same body."""
    return cross(dw, arm) + cross(w, cross(w, arm))


def body_loads(
    mass: Array, com: Array, turned: Array, w: Array, dw: Array, accel: Array
) -> tuple[Array, Array]:
    """Force and moment about the origin (..., 3) that bodies' motions take.

    Of mass (...) [kg], centre of mass (..., 3) [m] and `turned_inertia` (..., 6), under angular
    velocity w and acceleration dw and the centre's acceleration (..., 3).
    """
    force = mass[..., None] * accel
    spun = packed_matvec(turned, dw) + cross(w, packed_matvec(turned, w))
    return force, spun + cross(com, force)


def _from_the_tips(roots: Sequence[Root], x: Array) -> Array:
    """Add to each joint's row of x (..., n, k) those beyond it, in place."""
    n = x.shape[-2]
    for root, span in zip(roots, spans(roots, n), strict=True):
        for i in reversed(range(span.start, span.stop - 1)):
            x[..., i, :] += x[..., i + 1, :]
        if root.on is not None:
            x[..., root.on, :] += x[..., root.first, :]
    return x


def _from_the_base(roots: Sequence[Root], starts: Sequence[Array], x: Array) -> Array:
    """(..., n + r, 3): of each arm its start (..., 3), then its rows of x (..., n, 3) added in
    turn; the start of what follows beside an arm is added to its carrier's."""
    batch, n = np.broadcast_shapes(*(k.shape[:-1] for k in starts), x.shape[:-2]), x.shape[-2]
    out = room(x, *batch, n + len(roots), 3)
    beyond = [i + k + 1 for k, span in enumerate(spans(roots, n)) for i in range(n)[span]]
    begins = {root.first: (root, start) for root, start in zip(roots, starts, strict=True)}
    for i in outwards(roots, n):
        if i in begins:
            root, start = begins[i]
            start = start if root.on is None else out[..., beyond[root.on], :] + start
            out[..., beyond[i] - 1, :] = start
        np.add(out[..., beyond[i] - 1, :], x[..., i, :], out=out[..., beyond[i], :])
    return out


def _starts(roots: Sequence[Root], base: Array) -> list[Array]:
    """Return the initial value (..., 3) of each arm: the base's, or zero on a carrier."""
    return [base if root.on is None else _NONE for root in roots]


def _of_all(roots: Sequence[Root], x: Array) -> Array:
    """Sum over the arms of what their first joints' rows of x (..., n, k) have: (..., k)."""
    first, *others = (root.first for root in roots if root.on is None)
    out = x[..., first, :]
    for k in others:
        out = out + x[..., k, :]
    return out


def _carriers(roots: Sequence[Root], n: int, i: int) -> list[int]:
    """Joints from the base to joint i of n."""
    for root, span in zip(roots, spans(roots, n), strict=True):
        if span.start <= i < span.stop:
            before = [] if root.on is None else _carriers(roots, n, root.on)
            return [*before, *range(span.start, i + 1)]
    return []


# ------------------------------------------------------------------- inertia matrix


class InertiaParts(NamedTuple):
    """The inertia matrix by its parts."""

    base: Array  # (..., 6, 6) spatial inertia of all bodies at the origin
    across: Array  # (..., n, 6) momentum of all bodies per unit joint rate
    joints: Array  # (..., n, n) rotors included


class Composites(NamedTuple):
    """Bodies that move as one with each joint, and the whole: moments about the origin."""

    mass: Array  # (..., n) of all beyond a joint [kg]
    first: Array  # (..., n, 3) [kg m]
    second: Array  # (..., n, 6) [kg m^2]
    total: tuple[Array, Array, Array]  # the same of all bodies, the base link's among them
    moving: Array  # (..., n, 3) velocity per rate, of the origin as a point of what moves
    turning: Array  # (..., n, 3) angular velocity per rate


def composites(arm: Mechanism, q: npt.ArrayLike) -> Composites:
    """Return what each joint moves, at joint angles q (..., n) [rad]."""
    at, bodies, roots = frames(arm, q), arm.bodies, arm.roots
    rotation = at.rotation
    com = at.position + (rotation * bodies.com[..., 1:, None, :]).sum(axis=-1)
    turned = turned_inertia(rotation, bodies.inertia[..., 1:, :, :])
    first, second = (
        _from_the_tips(roots, x) for x in moments(bodies.mass[..., 1:], com, turned)
    )
    mass = _from_the_tips(roots, bodies.mass[..., 1:, None].copy())[..., 0]
    base = moments(
        bodies.mass[..., 0], bodies.com[..., 0, :], packed(bodies.inertia[..., 0, :, :])
    )
    total = (
        _of_all(roots, mass[..., None])[..., 0] + bodies.mass[..., 0],
        _of_all(roots, first) + base[0],
        _of_all(roots, second) + base[1],
    )
    return Composites(mass, first, second, total, *twists(arm, at))


def inertia_parts(arm: Mechanism, q: npt.ArrayLike) -> InertiaParts:
    """Return the parts of `inertia`, at joint angles q (..., n) [rad]."""
    bodies, n, roots = arm.bodies, len(arm.joints), arm.roots
    mass, first, second, total, moving, turning = composites(arm, q)
    # unit rate of a joint: linear and angular momentum (about the origin) of what it moves
    across = room(first, *first.shape[:-1], 6)
    linear, angular = across[..., :3], across[..., 3:]
    np.add(mass[..., None] * moving, cross(turning, first), out=linear)
    np.add(cross(first, moving), packed_matvec(second, turning), out=angular)
    pairs = (moving[..., :, None, :] * linear[..., None, :, :]).sum(axis=-1)
    pairs += (turning[..., :, None, :] * angular[..., None, :, :]).sum(axis=-1)
    joints = np.where(np.tri(n, dtype=bool), np.swapaxes(pairs, -1, -2), pairs)
    for span in spans(roots, n)[: len(roots) - 1]:  # arms meet in the base alone
        joints[..., span, span.stop :] = joints[..., span.stop :, span] = 0.0
    for root in roots:
        if root.on is not None:
            i, up = root.first, _carriers(roots, n, root.on)
            joints[..., i, up] = joints[..., up, i] = pairs[..., up, i]
    joints[..., range(n), range(n)] += bodies.rotor
    if arm.coupling is not None:  # G^T M G, for the joints' rates are G of the driven ones'
        across, half = arm.coupling.reduced(across), arm.coupling.reduced(joints)
        joints = arm.coupling.reduced(np.swapaxes(half, -1, -2))
    return InertiaParts(spatial_inertia(*total), across, joints)


def inertia(arm: Arm, q: npt.ArrayLike) -> Array:
    """Inertia matrix of the arm and its base link, base at the origin, at joint angles q (...,
    n) [rad].

    (..., 6 + n, 6 + n): [[H_b, H_bm], [H_bm^T, H_m]] for the base twist (linear part first,
    platform-top frame) and the joint rates; rotors included in H_m.
    """
    angles, size = joint_values(arm, q), 6 + arm.n
    out = np.empty((*angles.shape[:-1], size, size))

    def part(angles: Array, H: Array) -> None:
        base, across, joints = inertia_parts(arm, angles)
        H[:, :6, :6], H[:, 6:, :6], H[:, 6:, 6:] = base, across, joints
        H[:, :6, 6:] = np.swapaxes(across, -1, -2)

    _in_chunks(part, angles.reshape(-1, arm.n), out.reshape(-1, size, size))
    return out


def _in_chunks(function: Callable[..., None], *arrays: Array) -> None:
    """Call a function with some rows of arrays after others."""
    size = _CHUNK // arrays[0].shape[-1]
    for k in range(0, len(arrays[0]), size):
        function(*(x[k : k + size] for x in arrays))


def drawn_configurations(arm: Arm) -> Array:
    """(257, n) zero, or what is nearest to it, and angles drawn within the limits [rad]."""
    low, high = arm.column("q_min"), arm.column("q_max")
    drawn = low + (high - low) * np.random.default_rng(0).uniform(size=(256, arm.n))
    return np.vstack([np.clip(0.0, low, high), drawn])


# ------------------------------------------------------------------ inverse dynamics


def newton_euler(
    arm: Mechanism,
    q: Array,
    v: Array,
    a: Array,
    *,
    spin: Array = _NONE,
    turn: Array = _NONE,
    accel: Array = _NONE,
) -> tuple[Array, Array]:
    """Torques of a motion, and the wrench that moves the whole arm with its base link.

    Args:
        q, v, a: (..., n) joint angles [rad], rates [rad/s], accelerations [rad/s^2].
        spin, turn: (..., 3) angular velocity and acceleration of the base, platform axes.
        accel: (..., 3) acceleration of its origin less that of free fall, platform axes.

    Returns:
        tau (..., n) [N m], rotors included, and the wrench (..., 6) [N, N m] on the base link
        at the platform-top origin, platform axes. What the arm exerts is its negative.
    """
    at, bodies, roots = frames(arm, q), arm.bodies, arm.roots
    if arm.coupling is not None:
        v, a = arm.coupling.full(v), arm.coupling.full(a)
    rotation, slides = at.rotation, [joint.slides for joint in arm.joints]
    rates, pushes = v[..., None] * at.axis, a[..., None] * at.axis
    turns = np.array([[float(not k)] for k in slides]) if any(slides) else 1.0
    # angular velocities and accelerations, of the base and of each link
    spins = _from_the_base(roots, _starts(roots, spin), turns * rates)
    w, gyration = spins[..., at.links, :], cross(spins[..., at.joints, :], rates)
    turned = _from_the_base(roots, _starts(roots, turn), turns * (pushes + gyration))
    dw = turned[..., at.links, :]
    # acceleration of where the joint is, as its link moves
    gain = swing(w, dw, at.ways)
    slid = (1.0 - turns) * (pushes + 2.0 * gyration) if any(slides) else 0.0
    feet = [
        accel + swing(spin, turn, root.position)
        if root.on is None
        else swing(
            w[..., root.on, :],
            dw[..., root.on, :],
            (rotation[..., root.on, :, :] * root.position).sum(axis=-1),
        )
        for root in roots
    ]
    places = _from_the_base(roots, feet, gain + slid)
    # forces and moments about the origin, of each body, then of all from it outwards
    reach = at.ways + (rotation * bodies.com[..., 1:, None, :]).sum(axis=-1)
    turned = turned_inertia(rotation, bodies.inertia[..., 1:, :, :])
    moved = places[..., at.joints, :] + slid + swing(w, dw, reach)
    com = at.origin + reach
    loads = body_loads(bodies.mass[..., 1:], com, turned, w, dw, moved)
    force, moment = (_from_the_tips(roots, x) for x in loads)
    moving, turning = twists(arm, at)
    tau = (moving * force).sum(axis=-1) + (turning * moment).sum(axis=-1) + bodies.rotor * a
    if arm.coupling is not None:
        tau = arm.coupling.reduced(tau[..., None])[..., 0]
    com, base_turned = bodies.com[..., 0, :], packed(bodies.inertia[..., 0, :, :])
    moved = accel + swing(spin, turn, com)
    base = body_loads(bodies.mass[..., 0], com, base_turned, spin, turn, moved)
    wrench = room(force, *force.shape[:-2], 6)
    wrench[..., :3], wrench[..., 3:] = (
        _of_all(roots, x) + part for x, part in zip((force, moment), base, strict=True)
    )
    return tau, wrench


def inverse_dynamics(
    arm: Arm,
    q: npt.ArrayLike,
    v: npt.ArrayLike,
    a: npt.ArrayLike,
    gravity: npt.ArrayLike = (0.0, 0.0, 0.0),
    *,
    base: Sequence[npt.ArrayLike] = (),
) -> tuple[Array, Array]:
    """Torque and base wrench of a motion (Newton-Euler).

    Args:
        q, v, a: (..., n) joint angles [rad], rates [rad/s], accelerations [rad/s^2].
        gravity: (..., 3) acceleration of free fall in the platform frame [m/s^2].
        base: its pose, rate and acceleration (..., 6); none: it stands still.

    Returns:
        tau (..., n) [N m], rotors included, and the wrench (..., 6) [N, N m] that the arm
        exerts on the base at the platform-top origin.
    """
    motion = np.broadcast_arrays(
        joint_values(arm, q), joint_values(arm, v, "v"), joint_values(arm, a, "a")
    )
    shape, lift = motion[0].shape[:-1], -np.asarray(gravity, float)
    rows = [x.reshape(-1, arm.n) for x in motion]
    moves: dict[str, Array] = {"accel": lift}
    if len(base):
        _, spin, turn, accel = base_motion(*base)
        moves = {"spin": spin, "turn": turn, "accel": lift + accel}
    flat = {k: np.broadcast_to(x, (*shape, 3)).reshape(-1, 3) for k, x in moves.items()}
    tau, wrench = np.empty((*shape, arm.n)), np.empty((*shape, 6))

    def part(q: Array, v: Array, a: Array, tau: Array, wrench: Array, *moved: Array) -> None:
        by = dict(zip(flat, moved, strict=True)) if lift.ndim > 1 or len(base) else moves
        torque, load = newton_euler(arm, *(x.copy("F") for x in (q, v, a)), **by)
        tau[:], wrench[:] = torque, -load

    _in_chunks(part, *rows, tau.reshape(-1, arm.n), wrench.reshape(-1, 6), *flat.values())
    return tau, wrench
