"""Tool poses: the tool's place and the way it points, and the configurations that give them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import (
    Array,
    Index,
    ParameterError,
    Vector,
    finite,
    freeze_arrays,
    unit,
)
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.dynamics import Frames, frames
from ves_gym.mechanics.kinematics import tool_motions
from ves_gym.mechanics.spatial import cross, matvec, numbers, rotation

CLOSE = 1e-6  # m and rad from the pose: there
_ROUNDS = 60
_STEP = 0.3  # rad, the most a joint moves per round
_DAMPING = 1e-2  # of the least squares, times the squared error


@dataclass(frozen=True, kw_only=True)
class ToolPose:
    """Place of the tool in the platform-top frame, base at rest, and its turn if it matters."""

    position: Vector = unit("m")
    angles: Vector | None = unit("rad", default=None)  # Z-Y-X fixed, as the base's; None = any

    def __post_init__(self) -> None:
        freeze_arrays(self)
        finite(self.position, (3,), "ToolPose.position")
        if self.angles is not None:
            finite(self.angles, (3,), "ToolPose.angles")

    @property
    def rotation(self) -> Array | None:
        """(3, 3) from the tool's axes to the platform's, None where any turn will do."""
        if self.angles is None:
            return None
        return rotation(np.array([0.0, 0.0, 0.0, *self.angles]))

    @property
    def size(self) -> int:
        """Number of coordinates that are asked for: 3 or 6."""
        return 3 if self.angles is None else 6


def tool_pose(arm: Arm, q: npt.ArrayLike) -> ToolPose:
    """Return the tool's pose at one configuration (n,) [rad], base at rest."""
    from scipy.spatial.transform import Rotation  # heavy, and not for every arm

    place, turn = tool_frame(arm, finite(q, (arm.n,), "q"))
    z, y, x = Rotation.from_matrix(turn).as_euler("ZYX")
    return ToolPose(position=tuple(place.tolist()), angles=(float(x), float(y), float(z)))


def tool_frame(arm: Arm, q: npt.ArrayLike) -> tuple[Array, Array]:
    """Return position and rotation of the tool in the platform-top frame.

    Args:
        arm: the arm.
        q: (..., n) joint angles [rad].

    Returns:
        (..., 3) [m] and (..., 3, 3) from the tool's axes to the platform's.
    """
    place, turn = _last(frames(arm, q))
    return place, turn @ arm.tool_rotation


def _last(at: Frames) -> tuple[Array, Array]:
    """Position and rotation of the last link's frame, in plain order of memory.

    Products of stacks round by the layout of their memory.
    """
    position, rotation = at.position[..., -1, :], at.rotation[..., -1, :, :]
    return position.copy("C"), rotation.copy("C")


def tool_twists(arm: Arm, q: npt.ArrayLike) -> Array:
    """Return velocity and rate of rotation of the tool per joint rate, base at rest.

    Args:
        arm: the arm.
        q: (..., n) joint angles [rad].

    Returns:
        (..., 6, n) in the platform's axes: three rows [m/rad], three [1].
    """
    motions = tool_motions(arm, frames(arm, np.asarray(q, float)))
    return np.ascontiguousarray(np.swapaxes(motions, -1, -2))


def tool_speeds(arm: Arm, q: Array, v: Array, base: Array) -> Array:
    """Return the squared speed and squared rate of turning of the tool in space.

    Args:
        arm: the arm.
        q: (..., n) joint angles [rad].
        v: (..., n) joint rates [rad/s].
        base: (..., 6) twist of the base in its own axes [m/s, rad/s] (`spatial.twist`).

    Returns:
        (..., 2) [m^2/s^2, rad^2/s^2].
    """
    _, motion = _moving(arm, q, v, base)
    squares: Array = motion**2
    out: Array = squares.reshape(*squares.shape[:-1], 2, 3).sum(axis=-1)
    return out


class ToolState(NamedTuple):
    """Pose and twist of the tool in space, in the platform's axes."""

    place: Array  # (..., 3) from the platform's origin [m]
    turn: Array  # (..., 3, 3) from the tool's axes
    twist: Array  # (..., 6) [m/s, rad/s]


def tool_state(arm: Arm, q: Array, v: Array, base: Array) -> ToolState:
    """Return pose and twist of the tool.

    Args:
        arm: the arm.
        q: (..., n) joint angles [rad].
        v: (..., n) joint rates [rad/s].
        base: (..., 6) twist of the base in its own axes [m/s, rad/s] (`spatial.twist`).
    """
    at, motion = _moving(arm, q, v, base)
    place, turn = _last(at)
    return ToolState(place, turn @ arm.tool_rotation, motion)


