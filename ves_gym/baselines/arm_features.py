"""`ArmFeatures`: what the arm's kinematics say of an observation, as further inputs.

A network that sees joint angles and the way to a target must learn the arm's Jacobian and its
inverse before its last centimetres are right. Both are in closed form, so they can be given.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, ParameterError
from ves_gym.envs.task import Task
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.arm_library import arm_names, get_arm
from ves_gym.mechanics.kinematics import Frames, frames, tool_motions
from ves_gym.mechanics.spatial import (
    cross,
    matvec,
    numbers,
    rotation,
    solve_symmetric,
    twist,
)
from ves_gym.mechanics.spherical_wrist import has_spherical_wrist, shortest_way

_DAMPING = 0.05  # m/rad, of the least squares near singular configurations
_NEAR, _FAR = 0.25, 2.0  # rad of the way left, told apart up to there: finely, coarsely
_FAST = 0.5  # rad/s that take back what the base does
_LEVER = 0.3  # m per radian, of turn beside place
_FURTHER = 6.3  # rad of the way left to a pose, told apart up to there
_POSE_DAMPING = 0.03  # m/rad
_LEAST = 1e-5  # of 1 + cosine, where an axis is turned
_WEIGHTS = np.array([1.0, 1.0, 1.0, _LEVER, _LEVER, _LEVER])


@dataclass(frozen=True, kw_only=True)
class ArmFeatures:
    """Inputs that are computed from an observation by the kinematics of an arm.

    Joint angles that the damped inverse of the tool's Jacobian gives for the way to the target
    on the base as measured, up to 0.25 rad and up to 2 rad; the joint rates that it gives for
    the velocity of the tool with the base; sines and cosines of the joint angles; the tool in
    the base's axes. The observation has joint angles, pose and rate of the base, and either
    the way to the target or tool and target.

    Where an orientation is asked too (`turn`), of an arm with a spherical wrist, the Jacobian
    is that of place and turn, and both ranges of joint angles are those to the nearest
    configuration for the pose, in closed form. There follow the axes that the tool has and is
    to have, in the base's.
    """

    arm: str  # a name of the arm library
    scales: tuple[float, ...]  # of the observation's entries
    joint_angle: int  # entry of the first of them, as of what follows
    base_pose: int
    base_rate: int
    target: int  # less the tool, if `tool` is negative
    tool: int = -1
    turn: int = -1  # axis of the missing turn, times its sine, then the cosine; negative: any

    def __post_init__(self) -> None:
        if self.arm not in arm_names():
            raise ParameterError(
                f"ArmFeatures.arm must be one of {', '.join(arm_names())}, got {self.arm!r}"
            )
        if not all(np.isfinite(k) and k > 0 for k in self.scales):
            raise ParameterError(f"ArmFeatures.scales must be > 0, got {self.scales}")
        required = {"joint_angle": self._arm.n, "base_pose": 6, "base_rate": 6, "target": 3}
        for name, width in {**required, "tool": 3, "turn": 4}.items():
            first, last = (0 if name in required else -1), len(self.scales) - width
            if not first <= getattr(self, name) <= last:
                raise ParameterError(
                    f"ArmFeatures.{name} must be {first} to {last}, got {getattr(self, name)}"
                )
        if self.turn >= 0 and not has_spherical_wrist(self._arm):
            raise ParameterError(
                f"ArmFeatures of a pose need an arm with a spherical wrist, got {self.arm}"
            )

    @cached_property
    def _arm(self) -> Arm:
        return get_arm(self.arm)

    @property
    def size(self) -> int:
        """Return the number of features."""
        return 5 * self._arm.n + (3 if self.turn < 0 else 21)

    def __str__(self) -> str:
        if self.turn < 0:
            return "inverse Jacobian's answers, sines and cosines, tool's place"
        return (
            "joint angles missing to the nearest configuration for the pose (closed form),"
            " finely and coarsely; inverse Jacobian's answer to the base's motion; sines and"
            " cosines; tool's place and axes, axes it is to have"
        )

    def __call__(self, observation: npt.ArrayLike) -> Array:
        """Return features (n, size) of observations (n, o): numbers, or what is traced."""
        x = numbers(observation)

        def part(first: int, count: int) -> Array:
            return x[:, first : first + count] * np.array(self.scales[first : first + count])

        arm, q = self._arm, part(self.joint_angle, self._arm.n)
        pose, way = part(self.base_pose, 6), part(self.target, 3)
        if self.tool >= 0:
            way = way - part(self.tool, 3)
        back = np.swapaxes(rotation(pose), -1, -2)
        moving = twist(pose, part(self.base_rate, 6))
        at, desired = frames(arm, q), matvec(back, way)
        tool, moved = at.position[..., -1, :], tool_motions(arm, at)
        carried, turning = moving[:, :3] + cross(moving[:, 3:], tool), moving[:, 3:]
        others = [tool]
        if self.turn < 0:
            J, far = moved[..., :3], _FAR
            joint_way, taken = _damped(J, desired), _damped(J, carried)
        else:
            missing = matvec(back, part(self.turn, 3))
            turn, far = self._turn(at), _FURTHER
            target_turn = _turned(missing, part(self.turn + 3, 1)[:, 0], turn)
            joint_way = shortest_way(arm, q, tool + desired, target_turn)
            both = np.concatenate([carried, _LEVER * turning], axis=-1)
            taken = _damped(moved * _WEIGHTS, both)
            axes = [np.swapaxes(k, -1, -2).reshape(len(q), 9) for k in (turn, target_turn)]
            others = [tool, *axes]
        parts = (
            np.clip(joint_way, -_NEAR, _NEAR) * (1 / _NEAR),
            np.clip(joint_way, -far, far),
            np.clip(taken, -_FAST, _FAST) * (1 / _FAST),
            np.sin(q),
            np.cos(q),
            *others,
        )
        return np.concatenate(parts, axis=-1)

    def _turn(self, at: Frames) -> Array:
        """(n, 3, 3) from the tool's axes to the base's."""
        last = at.rotation[..., -1, :, :].copy("C")
        turn: Array = last @ self._arm.tool_rotation
        return turn


def _turned(sines: Array, cosine: Array, turn: Array) -> Array:
    """Axes (n, 3, 3) turned about another, given times the sine; cosine (n,); Rodrigues."""
    axes, about = np.swapaxes(turn, -1, -2), sines[:, None]
    along = (about * axes).sum(axis=-1) * (1.0 / (cosine + (1.0 + _LEAST)))[:, None]
    out = cosine[:, None, None] * axes + cross(about, axes) + along[..., None] * about
    return np.swapaxes(out, -1, -2)


def _damped(J: Array, v: Array) -> Array:
    """J^T (J J^T + damping^2)^-1 v (n, joints), J (n, joints, m) the tool's rate per joint."""
    m = v.shape[-1]
    square = (_DAMPING if m == 3 else _POSE_DAMPING) ** 2
    A = (J[..., :, None] * J[..., None, :]).sum(axis=-3) + square * np.eye(m)
    load = solve_symmetric(A, v[..., None])[..., 0]
    return (J * load[:, None]).sum(axis=-1)


def arm_features(task: Task, goal: bool = False) -> ArmFeatures:
    """Return the features of a task's observation; of a `goal` variant its goals come first."""
    fields = {field.name: field for field in task.parts()}
    if goal and task.goal_fields is not None:
        fields = {name: fields[name] for name in (*task.goal_fields, *fields)}
    scales = [fields[name].scale for name in fields]
    entries = np.cumsum([0, *(len(k) for k in scales)]).tolist()
    at = dict(zip(fields, entries, strict=False))
    way = "to_target" if "to_target" in at else "target"
    missing = [k for k in ("joint_angle", "base_pose", "base_rate", way) if k not in at]
    if missing:
        raise ParameterError(
            f"features of the arm need {', '.join(missing)} in the observation, which task"
            f" {task.kind} has not"
        )
    return ArmFeatures(
        arm=task.system.arm.name,
        scales=tuple(np.concatenate(scales).tolist()),
        joint_angle=at["joint_angle"],
        base_pose=at["base_pose"],
        base_rate=at["base_rate"],
        target=at[way],
        tool=at["tool"] if way == "target" else -1,
        turn=at.get("to_turn", -1),
    )
