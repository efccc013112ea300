"""One planner interface: (system, start, goal, duration, seed) -> motion and prediction."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Protocol

import numpy as np
from threadpoolctl import ThreadpoolController

from ves_gym.core.arm import Arm
from ves_gym.core.motion import Motion, limit_ratios
from ves_gym.core.params import Array, ParameterError, Vector, finite, require_positive, unit
from ves_gym.core.servo import HIGH_GAINS, JointServo
from ves_gym.core.system import System
from ves_gym.planners.prediction import Prediction, predict


@dataclass(frozen=True, kw_only=True)
class Query:
    """From rest at `start` to rest at `goal` in `duration`, disturbing the base least."""

    system: System
    start: Vector = unit("rad")
    goal: Vector = unit("rad")
    duration: float = unit("s")
    v_max: Vector | None = unit("rad/s", default=None)  # speed limits, None = none
    servo: JointServo = HIGH_GAINS  # what will move the joints
    name: str = ""

    def __post_init__(self) -> None:
        require_positive(self, "duration")
        arm = self.system.arm
        for end in ("start", "goal"):
            arm.require_within_limits(getattr(self, end), end)
        if self.v_max is not None and not (finite(self.v_max, (arm.n,), "v_max") > 0).all():
            raise ParameterError(f"v_max must be > 0 rad/s, got {self.v_max}")
        if self.system.drive == "motor" and len(self.servo.kp) != arm.n:
            raise ParameterError(
                f"servo must have gains for {arm.n} joints, got {len(self.servo.kp)}"
            )

    @property
    def straight(self) -> Motion:
        """The straight quintic between the ends."""
        return Motion.straight(self.start, self.goal, self.duration)

    @property
    def ends(self) -> tuple[Array, Array]:
        """start and goal as arrays (n,)."""
        return np.array(self.start), np.array(self.goal)


@dataclass(frozen=True)
class Plan:
    """A planner's answer."""

    planner: str
    query: Query
    motion: Motion
    predicted: Prediction
    seconds: float  # planning time, prediction included
    feasible: bool  # inside the limits, see is_feasible
    info: dict[str, Any] = field(default_factory=dict)


class Planner(Protocol):
    """Finds a motion for a query. The same query and seed give the same motion."""

    name: str
    summary: str

    def find(self, query: Query, seed: int) -> tuple[Motion, dict[str, Any]]:
        """The motion, and anything worth telling about how it was found."""


def solve(planner: Planner, query: Query, seed: int = 0) -> Plan:
    """Run a planner on a query and predict the energy of what it found.

    Linear algebra runs on one thread meanwhile: its matrices are small, and a sum split
    over threads would make the last bits depend on the machine's load.
    """
    begin = time.perf_counter()
    with _threads().limit(limits=1, user_api="blas"):
        motion, info = planner.find(query, seed)
        predicted = predict(query.system, motion, query.servo)
    seconds = time.perf_counter() - begin
    return Plan(
        planner.name, query, motion, predicted, seconds, is_feasible(query, motion), info
    )


@cache
def _threads() -> ThreadpoolController:
    return ThreadpoolController()


def is_feasible(query: Query, motion: Motion) -> bool:
    """Whether a motion joins the query's ends inside its limits.

    Position and the query's speed limits; on motor drives also the joint torque.
    """
    arm: Arm = query.system.arm
    start, goal = query.ends
    joined = np.allclose(motion.start, start) and np.allclose(motion.goal, goal)
    ratios = limit_ratios(arm, motion)
    speed = 0.0
    if query.v_max is not None:
        speed = float((ratios["velocity"] * arm.column("v_max") / np.array(query.v_max)).max())
    slack = 1 + 1e-6
    torque = ratios["torque"].max() if query.system.drive == "motor" else 0.0
    in_time = math.isclose(motion.duration, query.duration)
    inside = max(ratios["position"].max(), speed, torque) <= slack
    return bool(joined and in_time and inside)