def _moving(arm: Arm, q: Array, v: Array, base: Array) -> tuple[Frames, Array]:
    """Frames of the links, and twist (..., 6) of the end of the last, platform axes."""
    at = frames(arm, q)
    motion = base + (v[..., None] * tool_motions(arm, at)).sum(axis=-2)
    motion[..., :3] += cross(base[..., 3:], at.position[..., -1, :])
    return at, motion


def pose_dexterity(arm: Arm, q: npt.ArrayLike, lever: float) -> Array:
    """Return how far a configuration is from losing a direction of place or turn [m/rad].

    1 / |J^+| in the Frobenius norm, as `kinematics.dexterity`, of place and turn together.

    Args:
        arm: the arm.
        q: (..., n) joint angles [rad].
        lever: place that a turn counts as [m/rad].

    Returns:
        (...,) 0 at a singularity, and with fewer than six joints.
    """
    J = tool_twists(arm, q)
    J[..., 3:, :] *= lever
    values = np.linalg.svd(J, compute_uv=False)
    if values.shape[-1] < J.shape[-2]:
        return np.zeros(values.shape[:-1])
    worst = 1 / np.maximum(values, 1e-150) ** 2
    return np.asarray(worst.sum(axis=-1) ** -0.5, dtype=np.float64)


def pose_error(arm: Arm, pose: ToolPose, q: npt.ArrayLike) -> Array:
    """Return what is missing to a pose, as a twist.

    Args:
        arm: the arm.
        pose: of the tool.
        q: (..., n) joint angles [rad].

    Returns:
        (..., 3) [m], or (..., 6) [m, rad] where the turn matters.
    """
    return _missing(arm, np.array(pose.position), pose.rotation, numbers(q))


def _missing(arm: Arm, position: Array, rotation: Array | None, q: Array) -> Array:
    """Return what is missing to poses (..., 3) [m] and (..., 3, 3), as `pose_error`."""
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
    """Bring configurations to a pose by damped least squares inside the joint limits.

    Args:
        arm: the arm.
        pose: of the tool.
        q: (k, n) where to start [rad].
        rounds: of the least squares.

    Returns:
        q (k, n) [rad], and how far from the pose each is (k,) [m and rad, root of squares].
    """
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
        far = (np.abs(error) >= CLOSE / 100).any(axis=1)
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
    """Configurations within the joint limits that bring the tool to a pose.

    Damped least squares from `near` and from Halton's points over the joints' ranges. Where
    joints are left over, every start ends somewhere else: a sample of them.

    Args:
        arm: the arm.
        pose: of the tool.
        near: (n,) a configuration to start from as well [rad].
        starts: Halton's points.

    Returns:
        (k, n) [rad], at least 0.05 rad apart, that from `near` first; k = 0: out of reach.

    Raises:
        ParameterError: no starts.
    """
    at = _starts(arm, starts)
    if near is not None:
        at = np.vstack([finite(near, (arm.n,), "near"), at])
    return _apart(*towards_pose(arm, pose, at))


def configurations_at_each(
    arm: Arm, place: Array, turn: Array, near: Array, starts: int = 128
) -> list[Array]:
    """Return `configurations_at` for many poses at once.

    Args:
        arm: the arm.
        place: (m, 3) of the tool [m].
        turn: (m, 3, 3) of the tool.
        near: (m, n) configurations to start from as well [rad].
        starts: Halton's points, the same for every pose.

    Returns:
        m of (k, n) [rad].
    """
    halton = _starts(arm, starts)
    at = np.concatenate(
        [near[:, None], np.broadcast_to(halton, (len(near), *halton.shape))], axis=1
    )
    q, miss = _towards(arm, place[:, None], turn[:, None], at)
    return [_apart(*each) for each in zip(q, miss, strict=True)]


def _starts(arm: Arm, count: int) -> Array:
    """(count, n) points of Halton's over the joints' ranges [rad]."""
    if count < 1:
        raise ParameterError(f"starts must be >= 1, got {count}")
    low, high = arm.column("q_min"), arm.column("q_max")
    from scipy.stats import qmc  # half a second, which no `gym.make` needs

    points = qmc.Halton(arm.n, scramble=False).random(count)
    return np.asarray(qmc.scale(points, low, high), dtype=np.float64)


def _apart(q: Array, miss: Array) -> Array:
    """Return those of q (k, n) that are at the pose and apart from each other.

    Args:
        q: (k, n) [rad].
        miss: (k,) how far each is from the pose.
    """
    out: list[Array] = []
    for k in np.flatnonzero(miss <= CLOSE):
        if all(np.linalg.norm(q[k] - other) >= _APART for other in out):
            out.append(q[k])
    return np.array(out).reshape(-1, q.shape[1])


_APART = 0.05  # rad between configurations that count as two
