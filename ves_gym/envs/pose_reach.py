"""Bring the tool to a pose in space, place and orientation, with six joints or more."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from ves_gym._util.params import Array, Mask, ParameterError, Vector, unit
from ves_gym.envs.arm_task import ArmTask, gap, straight_pace
from ves_gym.envs.control import Control, JointVelocity
from ves_gym.envs.reach import reachable
from ves_gym.envs.task import Field, Scene, Start, register_task
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.arm_library import get_arm
from ves_gym.mechanics.kinematics import ToolPose, pose_dexterity, tool_frame, tool_speeds
from ves_gym.mechanics.spatial import rotation, twist
from ves_gym.mechanics.tool_pose import configurations_at
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.system.system import System

_TRIES = 16  # candidate poses per episode; the first that is near and dexterous counts
_LEVER = 0.3  # m per radian: how far an orientation counts beside a place in `dexterous`
_JOINTS = 6  # fewer cannot choose place and orientation
_PLACE, _TURN, _ENERGY = slice(0, 3), slice(3, 12), 12  # columns of the goal


@register_task("pose_reach")
class PoseReach(ArmTask):
    """Bring the tool to a pose in space, place and orientation, and hold it there at rest.

    For arms of six joints or more (`arm=`; here the PUMA 560 with its wrist); a seventh joint
    can spare the base. The pose is that of joint angles drawn in the box `span` around zero. A
    straight quintic must reach them in half the time within the speed limits, and they must be
    `dexterous`, so that the pose stays within reach while the base sways. Where no draw
    satisfies that, they are drawn nearer to the start. Solved: for the last `hold` seconds the
    tool has been within `tolerance` of the place and within `turned` of the orientation, and
    slower than `rest` and `turning`.

    Cost:

    - What is missing at the end to the place and, with the weight `attitude`, to the
      orientation (`arm_task.gap`, of a distance and of the sine of half an angle).
    - `thrift` times E_mean over that expected of the straight motion in half the time
      (`scales.straight_energy`), at least a quarter of its median.

    The controller `resolved-pose` solves 96 to 100 of 100 starts with the PUMA, the iiwa14 and
    the UR5e, in space and in the laboratory.
    """

    options: ClassVar[tuple[str, ...]] = ("q", "pose")
    memory: ClassVar[int] = 3  # m to the place; sine of half the angle; s there at rest
    compiled: ClassVar[bool] = True
    rows: ClassVar[int] = 1 + _TRIES
    positive: ClassVar[tuple[str, ...]] = (
        "dexterous", "tolerance", "turned", "hold", "far", "rest", "turning",
    )  # fmt: skip
    not_negative: ClassVar[tuple[str, ...]] = ("attitude", "thrift")
    system: System = System(
        arm=get_arm("puma560-wrist"), vehicle=BENT_THESIS, physics_dt=2.5e-3
    )
    control: Control = JointVelocity()
    duration: float = unit("s", default=5.0)
    span: Vector = unit(
        "rad", default=tuple(np.deg2rad([120.0, 60.0, 120.0, 90.0, 80.0, 120.0]).tolist())
    )
    dexterous: float = unit("m/rad", default=0.03)  # least `tool_pose.pose_dexterity`
    tolerance: float = unit("m", default=0.01)
    turned: float = unit("rad", default=float(np.deg2rad(3.0)))
    rest: float = unit("m/s", default=0.03)  # of the tool in space
    turning: float = unit("rad/s", default=0.1)
    hold: float = unit("s", default=0.5)
    far: float = unit("m", default=1.0)  # distance that counts as one
    attitude: float = unit("1", default=1.0)
    thrift: float = unit("1", default=0.01)

    def __post_init__(self) -> None:
        super().__post_init__()
        arm = self.system.arm
        if arm.n < _JOINTS:
            raise ParameterError(
                f"pose_reach needs an arm of {_JOINTS} joints or more to choose place and"
                f" orientation, got {arm.name} with {arm.n} (task reach asks for places)"
            )

    # ------------------------------------------------------------------ episodes

    def check_options(
        self, options: Mapping[str, Any] | None, extra: tuple[str, ...], rows: int | None = None
    ) -> dict[str, Any]:
        """See `Task`. The pose must be within reach, base at rest."""
        out, arm = super().check_options(options, extra, rows), self.system.arm
        for row in np.atleast_2d(out.get("pose", np.empty((0, 6)))):
            if not len(configurations_at(arm, _pose(row))):
                raise ParameterError(
                    "options['pose'] must be a pose in space (m, Z-Y-X angles in rad) that the"
                    f" tool of {arm.name} reaches, got {row.tolist()}: no configuration was"
                    " found for it"
                )
        return out

    def start(self, u: Array, **options: Array) -> Start:
        """See `Task`. Goal: the place [m], the rotation by rows, the energy that is one [J]."""
        arm = self.system.arm
        q, end = self.places(u, options.get("q"))
        if "pose" in options:
            solutions = [
                configurations_at(arm, _pose(row), near=near)[0]
                for row, near in zip(options["pose"], q, strict=True)
            ]
            end = np.array(solutions)
        place, turn = tool_frame(arm, end)
        return Start(q, np.column_stack([place, turn.reshape(-1, 9), self.scale_of(q, end)]))

    def places(self, u: Array, q: Array | None = None) -> tuple[Array, ...]:
        arm, half, drawn = self.system.arm, self.duration / 2, self.angles(u)
        q = drawn[:, 0] if q is None else q
        end = reachable(arm, q, drawn[:, 1:], half, self.dexterous, measure=_dexterity)
        nearer = 1 / np.maximum(straight_pace(arm, end - q, half), 1.0)
        return q, q + nearer[:, None] * (end - q)

    def remember(self, s: Scene, dt: float) -> None:
        missing = s.goal[:, _TURN] - _turn(self, s, s.y).reshape(-1, 9)
        distance = np.sqrt(((s.goal[:, _PLACE] - s.tool) ** 2).sum(axis=1))
        # two rotations an angle apart differ by 2 sqrt(2) sin(angle / 2) in Frobenius's norm
        half = np.sqrt((missing**2).sum(axis=1) / 8)
        there = (distance <= self.tolerance) & (half <= np.sin(self.turned / 2))
        speeds = tool_speeds(self.system.arm, s.q, s.v, twist(s.y, s.yd))
        there = there & (speeds[:, 0] <= self.rest**2) & (speeds[:, 1] <= self.turning**2)
        s.memory[:, 0] = distance
        s.memory[:, 1] = half
        s.memory[:, 2] = np.where(there, s.memory[:, 2] + dt, 0.0)

    def success(self, s: Scene) -> Mask:
        """(n,) whether the tool has come to stay."""
        return s.memory[:, 2] >= self.hold

    # --------------------------------------------------------------- observation

    def fields(self) -> tuple[Field, ...]:
        return (
            *self.sensed(),
            self.time_left,
            Field("to_target", "m", np.full(3, self.far / 2), "target less tool as measured"),
            Field(
                "to_turn", "1", np.ones(3), "axis of the turn that is missing, times its sine"
            ),
            Field("turn_cosine", "1", np.ones(1), "cosine of the angle that is missing"),
            Field("energy_scale", "1", np.array([2.0]), "decimal logarithm of the scale in J"),
        )

    def observe(self, s: Scene) -> tuple[Array, ...]:
        goal = s.goal[:, _TURN].reshape(-1, 3, 3)
        turn = goal @ np.swapaxes(_turn(self, s, s.y_seen), -1, -2)
        pairs = ((2, 1), (0, 2), (1, 0))
        sine = np.stack([turn[:, i, j] - turn[:, j, i] for i, j in pairs], axis=1) / 2
        cosine = (turn[:, 0, 0] + turn[:, 1, 1] + turn[:, 2, 2] - 1) / 2
        return (
            *self.sense(s),
            self.left(s),
            s.goal[:, _PLACE] - s.tool_seen,
            sine,
            cosine[:, None],
            np.log10(s.goal[:, _ENERGY:]),
        )

    # -------------------------------------------------------------------- reward

    def costs(self, s: Scene, dt: float, last: Mask) -> dict[str, Array]:
        return self.energy_costs(s, dt, s.goal[:, _ENERGY])

    def missing(self, s: Scene) -> Array | None:
        distance = gap(s.memory[:, 0], self.tolerance, self.far)
        turn = gap(s.memory[:, 1], np.sin(self.turned / 2), 1.0)
        return (distance + self.attitude * turn) / (1.0 + self.attitude)

    def marker(self, s: Scene) -> Array:
        """The place, then a line from it along the axis that the tool is to point along."""
        place, turn = goal_pose(s)
        return np.stack([place, place, place + _ARROW * turn[..., 2]], axis=1)


_ARROW = 0.15  # m


def goal_pose(s: Scene) -> tuple[Array, Array]:
    """Place (n, 3) [m] and rotation (n, 3, 3) that the tool is to have in space."""
    return s.goal[:, _PLACE], s.goal[:, _TURN].reshape(-1, 3, 3)


def _turn(task: PoseReach, s: Scene, y: Array) -> Array:
    """(n, 3, 3) from the tool's axes to those of space, the base at y."""
    return rotation(y) @ tool_frame(task.system.arm, s.q)[1]


def _dexterity(arm: Arm, q: Array) -> Array:
    """(...,) in place and orientation at angles (..., joints) [m/rad]."""
    return pose_dexterity(arm, q, _LEVER)


def _pose(row: Array) -> ToolPose:
    """A pose of six numbers, m and rad."""
    return ToolPose(position=tuple(row[:3].tolist()), angles=tuple(row[3:].tolist()))
