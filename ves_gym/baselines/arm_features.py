"""`ArmFeatures`: what the arm's kinematics say of an observation, as further inputs.

A network that sees joint angles and the way to a target must learn the arm's Jacobian and its
inverse before its last centimetres are right. Both are in closed form, so they can be given.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, ParameterError
from ves_gym.envs.task import Task
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.arm_library import arm_names, get_arm
from ves_gym.mechanics.dynamics import add, cross, dot, frames, scale

_DAMPING = 0.05  # m/rad, of the least squares near singular configurations
_NEAR, _FAR = 0.25, 2.0  # rad of the way left, told apart up to there: finely, coarsely
_FAST = 0.5  # rad/s that take back what the base does


@dataclass(frozen=True, kw_only=True)
class ArmFeatures:
    """Inputs that are computed from an observation by the kinematics of an arm.

    Joint angles that the damped inverse of the tool's Jacobian gives for the way to the target
    on the base as measured, up to 0.25 rad and up to 2 rad; the joint rates that it gives for
    the velocity of the tool with the base; sines and cosines of the joint angles; the tool in
    the base's axes. The observation has joint angles, pose and rate of the base, and either
    the way to the target or tool and target.
    """

    arm: str  # a name of the arm library
    scales: tuple[float, ...]  # of the observation's entries
    joint_angle: int  # entry of the first of them, as of what follows
    base_pose: int
    base_rate: int
    target: int  # less the tool, if `tool` is negative
    tool: int = -1

    def __post_init__(self) -> None:
        if self.arm not in arm_names():
            raise ParameterError(
                f"ArmFeatures.arm must be one of {', '.join(arm_names())}, got {self.arm!r}"
            )
        if not all(np.isfinite(k) and k > 0 for k in self.scales):
            raise ParameterError(f"ArmFeatures.scales must be > 0, got {self.scales}")
        widths = {"joint_angle": self._arm.n, "base_pose": 6, "base_rate": 6, "target": 3}
        for name, width in widths.items():
            if not 0 <= getattr(self, name) <= len(self.scales) - width:
                raise ParameterError(
                    f"ArmFeatures.{name} must be 0 to {len(self.scales) - width}, got"
                    f" {getattr(self, name)}"
                )
        if self.tool > len(self.scales) - 3:
            raise ParameterError(
                f"ArmFeatures.tool must be at most {len(self.scales) - 3}, got {self.tool}"
            )

    @cached_property
    def _arm(self) -> Arm:
        return get_arm(self.arm)

    @property
    def size(self) -> int:
        """How many there are."""
        return 5 * self._arm.n + 3

    def __call__(self, observation: npt.ArrayLike) -> Array:
        """Features (n, size) of observations (n, o)."""
        columns = list(np.moveaxis(np.asarray(observation, np.float64), -1, 0))
        return np.stack(np.broadcast_arrays(*self.formulas(columns, np, np.clip)), axis=-1)

    def formulas(
        self, entries: Sequence[Any], xp: Any, clip: Callable[[Any, float, float], Any]
    ) -> list[Any]:
        """Return the features from the entries of an observation, numbers, arrays or symbols.

        Args:
            entries: of the observation, in its scales.
            xp: namespace of sin and cos.
            clip: brings the first argument into the range of the others.
        """

        def part(first: int, count: int) -> list[Any]:
            return [entries[i] * self.scales[i] for i in range(first, first + count)]

        q = part(self.joint_angle, self._arm.n)
        turn = part(self.base_pose + 3, 3)
        way: Any = part(self.target, 3)
        if self.tool >= 0:
            way = [a - b for a, b in zip(way, part(self.tool, 3), strict=True)]
        base = part(self.base_rate, 6)
        (sx, sy, sz), (cx, cy, cz) = ([f(k) for k in turn] for f in (xp.sin, xp.cos))
        axes = (  # of the base in space, Z-Y-X
            (cz * cy, sz * cy, -sy),
            (cz * sy * sx - sz * cx, sz * sy * sx + cz * cx, cy * sx),
            (cz * sy * cx + sz * sx, sz * sy * cx - cz * sx, cy * cx),
        )
        desired = tuple(dot(axis, way) for axis in axes)
        moving = tuple(dot(axis, tuple(base[:3])) for axis in axes)
        dx, dy, dz = base[3:]
        turning = (dx - sy * dz, cx * dy + sx * cy * dz, cx * cy * dz - sx * dy)
        chain = frames(self._arm, q, xp)
        tool = chain[-1].position
        carried = add(moving, cross(turning, tool))
        J = [frame.moved(tool)[0] for frame in chain]  # velocity of the tool per joint rate
        joint_way = _damped(J, desired)
        taken = _damped(J, carried)
        return [
            *(clip(k, -_NEAR, _NEAR) * (1 / _NEAR) for k in joint_way),
            *(clip(k, -_FAR, _FAR) for k in joint_way),
            *(clip(k, -_FAST, _FAST) * (1 / _FAST) for k in taken),
            *(xp.sin(k) for k in q),
            *(xp.cos(k) for k in q),
            *tool,
        ]


def _damped(J: Sequence[Any], v: Any) -> list[Any]:
    """Return J^T (J J^T + damping^2)^-1 v by cofactors.

    Args:
        J: velocities of the tool (3), one per joint.
        v: (3) to be had.
    """
    rows = [
        [sum(a[i] * a[k] for a in J) + (_DAMPING**2 if i == k else 0.0) for k in range(3)]
        for i in range(3)
    ]
    a, b, c = (tuple(row) for row in rows)
    minors = cross(b, c), cross(c, a), cross(a, b)
    load = scale(1.0 / dot(a, minors[0]), add(*(scale(v[i], minors[i]) for i in range(3))))
    return [dot(column, load) for column in J]


def arm_features(task: Task, goal: bool = False) -> ArmFeatures:
    """Return the features of a task's observation.

    Args:
        task: of an arm of the library, with a target.
        goal: the observation is a dictionary, whose goals come first.
    """
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
    )
