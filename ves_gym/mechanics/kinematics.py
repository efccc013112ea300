"""Where the joints and the tool are, and how they move: frames, Jacobians, twists.

Plain NumPy, also traced, as `dynamics` is. Frame: the platform-top frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import (
    Array,
    ParameterError,
    Vector,
    finite,
    freeze_arrays,
    unit,
)
from ves_gym.mechanics.arm import Arm, Mechanism
from ves_gym.mechanics.arm_arrays import JointFrame, Root, spans
from ves_gym.mechanics.link import Turn, turn_by
from ves_gym.mechanics.spatial import cross, numbers, room, rotation

Rows = slice | list[int]  # of an axis


class Frames(NamedTuple):
    """Poses of the joint frames: frame 0 the first joint's before it turns, then the links'.

    Joint i turns about z of frame i - 1, or slides along it, and carries frame i. Of r arms
    side by side each has its own frame 0, before its links'.
    """

    rotations: Array  # (..., n + r, 3, 3) from the frame's axes to the platform's
    positions: Array  # (..., n + r, 3) m
    ways: Array  # (..., n, 3) from each frame to the next [m]
    joints: Rows  # of the frames in which the joints turn
    links: Rows  # of the frames that they carry

    @property
    def rotation(self) -> Array:
        """(..., n, 3, 3) of the links' frames."""
        return self.rotations[..., self.links, :, :]

    @property
    def position(self) -> Array:
        """(..., n, 3) of the links' frames [m]."""
        return self.positions[..., self.links, :]

    @property
    def axis(self) -> Array:
        """(..., n, 3) of the joints, unit vectors."""
        return self.rotations[..., self.joints, :, :][..., 2]

    @property
    def origin(self) -> Array:
        """(..., n, 3) points on the joints' axes [m]."""
        return self.positions[..., self.joints, :]


def frame_rows(roots: Sequence[Root], n: int) -> tuple[Rows, Rows]:
    """Return the rows of n joints' frames, and of their links', each arm's frame 0 among them;
    of one arm slices: its arrays are views."""
    if len(roots) == 1:
        return slice(None, -1), slice(1, None)
    joints = [i + k for k, span in enumerate(spans(roots, n)) for i in range(n)[span]]
    return joints, [row + 1 for row in joints]


def frames(arm: Mechanism, q: npt.ArrayLike) -> Frames:
    """Return the pose of every joint frame in the platform-top frame (thesis B.3), at joint
    angles q (..., n) [rad]."""
    angles, roots = np.asanyarray(numbers(q), order="F"), arm.roots
    if arm.coupling is not None:
        angles = arm.coupling.full(angles)
    batch, n = angles.shape[:-1], len(arm.joints)
    rows, r = frame_rows(roots, n), len(roots)
    at, beyond = (range(n + r)[k] if isinstance(k, slice) else k for k in rows)
    same, other = _swings(arm.joints, angles)
    rotations, positions = room(angles, *batch, n + r, 3, 3), room(angles, *batch, n + r, 3)
    ways = room(angles, *batch, n, 3)
    feet = {root.first: root for root in roots}
    for i in outwards(roots, n):
        joint = arm.joints[i]
        if i in feet:
            rotations[..., at[i], :, :], positions[..., at[i], :] = _foot(
                feet[i], beyond, rotations, positions
            )
        before, R = rotations[..., at[i], :, :], rotations[..., beyond[i], :, :]
        way = ways[..., i, :]
        z, (cosine, sine) = before[..., 2], joint.alpha
        swung = R[..., ::2] if cosine == 0.0 else R[..., :2]
        np.multiply(same[..., i, None, :], before[..., :2], out=swung)
        swung += other[..., i, None, :] * before[..., 1::-1]
        if cosine == 0.0:  # y has become z, and z y
            np.multiply(sine, z, out=R[..., 1])
        else:
            R[..., 2] = z
        if cosine != 0.0 and joint.alpha != (1.0, 0.0):  # of 1e-8 rad the cosine alone is 1
            R[..., 1:] = _turned(R[..., 1:], joint.alpha)
        if joint.a:
            np.multiply(joint.a, R[..., 0], out=way)
        if joint.slides:
            way += (joint.d + angles[..., i, None]) * z
        elif joint.d:
            way += joint.d * z
        if joint.beta is not None:  # z towards x
            R[..., ::-2] = _turned(R[..., ::-2], joint.beta)
        np.add(positions[..., at[i], :], way, out=positions[..., beyond[i], :])
    return Frames(rotations, positions, ways, *rows)


