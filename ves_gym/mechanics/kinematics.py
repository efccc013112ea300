"""Joint angles and the tool: its Jacobian, and the way back from a point to the joints."""

from __future__ import annotations

import itertools

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, ParameterError
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.dynamics import Frames, frames, joint_positions
from ves_gym.mechanics.joints import Mechanism
from ves_gym.mechanics.spatial import cross, matvec, room

_ROUNDS = 40
_STEP = 0.3  # rad, the most a joint moves per round
_DAMPING = 1e-2  # of the least squares, times the squared error
_GUESSES = (1 / 6, 1 / 2, 5 / 6)  # of every joint's range
_CLOSE = 1e-6  # m from the point: solved
_SAME = 1e-3  # rad between two solutions that count as one
MOST = 8  # solutions told apart


def tool_jacobian(arm: Arm, q: npt.ArrayLike) -> Array:
    """Return the velocity of the tool per joint rate, base at rest.

    Args:
        arm: the arm.
        q: (..., n) joint angles [rad].

    Returns:
        (..., 3, n) [m/rad].
    """
    angles = np.asarray(q, float)
    if angles.ndim == 0 or angles.shape[-1] != arm.n:
        raise ParameterError(f"q must have shape (..., {arm.n}), got {angles.shape}")
    at = frames(arm, angles)
    return np.ascontiguousarray(np.swapaxes(tool_motions(arm, at)[..., :3], -1, -2))


def tool_motions(arm: Mechanism, at: Frames) -> Array:
    """Return velocity and rate of turning (..., n, 6) of the tool per joint rate.

    Args:
        arm: the arm.
        at: its frames.
    """
    out = room(at.axis, *at.axis.shape[:-1], 6)
    reach = at.position[..., -1:, :] - at.origin
    out[..., :3], out[..., 3:] = cross(at.axis, reach), at.axis
    for i, joint in enumerate(arm.joints):
        if joint.slides:
            out[..., i, :3], out[..., i, 3:] = at.axis[..., i, :], 0.0
    return out


def dexterity(arm: Arm, q: npt.ArrayLike) -> Array:
    """Return how far a configuration is from a singularity [m/rad].

    1 / |J^+| in the Frobenius norm: (sum of 1/s_i^2)^-1/2 of the singular values s_i. In
    closed form det(A) / trace(adj(A)) = that squared, A = J J^T.

    Args:
        arm: the arm.
        q: (..., n) joint angles [rad].

    Returns:
        (...,) 0 at a singularity, else at most the tool's least speed per joint rate.
    """
    J = tool_jacobian(arm, q)
    x, y, z = J[..., 0, :], J[..., 1, :], J[..., 2, :]
    xx, yy, zz, xy, xz, yz = (
        (a * b).sum(axis=-1) for a, b in ((x, x), (y, y), (z, z), (x, y), (x, z), (y, z))
    )
    minor = yy * zz - yz * yz
    det = xx * minor - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
    trace = minor + xx * zz - xz * xz + xx * yy - xy * xy
    return np.asarray(np.sqrt(np.maximum(det, 0.0) / np.maximum(trace, 1e-300)), np.float64)


def joints_for(arm: Arm, points: npt.ArrayLike, near: npt.ArrayLike) -> tuple[Array, Array]:
    """Joint angles within the limits that bring the tool to points, base at rest.

    Damped least squares from `near` and from a grid over the joints' ranges.

    Args:
        points: (k, 3) in the platform frame [m].
        near: (k, n) of several solutions the one soonest reached from here [rad].

    Returns:
        q (k, n) and how far from the points that is (k,) [m]: what is out of reach is
        approached.
    """
    q, miss, way = _candidates(arm, points, near)
    # the best, and of the solved ones the soonest
    pick = np.where(miss <= _CLOSE, -1 / (1 + way), miss).argmin(axis=1)
    rows = np.arange(len(q))
    return q[rows, pick], miss[rows, pick]


def every_joints_for(arm: Arm, points: npt.ArrayLike, near: npt.ArrayLike) -> Array:
    """All configurations within the limits that bring the tool to points, base at rest.

    Of arms with as many joints as a place has coordinates; of others those that the search
    comes upon.

    Args:
        arm: the arm.
        points: (k, 3) in the platform frame [m].
        near: (k, n) [rad], where the search begins.

    Returns:
        (k, `MOST`, n) [rad], those soonest reached from `near` first, NaN beyond the last;
        where there is none, what comes closest.
    """
    q, miss, way = _candidates(arm, points, near)
    out = np.full((len(q), MOST, arm.n), np.nan)
    for found, ends, lack, seconds in zip(out, q, miss, way, strict=True):
        solved = np.flatnonzero(lack <= _CLOSE)
        ranked = solved[seconds[solved].argsort()] if len(solved) else [lack.argmin()]
        count = 0
        for end in ends[ranked]:
            if count < MOST and not (np.abs(found[:count] - end).max(axis=1) < _SAME).any():
                found[count] = end
                count += 1
    return out


def _candidates(
    arm: Arm, points: npt.ArrayLike, near: npt.ArrayLike
) -> tuple[Array, Array, Array]:
    """Ends q (k, m, n) of searches from several starts, their miss (k, m) and way (k, m).

    Args:
        arm: the arm.
        points: (k, 3) [m].
        near: (k, n), the first start; the way from it is in seconds at full speed.
    """
    low, high = arm.column("q_min"), arm.column("q_max")
    grid = low + (high - low) * np.array(list(itertools.product(_GUESSES, repeat=arm.n)))
    start = np.asarray(near, float)[:, None]
    wide = np.broadcast_to(grid, (len(start), *grid.shape))
    q = np.clip(np.concatenate([start, wide], axis=1), low, high)
    goal = np.asarray(points, float)[:, None]
    for _ in range(_ROUNDS):
        error = goal - joint_positions(arm, q)[..., -1, :]
        J = tool_jacobian(arm, q)
        across = np.swapaxes(J, -1, -2)
        # damped by the error itself, so that the last rounds are Newton's
        damping = _DAMPING * (error**2).sum(axis=-1)[..., None, None] + 1e-12
        load = np.linalg.solve(J @ across + damping * np.eye(3), error[..., None])
        step = matvec(across, load[..., 0])
        fastest = np.abs(step).max(axis=-1, keepdims=True)
        q = np.clip(q + step * (_STEP / np.maximum(fastest, _STEP)), low, high)
    miss = np.linalg.norm(goal - joint_positions(arm, q)[..., -1, :], axis=-1)
    way = (np.abs(q - start) / arm.column("v_max")).max(axis=-1)
    return q, miss, way
