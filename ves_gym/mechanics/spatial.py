"""Base pose: Y = (x, y, z, phi_x, phi_y, phi_z) and the platform's motion in its own frame.

R = Rot_z(phi_z) Rot_y(phi_y) Rot_x(phi_x): Z-Y-X angles as in Craig (thesis 2.3).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array

AXES = ("x", "y", "z", "phi_x", "phi_y", "phi_z")  # of Y
WRENCH = ("F_x", "F_y", "F_z", "M_x", "M_y", "M_z")  # of a force sensor
SINGULAR = 1e-3  # cos(phi_y) below this is reported: Z-Y-X angles end at 90 deg


def numbers(value: npt.ArrayLike) -> Array:
    """Return an array of floats; one of symbols stays as it is (`engine.kernel.symbolic`)."""
    if isinstance(value, np.ndarray) and value.dtype == object:
        return value
    return np.asarray(value, float)


def rotation(y: npt.ArrayLike) -> Array:
    """(..., 6) pose -> (..., 3, 3) rotation, platform frame to inertial frame."""
    pose = numbers(y)
    cx, cy, cz = (np.cos(pose[..., i]) for i in (3, 4, 5))
    sx, sy, sz = (np.sin(pose[..., i]) for i in (3, 4, 5))
    out = np.zeros_like(pose, shape=(*pose.shape[:-1], 3, 3))
    rows = (
        (cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx),
        (sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx),
        (-sy, cy * sx, cy * cx),
    )
    for i, row in enumerate(rows):
        for j, value in enumerate(row):
            out[..., i, j] = value
    return out


def rate_matrix(y: npt.ArrayLike) -> Array:
    """(..., 6, 6) T with twist = T Y': platform twist at its origin, in its own axes.

    Upper block R^T (linear velocity), lower block the Z-Y-X angle rates.
    """
    pose = numbers(y)
    cx, cy = np.cos(pose[..., 3]), np.cos(pose[..., 4])
    sx, sy = np.sin(pose[..., 3]), np.sin(pose[..., 4])
    out = np.zeros_like(pose, shape=(*pose.shape[:-1], 6, 6))
    out[..., :3, :3] = np.swapaxes(rotation(pose), -1, -2)
    out[..., 3, 3] = 1.0
    out[..., 3, 5] = -sy
    out[..., 4, 4], out[..., 4, 5] = cx, cy * sx
    out[..., 5, 4], out[..., 5, 5] = -sx, cy * cx
    return out


def twist(y: npt.ArrayLike, yd: npt.ArrayLike) -> Array:
    """Return the platform twist (..., 6) [m/s, rad/s] in its own axes, of a pose and its rate
    (..., 6)."""
    return matvec(rate_matrix(y), numbers(yd))


def twist_rate(y: npt.ArrayLike, yd: npt.ArrayLike, ydd: npt.ArrayLike) -> Array:
    """Return the time derivative (..., 6) of `twist`, as components in the turning platform
    axes, of a pose (..., 6) and its derivatives."""
    T, spin, turn, accel = base_motion(y, yd, ydd)
    velocity = matvec(T, numbers(yd))[..., :3]
    return np.concatenate([accel - cross(spin, velocity), turn], axis=-1)


def base_motion(
    y: npt.ArrayLike, yd: npt.ArrayLike, ydd: npt.ArrayLike
) -> tuple[Array, Array, Array, Array]:
    """Return T (..., 6, 6) of `rate_matrix`, and angular velocity, angular acceleration and
    acceleration of the origin (..., 3) of the platform in its own axes, of a pose (..., 6) and
    its derivatives."""
    pose, rate, T = numbers(y), numbers(yd), rate_matrix(y)
    spin, accelerated = matvec(T, rate)[..., 3:], matvec(T, numbers(ydd))
    cx, cy = np.cos(pose[..., 3]), np.cos(pose[..., 4])
    sx, sy = np.sin(pose[..., 3]), np.sin(pose[..., 4])
    dx, dy, dz = (rate[..., i] for i in (3, 4, 5))
    turn = accelerated[..., 3:]
    turn[..., 0] -= dz * cy * dy
    turn[..., 1] += -dy * sx * dx + dz * (cy * cx * dx - sy * sx * dy)
    turn[..., 2] += -dy * cx * dx - dz * (cy * sx * dx + sy * cx * dy)
    return T, spin, turn, accelerated[..., :3]


def body_wrench(
    inertia: Array, y: npt.ArrayLike, yd: npt.ArrayLike, ydd: npt.ArrayLike
) -> Array:
    """Return the wrench (..., 6) at the platform origin, its axes [N, N m], that moves a rigid
    body of spatial inertia (6, 6) there with the platform (Newton-Euler)."""
    v = twist(y, yd)
    momentum = matvec(inertia, v)
    out = matvec(inertia, twist_rate(y, yd, ydd))
    out[..., :3] += cross(v[..., 3:], momentum[..., :3])
    out[..., 3:] += cross(v[..., 3:], momentum[..., 3:])
    out[..., 3:] += cross(v[..., :3], momentum[..., :3])
    return out


def matvec(matrix: Array, vector: Array) -> Array:
    """Return stacked matrix (..., m, n) times stacked vector (..., n)."""
    out: Array = np.matmul(matrix, vector[..., None])[..., 0]
    return out


def cross(a: Array, b: Array) -> Array:
    """Vector product (..., 3), component by component: it rounds alike for any batch."""
    ahead = a[..., :2] * b[..., 1:]
    out = room(ahead, *ahead.shape[:-1], 3)
    np.subtract(ahead, a[..., 1:] * b[..., :2], out=out[..., ::-2])  # z and x
    np.subtract(a[..., 2] * b[..., 0], a[..., 0] * b[..., 2], out=out[..., 1])
    return out


def skew(v: Array) -> Array:
    """Cross-product matrices (..., 3, 3) of vectors (..., 3): skew(v) @ w = v x w."""
    out = np.zeros((*np.shape(v)[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    return out - np.swapaxes(out, -1, -2)


def room(like: Array, *shape: int) -> Array:
    """Return zeros of a shape, of the kind of `like`: numbers, or what is traced. Simulations
    lie side by side in memory, whose axis comes first: NumPy works along them."""
    return np.zeros_like(like, shape=shape, order="F")


def solve(A: Array, b: Array) -> Array:
    """Return A^-1 b of many systems, b (..., m); NaN where a matrix is singular."""
    try:
        return np.asanyarray(np.linalg.solve(A, b[..., None])[..., 0])
    except np.linalg.LinAlgError:  # of one matrix; the others have their answers
        bad = np.linalg.det(A) == 0
        regular = np.where(bad[..., None, None], np.eye(b.shape[-1]), A)
        return np.where(bad[..., None], np.nan, np.linalg.solve(regular, b[..., None])[..., 0])


def solve_symmetric(A: Array, b: Array) -> Array:
    """Return A^-1 b by L D L^T from the last row up, as along a tree.

    A (..., m, m) is symmetric and positive definite, its lower triangle is read; b (..., m, c).
    An arm is eliminated before its base, so that heavy joints cost the base no digits.
    Operators and slices only: one text for numbers and for what is traced.
    """
    L, out, size = 0 * A, 0 * b, A.shape[-1]
    for k in reversed(range(size)):
        row, side, inverse = A[..., k, :k], b[..., k, :], 1.0 / A[..., k, k, None]
        L[..., k, :k] = factor = row * inverse
        out[..., k, :] = side * inverse
        A = A[..., :k, :k] - factor[..., None] * row[..., None, :]
        b = b[..., :k, :] - factor[..., None] * side[..., None, :]
    for k in range(1, size):
        out[..., k:, :] -= L[..., k:, k - 1, None] * out[..., k - 1, None, :]
    return out


def solve_partly(A: Array, b: Array, known: list[int]) -> Array:
    """Return x of A x = b, as `solve_symmetric`, where x is known at some places: there b is
    x."""
    free = [k for k in range(A.shape[-1]) if k not in known]
    out = b.copy()
    reduced = b[..., free, :] - A[..., free, :][..., known] @ b[..., known, :]
    out[..., free, :] = solve_symmetric(A[..., free, :][..., free], reduced)
    return out


def quadratic(matrix: Array, vector: Array) -> Array:
    """Return half the quadratic form, 1/2 v^T M v (...,)."""
    out: Array = 0.5 * np.sum(vector * matvec(matrix, vector), axis=-1)
    return out