def outwards(roots: Sequence[Root], n: int) -> list[int]:
    """Return the n joints in an order in which those that carry others come first."""
    order = spans(roots, n)
    if any(root.on is not None for root in roots):
        order = order[::-1]
    return [i for span in order for i in range(n)[span]]


def _foot(
    root: Root, beyond: Sequence[int], rotations: Array, positions: Array
) -> tuple[Array, Array]:
    """Rotation and position of a chain's frame 0 in the platform-top frame."""
    if root.on is None:
        return root.rotation, root.position
    turn, place = rotations[..., beyond[root.on], :, :], positions[..., beyond[root.on], :]
    return turn @ root.rotation, place + (turn * root.position).sum(axis=-1)


def _swings(joints: tuple[JointFrame, ...], q: Array) -> tuple[Array, Array]:
    """Return the factors (n, 2) that take x and y of a frame to those of its successor.

    x' = c x + s y and y' = c y - s x, of the angles of the DH table; where alpha is a right
    angle the second is -sin(alpha) y', which is where z comes to lie.
    """
    offsets = [joint.offset for joint in joints]
    angles = q + np.array(offsets) if any(offsets) else q
    cosine, sine = np.cos(angles), np.sin(angles)
    for i, joint in enumerate(joints):
        if joint.slides:
            cosine[..., i], sine[..., i] = turn_by(joint.offset)
    sign = np.array([-j.alpha[1] if j.alpha[0] == 0.0 else 1.0 for j in joints])
    same, other = room(q, *q.shape, 2), room(q, *q.shape, 2)
    same[..., 0], other[..., 0] = cosine, sine
    np.multiply(cosine, sign, out=same[..., 1])
    np.multiply(sine, -sign, out=other[..., 1])
    return same, other


def _turned(pair: Array, turn: Turn) -> Array:
    """Columns u, w (..., 3, 2) as c u + s w and c w - s u."""
    cosine, sine = turn
    return cosine * pair + np.array([sine, -sine]) * pair[..., ::-1]


def twists(arm: Mechanism, at: Frames) -> tuple[Array, Array]:
    """Return velocity at the platform's origin, and angular velocity (..., n, 3), of what is
    beyond each joint, followers too, per rate of the joint."""
    moving, turning = cross(at.origin, at.axis), at.axis
    if any(joint.slides for joint in arm.joints):
        turning = turning.copy()
    for i, joint in enumerate(arm.joints):
        if joint.slides:
            moving[..., i, :], turning[..., i, :] = at.axis[..., i, :], 0.0
    return moving, turning


def joint_positions(arm: Arm, q: npt.ArrayLike) -> Array:
    """Return the origins (..., n + 1, 3) [m] of the platform frame and of every link frame, at
    joint angles q (..., n) [rad]; the last is the tool (the far end of the last link)."""
    at = frames(arm, joint_values(arm, q))
    out = np.ascontiguousarray(at.positions)
    if len(arm.roots) > 1 or arm.coupling is not None:
        rows = np.arange(out.shape[-2])[at.links]
        out = out[..., [0, *rows[arm.driven]], :]
    out[..., 0, :] = 0.0
    return out


