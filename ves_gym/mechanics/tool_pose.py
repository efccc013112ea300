"""Places and poses of the tool, and the joint angles that bring it there."""

from __future__ import annotations

import itertools

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import (
    Array,
    Index,
    ParameterError,
    finite,
)
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.kinematics import ToolPose, tool_frame, tool_twists
from ves_gym.mechanics.spatial import matvec

CLOSE = 1e-6  # m and rad from the pose: there
MOST = 8  # solutions of a place
_DONE = 1e-10  # m and rad: the next round of Newton's would be rounding
_ROUNDS = 60
_GUESSES = (1 / 6, 1 / 2, 5 / 6)  # of every joint's range
_SAME = 1e-3  # rad between two solutions that count as one
_DIFFERENT = 0.05  # rad between configurations that count as two, where joints are left over
_STEP = 0.3  # rad, the most a joint moves per round
_DAMPING = 1e-2  # of the least squares, times the squared error


def _missing(arm: Arm, position: Array, rotation: Array | None, q: Array) -> Array:
    """Return what is missing at q (..., n) to places (..., 3) [m] and turns (..., 3, 3), as a
    twist: (..., 3) [m], or (..., 6) [m, rad] where the turn matters."""
    place, turn = tool_frame(arm, q)
    missing: Array = position - place
    if rotation is None:
        return missing
    from scipy.spatial.transform import Rotation

    turned = rotation @ np.swapaxes(turn, -1, -2)
    vectors = Rotation.from_matrix(turned.reshape(-1, 3, 3)).as_rotvec()
    return np.concatenate([missing, vectors.reshape(missing.shape)], axis=-1)


def towards_pose(
    arm: Arm, pose: ToolPose, q: npt.ArrayLike, rounds: int = _ROUNDS
) -> tuple[Array, Array]:
    """Bring configurations q (k, n) [rad] to a pose by damped least squares inside the joint
    limits; return them, and how far from the pose each is (k,) [m and rad, root of squares]."""
    return _towards(arm, np.array(pose.position), pose.rotation, np.asarray(q, float), rounds)


def _towards(
    arm: Arm, position: Array, rotation: Array | None, q: Array, rounds: int = _ROUNDS
) -> tuple[Array, Array]:
    """Bring configurations (..., n) to poses (..., 3) and (..., 3, 3), as `towards_pose`."""
    size, shape = 3 if rotation is None else 6, q.shape
    low, high = arm.column("q_min"), arm.column("q_max")
    at = np.clip(q, low, high).reshape(-1, arm.n)
    goals = np.broadcast_to(position, (*shape[:-1], 3)).reshape(-1, 3)
    turns = rotation
    if rotation is not None:
        turns = np.broadcast_to(rotation, (*shape[:-1], 3, 3)).reshape(-1, 3, 3)

    def missing(rows: Index | slice) -> Array:
        return _missing(arm, goals[rows], None if turns is None else turns[rows], at[rows])

    going = np.arange(len(at))
    for _ in range(rounds):
        error = missing(going)
        far = (np.abs(error) >= _DONE).any(axis=1)
        going, error = going[far], error[far]
        if not len(going):
            break
        J = tool_twists(arm, at[going])[..., :size, :]
        across = np.swapaxes(J, -1, -2)
        # damped by the error itself, so that the last rounds are Newton's
        damping = _DAMPING * (error**2).sum(axis=-1)[..., None, None] + 1e-12
        load = np.linalg.solve(J @ across + damping * np.eye(size), error[..., None])
        step = matvec(across, load[..., 0])
        fastest = np.abs(step).max(axis=-1, keepdims=True)
        moved = at[going] + step * (_STEP / np.maximum(fastest, _STEP))
        at[going] = np.clip(moved, low, high)
    miss = np.linalg.norm(missing(slice(None)), axis=-1)
    return at.reshape(shape), miss.reshape(shape[:-1])


def configurations_at(
    arm: Arm, pose: ToolPose, *, near: npt.ArrayLike | None = None, starts: int = 128
) -> Array:
    """Configurations (k, n) [rad] within the joint limits that bring the tool to a pose; k = 0:
    out of reach.

    Damped least squares from `near` (n,) and from so many of Halton's points over the joints'
    ranges; at least 0.05 rad from each other, that from `near` first. Where joints are left
    over, every start ends somewhere else: a sample of them.
    """
    first = arm.home if near is None else finite(near, (arm.n,), "near")
    at = _beside(first[None], _starts(arm, starts))[0]
    return _distinct(*towards_pose(arm, pose, at[1:] if near is None else at))


