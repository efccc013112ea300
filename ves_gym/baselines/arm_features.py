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
from ves_gym.mechanics.dynamics import Frame, add, cross, dot, frames, scale
from ves_gym.mechanics.spherical_wrist import has_spherical_wrist, shortest_way

_DAMPING = 0.05  # m/rad, of the least squares near singular configurations
_NEAR, _FAR = 0.25, 2.0  # rad of the way left, told apart up to there: finely, coarsely
_FAST = 0.5  # rad/s that take back what the base does
_LEVER = 0.3  # m per radian, of turn beside place
_NO_AXIS = 0.02  # of 1 + cosine: half a turn has no axis
_ROUNDS, _MOST_ROUNDS = 4, 16
_FURTHER = 6.3  # rad of the way left to a pose, told apart up to there
_POSE_DAMPING = 0.03  # m/rad
_LEAST = 1e-5  # of 1 + cosine, where an axis is turned
_STRIDE = 1.0  # rad, the most that a joint moves per round of Newton's method


@dataclass(frozen=True, kw_only=True)
class ArmFeatures:
    """Inputs that are computed from an observation by the kinematics of an arm.

    Joint angles that the damped inverse of the tool's Jacobian gives for the way to the target
    on the base as measured, up to 0.25 rad and up to 2 rad; the joint rates that it gives for
    the velocity of the tool with the base; sines and cosines of the joint angles; the tool in
    the base's axes. The observation has joint angles, pose and rate of the base, and either
    the way to the target or tool and target.

    Where an orientation is asked too (`turn`), the Jacobian is that of place and turn. Both
    ranges of joint angles are those to the nearest configuration for the pose, in closed form,
    of an arm with a spherical wrist (`rounds` = 0), of others those that `rounds` of Newton's
    method give. There follow the axes that the tool has and is to have, in the base's, and what
    Newton's last round lacked.
    """

    arm: str  # a name of the arm library
    scales: tuple[float, ...]  # of the observation's entries
    joint_angle: int  # entry of the first of them, as of what follows
    base_pose: int
    base_rate: int
    target: int  # less the tool, if `tool` is negative
    tool: int = -1
    turn: int = -1  # axis of the missing turn, times its sine, then the cosine; negative: any
    rounds: int = 1  # of Newton's method; 0: closed form

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
        if self.turn > len(self.scales) - 4:
            raise ParameterError(
                f"ArmFeatures.turn must be at most {len(self.scales) - 4}, got {self.turn}"
            )
        if not 0 <= self.rounds <= _MOST_ROUNDS or (self.rounds != 1 and self.turn < 0):
            raise ParameterError(
                f"ArmFeatures.rounds must be 0 to {_MOST_ROUNDS}, and 1 where no turn is asked,"
                f" got {self.rounds}"
            )
        if not self.rounds and not has_spherical_wrist(self._arm):
            raise ParameterError(
                "ArmFeatures.rounds must be 1 or more for an arm without a spherical wrist, got"
                f" 0 for {self.arm}"
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
        pose = 0 if self.turn < 0 else 24 if self.rounds else 18
        return 5 * self._arm.n + 3 + pose

    def __str__(self) -> str:
        if self.turn < 0:
            return "inverse Jacobian's answers, sines and cosines, tool's place"
        way = f"{self.rounds} rounds of Newton's method" if self.rounds else "closed form"
        return (
            f"joint angles missing to the nearest configuration for the pose ({way}), finely"
            " and coarsely; inverse Jacobian's answer to the base's motion; sines and cosines;"
            " tool's place and axes, axes it is to have"
        )

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
            xp: namespace of sin, cos, sqrt, arctan2 and where.
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
        if self.turn < 0:
            J = [frame.moved(tool)[0] for frame in chain]
            joint_way, taken, pose, far = _damped(J, desired), _damped(J, carried), [], _FAR
        else:
            sines, cosine = part(self.turn, 3), part(self.turn + 3, 1)[0]
            missing = tuple(dot(axis, tuple(sines)) for axis in axes)
            J, has = self._moved(chain), self._axes(chain)
            asked = [_turned(missing, cosine, axis) for axis in has]
            place = add(tool, desired)
            left: list[Any] = []
            if self.rounds:
                joint_way, left = self._to_pose(q, place, asked, xp, clip)
            else:
                joint_way = shortest_way(self._arm, q, place, asked, xp, clip)
            taken = _damped(J, (*carried, *scale(_LEVER, turning)))
            pose, far = [*(k for axis in (*has, *asked) for k in axis), *left], _FURTHER
        return [
            *(clip(k, -_NEAR, _NEAR) * (1 / _NEAR) for k in joint_way),
            *(clip(k, -far, far) for k in joint_way),
            *(clip(k, -_FAST, _FAST) * (1 / _FAST) for k in taken),
            *(xp.sin(k) for k in q),
            *(xp.cos(k) for k in q),
            *tool,
            *pose,
        ]

    def _to_pose(
        self, q: list[Any], place: Any, asked: list[Any], xp: Any, clip: Callable[..., Any]
    ) -> tuple[list[Any], list[Any]]:
        """Joint angles that Newton's method gives for a pose, and what its last round lacked.

        Args:
            q: joint angles now [rad].
            place: of the tool in the base's axes [m].
            asked: axes that it is to have there.
            xp: namespace of sin and cos.
            clip: brings the first argument into the range of the others.
        """
        end = q
        for _ in range(self.rounds):
            chain = frames(self._arm, end, xp)
            gap = add(place, scale(-1.0, chain[-1].position))
            pairs = list(zip(self._axes(chain), asked, strict=True))
            sine = scale(0.5, add(*(cross(a, b) for a, b in pairs)))
            cosine = 0.5 * (sum(dot(a, b) for a, b in pairs) + -1.0)
            # twice the tangent of half the angle along the axis: the angle, where it is small
            turn = scale(2.0 / (cosine + (1.0 + _NO_AXIS)), sine)
            left = [*gap, *scale(_LEVER, turn)]
            step = _damped(self._moved(chain), left)
            end = [k + clip(way, -_STRIDE, _STRIDE) for k, way in zip(end, step, strict=True)]
        return [a - b for a, b in zip(end, q, strict=True)], left

    def _moved(self, chain: Sequence[Frame]) -> list[Any]:
        """Velocity of the tool, and `_LEVER` times its rate of turn, per joint rate (6)."""
        twists = [frame.moved(chain[-1].position) for frame in chain]
        return [(*way, *scale(_LEVER, turn)) for way, turn in twists]

    def _axes(self, chain: Sequence[Frame]) -> list[Any]:
        """Three axes of the tool in the base's."""
        columns = self._arm.tool_rotation.T.tolist()
        return [chain[-1].rotation.apply(tuple(k)) for k in columns]


def _turned(sines: Any, cosine: Any, axis: Any) -> Any:
    """Return an axis turned by an angle about another one (Rodrigues).

    Args:
        sines: the other one, times the angle's sine.
        cosine: of the angle.
        axis: to be turned.
    """
    along = dot(sines, axis) * (1.0 / (cosine + (1.0 + _LEAST)))
    return add(scale(cosine, axis), cross(sines, axis), scale(along, sines))


def _damped(J: Sequence[Any], v: Any) -> list[Any]:
    """Return J^T (J J^T + damping^2)^-1 v by elimination.

    Args:
        J: velocities of the tool (m), one per joint.
        v: (m) to be had.
    """
    m = len(v)
    square = (_DAMPING if m == 3 else _POSE_DAMPING) ** 2
    rows = [
        [sum(a[i] * a[k] for a in J) + (square if i == k else 0.0) for k in range(m)] + [v[i]]
        for i in range(m)
    ]
    for i in range(m):  # positive definite: no pivot is zero
        over = 1.0 / rows[i][i]
        rows[i] = [over * k for k in rows[i]]
        for r in range(i + 1, m):
            ahead = rows[r][i]
            rows[r] = [a - ahead * b for a, b in zip(rows[r], rows[i], strict=True)]
    load: list[Any] = []
    for row in reversed(rows):
        later = sum(a * b for a, b in zip(row[m - len(load) : m], load, strict=True))
        load.insert(0, row[m] - later)
    return [sum(a * b for a, b in zip(column, load, strict=True)) for column in J]


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
    closed = has_spherical_wrist(task.system.arm)
    rounds = 1 if "to_turn" not in at else 0 if closed else _ROUNDS
    return ArmFeatures(
        arm=task.system.arm.name,
        scales=tuple(np.concatenate(scales).tolist()),
        joint_angle=at["joint_angle"],
        base_pose=at["base_pose"],
        base_rate=at["base_rate"],
        target=at[way],
        tool=at["tool"] if way == "target" else -1,
        turn=at.get("to_turn", -1),
        rounds=rounds,
    )
