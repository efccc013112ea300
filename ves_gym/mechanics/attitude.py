"""Attitude as a unit quaternion, with the torque-free motion of a rigid body.

A quaternion is (w, x, y, z), scalar first, Hamilton's product (i j = k). It turns vectors from
the body's axes to the inertial ones: v_inertial = q v q*. So attitudes chain from left to
right, q_AC = q_AB q_BC; the angular velocity w is in the body's axes; and q' = 1/2 q (0, w).
q and -q are one attitude; results of `log`, `from_matrix` and `from_angles` have w >= 0.

Leading axes are batches. Angles phi = (phi_x, phi_y, phi_z) are those of `spatial`.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array
from ves_gym.mechanics.spatial import cross, matvec, numbers, rotation

IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])
_SMALL = 1e-4  # rad: below it two terms of a sine's series are exact to rounding


def product(p: npt.ArrayLike, q: npt.ArrayLike) -> Array:
    """Return Hamilton's product p q (..., 4): the attitude q, in the frame in which p is given
    from."""
    a, b = numbers(p), numbers(q)
    pw, px, py, pz = (a[..., k] for k in range(4))
    qw, qx, qy, qz = (b[..., k] for k in range(4))
    return np.stack(
        [
            pw * qw - px * qx - py * qy - pz * qz,
            pw * qx + px * qw + py * qz - pz * qy,
            pw * qy - px * qz + py * qw + pz * qx,
            pw * qz + px * qy - py * qx + pz * qw,
        ],
        axis=-1,
    )


def conjugate(q: npt.ArrayLike) -> Array:
    """Return the inverse of a unit quaternion, inertial axes to body axes (..., 4)."""
    out: Array = numbers(q) * np.array([1.0, -1.0, -1.0, -1.0])
    return out


def normalised(q: npt.ArrayLike) -> Array:
    """Return the quaternion of unit length that points the same way (..., 4)."""
    value = numbers(q)
    out: Array = value / np.sqrt(np.sum(value * value, axis=-1, keepdims=True))
    return out


def to_matrix(q: npt.ArrayLike) -> Array:
    """(..., 4) unit quaternion -> (..., 3, 3) rotation, body axes to inertial axes."""
    value = numbers(q)
    w, x, y, z = (value[..., k] for k in range(4))
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    out = np.empty_like(value, shape=(*value.shape[:-1], 3, 3))
    for i, row in enumerate(rows):
        for j, entry in enumerate(row):
            out[..., i, j] = entry
    return out


def from_matrix(matrix: npt.ArrayLike) -> Array:
    """(..., 3, 3) rotation -> (..., 4) unit quaternion with w >= 0 (Shepperd's way).

    The matrix gives 4 q q^T; of its columns, all along q, the one with the largest diagonal
    entry is exact at every angle.
    """
    R = numbers(matrix)
    x, y, z = (R[..., i, j] - R[..., j, i] for i, j in ((2, 1), (0, 2), (1, 0)))
    yz, zx, xy = (R[..., i, j] + R[..., j, i] for i, j in ((2, 1), (0, 2), (1, 0)))
    a, b, c = (R[..., k, k] for k in range(3))
    columns = (
        (1 + a + b + c, x, y, z),
        (x, 1 + a - b - c, xy, zx),
        (y, xy, 1 - a + b - c, yz),
        (z, zx, yz, 1 - a - b + c),
    )
    most, out = columns[0][0], np.stack(columns[0], axis=-1)
    for k in range(1, 4):
        better = columns[k][k] > most
        most = np.where(better, columns[k][k], most)
        out = np.where(better[..., None], np.stack(columns[k], axis=-1), out)
    return _positive(normalised(out))


def rotate(q: npt.ArrayLike, vector: npt.ArrayLike) -> Array:
    """Return a vector (..., 3) of body axes of attitude q in inertial axes."""
    return matvec(to_matrix(q), numbers(vector))


def exp(turn: npt.ArrayLike) -> Array:
    """(..., 3) rotation vector, axis times angle [rad] -> (..., 4) unit quaternion."""
    value = numbers(turn)
    angle = np.sqrt(np.sum(value * value, axis=-1, keepdims=True))
    small = angle < _SMALL
    safe = np.where(small, 1.0, angle)
    share = np.where(small, 0.5 - angle**2 / 48, np.sin(safe / 2) / safe)
    return np.concatenate([np.cos(angle / 2), share * value], axis=-1)


def log(q: npt.ArrayLike) -> Array:
    """(..., 4) unit quaternion -> (..., 3) shortest rotation vector [rad], angle <= pi."""
    value = _positive(numbers(q))
    w, vector = value[..., :1], value[..., 1:]
    sine = np.sqrt(np.sum(vector * vector, axis=-1, keepdims=True))
    small = sine < _SMALL / 2
    safe = np.where(small, 1.0, sine)
    share = np.where(small, 2 + sine**2 / 3, 2 * np.arctan2(sine, w) / safe)
    out: Array = share * vector
    return out


def difference(target: npt.ArrayLike, q: npt.ArrayLike) -> Array:
    """Return the rotation vector (..., 3) [rad], in the body's axes, that turns an attitude
    into another the shorter way: target = q exp(difference)."""
    return log(product(conjugate(q), target))


def from_angles(phi: npt.ArrayLike) -> Array:
    """(..., 3) Z-Y-X angles (phi_x, phi_y, phi_z) [rad] -> (..., 4) unit quaternion."""
    angles = np.asarray(phi, float)
    return from_matrix(rotation(np.concatenate([np.zeros_like(angles), angles], axis=-1)))


def to_angles(q: npt.ArrayLike) -> Array:
    """(..., 4) unit quaternion -> (..., 3) Z-Y-X angles [rad], phi_y within +-pi/2.

    At phi_y = +-pi/2 only one of phi_x and phi_z is determined: the other is any.
    """
    R = to_matrix(np.asarray(q, float))
    phi_z = np.arctan2(R[..., 1, 0], R[..., 0, 0])
    s, c = np.sin(phi_z), np.cos(phi_z)  # phi_x from what is left after turning phi_z back
    phi_x = np.arctan2(s * R[..., 0, 2] - c * R[..., 1, 2], c * R[..., 1, 1] - s * R[..., 0, 1])
    phi_y = np.arctan2(-R[..., 2, 0], np.hypot(R[..., 0, 0], R[..., 1, 0]))
    return np.stack([phi_x, phi_y, phi_z], axis=-1)


def angle_rates(phi: npt.ArrayLike, w: npt.ArrayLike) -> Array:
    """Return the rates (..., 3) of Z-Y-X angles phi of a body of angular velocity w in its axes
    [rad/s]; infinite at phi_y = +-pi/2."""
    angles, spin = np.asarray(phi, float), np.asarray(w, float)
    sx, cx = np.sin(angles[..., 0]), np.cos(angles[..., 0])
    about_z = (sx * spin[..., 1] + cx * spin[..., 2]) / np.cos(angles[..., 1])
    about_x = spin[..., 0] + np.sin(angles[..., 1]) * about_z
    return np.stack([about_x, cx * spin[..., 1] - sx * spin[..., 2], about_z], axis=-1)


def torque_free_step(
    q: npt.ArrayLike, w: npt.ArrayLike, inertia: npt.ArrayLike, time: Array | float
) -> tuple[Array, Array]:
    """Advance a rigid body that nothing acts on by one step, fourth order.

    The angular momentum in inertial axes is taken as the constant that it is, so only the
    attitude is integrated (a Runge-Kutta step in rotation vectors, after Munthe-Kaas): the
    momentum stays to rounding and the quaternion stays of unit length.

    Of attitude (..., 4), angular velocity (..., 3) in the body's axes, inertia (..., 3, 3) at
    the centre of mass there, and step [s], one or (..., 1): attitude and angular velocity at
    the end. The error grows as (|w| time)^5.
    """
    start, spin, J = numbers(q), numbers(w), numbers(inertia)
    momentum = matvec(J, spin)  # in the axes at the start, where it stays
    adjugate = np.stack([cross(J[..., k - 2], J[..., k - 1]) for k in range(3)], axis=-2)
    inverse = adjugate / np.sum(J[..., 0] * adjugate[..., 0, :], axis=-1)[..., None, None]

    def spin_at(turn: Array) -> Array:
        back = conjugate(exp(turn))
        about, scalar = back[..., 1:], back[..., :1]
        aside = 2 * cross(about, momentum)
        return matvec(inverse, momentum + scalar * aside + cross(about, aside))

    def slope(turn: Array) -> Array:
        """Rate of the rotation vector: w plus commutators, enough of them for order four."""
        rate = spin_at(turn)
        once = cross(turn, rate)
        return rate + once / 2 + cross(turn, once) / 12

    first = spin
    second = slope(time / 2 * first)
    third = slope(time / 2 * second)
    fourth = slope(time * third)
    turn = time / 6 * (first + 2 * second + 2 * third + fourth)
    return normalised(product(start, exp(turn))), spin_at(turn)


def _positive(q: Array) -> Array:
    """The one of q and -q whose first component is not negative."""
    return np.where(q[..., :1] < 0, -q, q)