def joint_values(arm: Arm, q: npt.ArrayLike, name: str = "q") -> Array:
    """Return (..., n) values of the joints as an array; refused by `name` of another number."""
    array = numbers(q)
    if array.ndim == 0 or array.shape[-1] != arm.n:
        raise ParameterError(f"{name} must have shape (..., {arm.n}), got {array.shape}")
    return array


# ------------------------------------------------------------------------- the tool


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
        """Number of the goal's coordinates: 3 or 6."""
        return 3 if self.angles is None else 6


def tool_motions(arm: Mechanism, at: Frames) -> Array:
    """Return velocity and rate of turning (..., n, 6) of the tool per driven joint's rate."""
    out = room(at.axis, *at.axis.shape[:-1], 6)
    reach = at.position[..., -1:, :] - at.origin
    out[..., :3], out[..., 3:] = cross(at.axis, reach), at.axis
    for i, joint in enumerate(arm.joints):
        if joint.slides:
            out[..., i, :3], out[..., i, 3:] = at.axis[..., i, :], 0.0
    out[..., : arm.roots[-1].first, :] = 0.0  # other arms do not move this one's tool
    return out if arm.coupling is None else arm.coupling.reduced(out)


def tool_jacobian(arm: Arm, q: npt.ArrayLike) -> Array:
    """Return the velocity of the tool per joint rate (..., 3, n) [m/rad], base at rest, at
    joint angles q (..., n) [rad]."""
    motions = tool_motions(arm, frames(arm, joint_values(arm, q)))
    return np.ascontiguousarray(np.swapaxes(motions[..., :3], -1, -2))


def dexterity(arm: Arm, q: npt.ArrayLike) -> Array:
    """Return how far q (..., n) [rad] is from a singularity (...,) [m/rad]: 0 there, else at
    most the tool's least speed per joint rate.

    1 / |J^+| in the Frobenius norm: (sum of 1/s_i^2)^-1/2 of the singular values s_i. In closed
    form det(A) / trace(adj(A)) = that squared, A = J J^T.
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


def tool_frame(arm: Arm, q: npt.ArrayLike) -> tuple[Array, Array]:
    """Return position and rotation of the tool in the platform-top frame, at joint angles q
    (..., n) [rad]: (..., 3) [m] and (..., 3, 3) from the tool's axes to the platform's."""
    place, turn = _last(frames(arm, q))
    return place, turn @ arm.tool_rotation


def _last(at: Frames) -> tuple[Array, Array]:
    """Position and rotation of the last link's frame, in plain order of memory.

    Products of stacks round by the layout of their memory.
    """
    position, rotation = at.position[..., -1, :], at.rotation[..., -1, :, :]
    return position.copy("C"), rotation.copy("C")


def tool_twists(arm: Arm, q: npt.ArrayLike) -> Array:
    """Return velocity and rate of rotation of the tool per joint rate (..., 6, n) in the
    platform's axes, base at rest, at joint angles q (..., n) [rad]."""
    motions = tool_motions(arm, frames(arm, np.asarray(q, float)))
    return np.ascontiguousarray(np.swapaxes(motions, -1, -2))


def tool_speeds(arm: Arm, q: Array, v: Array, base: Array) -> Array:
    """Return the squared speed and squared rate of turning of the tool in space (..., 2), as
    `tool_state` takes them."""
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
    """Return pose and twist of the tool, at joint angles q (..., n) [rad] and rates v, on a
    base of twist (..., 6) in its own axes (`spatial.twist`)."""
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
    """Return `dexterity` of place and turn together (...,) [m/rad], a turn counted as `lever`
    [m/rad]: how far q (..., n) is from losing a direction; 0 with fewer than six joints."""
    J = tool_twists(arm, q)
    J[..., 3:, :] *= lever
    values = np.linalg.svd(J, compute_uv=False)
    if values.shape[-1] < J.shape[-2]:
        return np.zeros(values.shape[:-1])
    worst = 1 / np.maximum(values, 1e-150) ** 2
    return np.asarray(worst.sum(axis=-1) ** -0.5, dtype=np.float64)
