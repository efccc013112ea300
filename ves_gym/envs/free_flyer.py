"""Reach a point fixed in space with an arm on a free-floating satellite."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ves_gym._util.params import Array, Mask, ParameterError, Vector, require_positive, unit
from ves_gym.envs.control import Acceleration, Control
from ves_gym.envs.joints import (
    REFERENCES,
    drawn_joints,
    home_of,
    joint_box,
    rate_fields,
    rates,
    require_control,
)
from ves_gym.envs.task import Field, Scene, Start, Task, register_task
from ves_gym.mechanics.kinematics import joint_positions
from ves_gym.mechanics.spatial import matvec, rotation
from ves_gym.mechanics.tool_pose import joints_for
from ves_gym.mechanics.vehicle import FREE_FLOATING
from ves_gym.system.system import System

_TRIES = 6  # candidate targets per episode; the first that is far enough counts


@register_task("free_flyer")
@dataclass(frozen=True, kw_only=True)
class FreeFlyerReach(Task):
    """Bring the tool to a point fixed in space, the satellite turning as little as it can.

    Nothing holds the base, so its momentum stays zero and it turns and shifts as the arm
    moves: the nominal 500 kg cube of `mechanics/vehicle.py` by up to 6 cm and 4 deg. Both the
    arm's start and the target, by forward kinematics on the base at rest, are drawn from
    `home` +- `span`; the elbow stays bent by 60 deg, so that the target is within reach
    however the base has moved. The target is `away` or more from the tool's start.

    Reward, minus means over the episode: `distance`, of tool from target in `far`; `energy`,
    of the base's kinetic energy E; `turn`, of the norm of its attitude. The weights bring each
    to 0.1 to 0.2 on a good motion (this project). An episode terminates at the deadline, or as
    a failure when the base turns by more than `tumble` or a joint limit is broken. Solved: for
    the last `hold` seconds the tool has been within `tolerance` of the target and no joint
    faster than `rest`.

    Measured, in space, 1000 starts of seed 0: the reference pulled to the inverse kinematics
    of the target as the base sees it solves 999 and returns -0.44; no motion returns -1.29,
    random actions -1.80. Learned policies: docs/training.md.
    """

    options: ClassVar[tuple[str, ...]] = ("q", "target")
    memory: ClassVar[int] = 2  # m from tool to target; s at rest on the target without a break
    compiled: ClassVar[bool] = True
    system: System = System(vehicle=FREE_FLOATING, physics_dt=2.5e-3)
    control: Control = Acceleration(a_max=(6.0, 6.0, 12.0))
    duration: float = unit("s", default=5.0)
    tail: float = unit("s", default=0.0)
    home: Vector = unit("rad", default=tuple(np.deg2rad([0.0, 30.0, -90.0]).tolist()))
    span: Vector = unit("rad", default=tuple(np.deg2rad([75.0, 35.0, 30.0]).tolist()))
    away: float = unit("m", default=0.3)  # least distance of a target from the tool's start
    tolerance: float = unit("m", default=0.02)
    rest: float = unit("rad/s", default=float(np.deg2rad(3.0)))  # of each joint
    hold: float = unit("s", default=0.25)
    tumble: float = unit("rad", default=float(np.deg2rad(30.0)))  # of any angle of attitude
    far: float = unit("m", default=0.5)  # distance that counts as one
    energy: float = unit("1/J", default=2.0)
    turn: float = unit("1/rad", default=3.0)

    @property
    def draws(self) -> int:  # type: ignore[override]
        """See `Task`."""
        return drawn_joints(self.system.arm) * (1 + _TRIES)

    def __post_init__(self) -> None:
        super().__post_init__()
        require_control(self, *REFERENCES, "torque")
        require_positive(self, "tolerance", "rest", "hold", "tumble", "far")
        require_positive(self, "away", "energy", "turn", zero=True)
        joint_box(self, self.home, self.span)

    def check_options(
        self, options: Mapping[str, Any] | None, extra: tuple[str, ...], rows: int | None = None
    ) -> dict[str, Any]:
        """See `Task`. The target must be within the arm's reach, base at rest."""
        out = super().check_options(options, extra, rows)
        if "target" in out:
            points = np.atleast_2d(out["target"])
            middle = np.tile(home_of(self.system.arm, self.home), (len(points), 1))
            _, miss = joints_for(self.system.arm, points, middle)
            worst = int(miss.argmax())
            if miss[worst] > self.tolerance:
                raise ParameterError(
                    "options['target'] must be a point in space within the tool's reach, got"
                    f" {points[worst].tolist()} m, which is {miss[worst]:.3g} m beyond"
                )
        return out

    def start(self, u: Array, **options: Array) -> Start:
        """See `Task`. Goal: the target."""
        n, k = self.system.arm.n, len(u)
        low, high = joint_box(self, self.home, self.span)
        drawn = low + (high - low) * u.reshape(k, 1 + _TRIES, -1)[..., :n]
        q = options.get("q", drawn[:, 0])
        tool = joint_positions(self.system.arm, q)[:, -1]
        points = joint_positions(self.system.arm, drawn[:, 1:])[..., -1, :]
        distance = np.linalg.norm(points - tool[:, None], axis=2)
        far = distance >= self.away
        pick = np.where(far.any(axis=1), far.argmax(axis=1), distance.argmax(axis=1))
        return Start(q, options.get("target", points[np.arange(k), pick]))

    def remember(self, s: Scene, dt: float) -> None:
        """See `Task`."""
        distance = np.linalg.norm(s.goal - s.tool, axis=1)
        there = (distance <= self.tolerance) & (np.abs(s.v) <= self.rest).all(axis=1)
        s.memory[:, 0] = distance
        s.memory[:, 1] = np.where(there, s.memory[:, 1] + dt, 0.0)

    def success(self, s: Scene) -> Mask:
        """The tool has come to stay."""
        settled: Mask = s.memory[:, 1] >= self.hold
        return settled

    def fields(self) -> tuple[Field, ...]:
        """See `Task`."""
        arm = self.system.arm
        return (
            Field("joint_angle", "rad", np.full(arm.n, np.pi / 2), "joint angles"),
            *rate_fields(self.control, arm),
            Field("base_pose", "m, rad", np.full(6, 0.1), "pose of the base as measured"),
            Field("base_rate", "m/s, rad/s", np.full(6, 0.1), "rate of the base as measured"),
            Field("to_target", "m", np.full(3, 0.5), "target less tool, in the base's axes"),
            Field("time_left", "s", np.array([self.duration]), "until the deadline"),
        )

    def observe(self, s: Scene) -> tuple[Array, ...]:
        """See `Task`."""
        to_base = np.swapaxes(rotation(s.y_seen), -1, -2)
        return (
            s.q,
            *rates(self.control, s),
            s.y_seen,
            s.yd_seen,
            matvec(to_base, s.goal - s.tool_seen),
            (self.duration - s.time)[:, None],
        )

    def reward(self, s: Scene, dt: float, last: Mask) -> dict[str, Array]:
        """See `Task`."""
        distance, share = s.memory[:, 0], dt / self.duration
        return {
            "distance": -share * distance / self.far,
            "energy": -share * self.energy * s.energy,
            "turn": -share * self.turn * np.linalg.norm(s.y[:, 3:], axis=1),
        }

    def failed(self, s: Scene) -> Mask:
        """The base has tumbled, or a joint limit is broken."""
        return super().failed(s) | (np.abs(s.y[:, 3:]) > self.tumble).any(axis=1)

    def marker(self, s: Scene) -> Array:
        """The target."""
        return s.goal[:, None]