def configurations_at_each(
    arm: Arm, place: Array, turn: Array, near: Array, starts: int = 128
) -> list[Array]:
    """Return `configurations_at` for m poses at once, place (m, 3) and turn (m, 3, 3), near (m,
    n)."""
    at = _beside(near, _starts(arm, starts))
    return [
        _distinct(*k)
        for k in zip(*_towards(arm, place[:, None], turn[:, None], at), strict=True)
    ]


def _beside(near: Array, starts: Array) -> Array:
    """(m, 1 + k, n) starts of m searches: one of their own (m, n), then k of all (k, last) in
    the last joints alone, those of the arm whose tool it is; others stay."""
    wide = np.repeat(near[:, None], 1 + len(starts), axis=1)
    wide[:, 1:, near.shape[1] - starts.shape[1] :] = starts
    return wide


def _own_range(arm: Arm) -> tuple[Array, Array]:
    """Lower and upper limits of the joints that move the tool [rad]."""
    span = arm.spans[-1]
    return arm.column("q_min")[span], arm.column("q_max")[span]


def _starts(arm: Arm, count: int) -> Array:
    """(count, n) points of Halton's over the ranges of the joints that move the tool [rad]."""
    if count < 1:
        raise ParameterError(f"starts must be >= 1, got {count}")
    low, high = _own_range(arm)
    from scipy.stats import qmc  # half a second, which no `gym.make` needs

    points = qmc.Halton(len(low), scramble=False).random(count)
    return np.asarray(qmc.scale(points, low, high), dtype=np.float64)


def _distinct(q: Array, miss: Array) -> Array:
    """Return those of q (k, n) whose miss (k,) is none and that differ from each other."""
    out: list[Array] = []
    for k in np.flatnonzero(miss <= CLOSE):
        if all(np.linalg.norm(q[k] - other) >= _DIFFERENT for other in out):
            out.append(q[k])
    return np.array(out).reshape(-1, q.shape[1])


# --------------------------------------------------------------------- a place alone


def joints_for(arm: Arm, points: npt.ArrayLike, near: npt.ArrayLike) -> tuple[Array, Array]:
    """Joint angles within the limits that bring the tool to points, base at rest.

    Damped least squares from `near` (k, n) and from a grid over the joints' ranges: of several
    solutions the one soonest reached from there. Returns q (k, n) and how far from the points
    (k, 3) that is (k,) [m]: what is out of reach is approached.
    """
    q, miss, way = _candidates(arm, points, near)
    # the best, and of the solved ones the soonest
    pick = np.where(miss <= CLOSE, -1 / (1 + way), miss).argmin(axis=1)
    rows = np.arange(len(q))
    return q[rows, pick], miss[rows, pick]


def every_joints_for(arm: Arm, points: npt.ArrayLike, near: npt.ArrayLike) -> Array:
    """All configurations (k, `MOST`, n) [rad] within the limits that bring the tool to points
    (k, 3), base at rest.

    Those soonest reached from `near` (k, n) first, NaN beyond the last; where there is none,
    what comes closest. Of arms with more joints than a place has coordinates those that the
    search comes upon.
    """
    q, miss, way = _candidates(arm, points, near)
    out = np.full((len(q), MOST, arm.n), np.nan)
    for row, ends, lack, seconds in zip(out, q, miss, way, strict=True):
        solved = np.flatnonzero(lack <= CLOSE)
        ranked = (
            solved[seconds[solved].argsort(kind="stable")] if len(solved) else [lack.argmin()]
        )
        count = 0
        for end in ends[ranked]:
            if count < MOST and not (np.abs(row[:count] - end).max(axis=1) < _SAME).any():
                row[count] = end
                count += 1
    return out


def _candidates(
    arm: Arm, points: npt.ArrayLike, near: npt.ArrayLike
) -> tuple[Array, Array, Array]:
    """Ends q (k, m, n) of searches from several starts, `near` (k, n) the first, their miss (k,
    m) and way (k, m) from there in seconds at full speed."""
    low, high = _own_range(arm)
    grid = low + (high - low) * np.array(list(itertools.product(_GUESSES, repeat=len(low))))
    start = np.asarray(near, float)
    goal = np.asarray(points, float)[:, None]
    q, miss = _towards(arm, goal, None, _beside(start, grid), rounds=40)
    way = (np.abs(q - start[:, None]) / arm.column("v_max")).max(axis=-1)
    return q, miss, way.round(6)  # of equal ways the first start's, not rounding's choice
