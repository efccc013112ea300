"""`Query` and `Case`: one machine, its query or its motion, and its log's name.

A case is one TOML file. Every verb takes and writes it, so that a motion that was planned for
one machine is played on that one.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import (
    Array,
    ParameterError,
    Vector,
    finite,
    from_plain,
    integer,
    read_table,
    require_positive,
    require_types,
    to_plain,
    unit,
    write_table,
)
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.arm_library import arm_names, get_arm
from ves_gym.mechanics.kinematics import ToolPose
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.servo import OWN_SERVO, JointServo
from ves_gym.mechanics.vehicle import VEHICLES, vehicle_name
from ves_gym.planners.obstacles import Surroundings, read_surroundings
from ves_gym.planners.prediction import BaseState
from ves_gym.system.frequency_weight import FAST, FrequencyWeight
from ves_gym.system.system import System
from ves_gym.system.system_library import get_system

_OF_THE_CASE = ("system", "servo")  # of a query, and said once
# rad (m of joints that slide): beside the goal, from the end of a played motion on, and past
# the end of a range. Built-in planners miss by 0.0034 rad at most on reach100 (median 0.0005).
AIM = 0.005


@dataclass(frozen=True, kw_only=True)
class Query:
    """From `start` to rest at `goal` in `duration`, so that the base has least energy.

    Arm and base are at rest at the start unless `start_rate`, `start_acceleration` or `base`
    say how they move.
    """

    system: System
    start: Vector = unit("rad")
    goal: Vector = unit("rad")
    duration: float = unit("s")
    v_max: Vector | None = unit("rad/s", default=None)  # speed limits, None = none
    a_max: Vector | None = unit("rad/s^2", default=None)  # acceleration limits, None = none
    surroundings: Surroundings | None = None  # what not to touch, None = nothing is checked
    servo: JointServo = OWN_SERVO  # what will move the joints
    name: str = ""
    base: BaseState | None = None  # how the base moves at the start, None = at rest
    start_rate: Vector | None = unit("rad/s", default=None)  # of the joints, None = at rest
    start_acceleration: Vector | None = unit("rad/s^2", default=None)
    weight: FrequencyWeight = FAST  # filter of the measure `E_weighted`
    # joints (from 0) that may come to rest anywhere; `goal` is where a straight line takes them
    free_joints: tuple[int, ...] | None = None

    def __post_init__(self) -> None:
        require_positive(self, "duration")
        require_types(self, "system", "servo", "surroundings", "base")
        arm = self.system.arm
        arm.require_turning("a planner's query")
        for end in ("start", "goal"):
            arm.require_within_limits(getattr(self, end), end)
        for name, symbol in (("v_max", "rad/s"), ("a_max", "rad/s^2")):
            limit = getattr(self, name)
            if limit is not None and not (finite(limit, (arm.n,), name) > 0).all():
                raise ParameterError(f"{name} must be > 0 {symbol}, got {limit}")
        joints = self.free_joints or ()
        if len(set(joints)) < len(joints) or not set(joints) <= set(range(arm.n)):
            raise ParameterError(
                f"free_joints must be different ones of 0 to {arm.n - 1}, got {joints}"
            )
        for name in ("start_rate", "start_acceleration"):
            if getattr(self, name) is not None:
                finite(getattr(self, name), (arm.n,), name)
        if self.base is not None:
            self.base.stacked(self.system)
        if self.system.drive == "motor":
            servo = _of_arm(self.servo, self.system, self.base)
            object.__setattr__(self, "servo", servo)  # the class is frozen

    @property
    def straight(self) -> Motion:
        """The quintic between the ends: a straight line where the joints start at rest."""
        if not self.is_moving:
            return Motion.straight(self.start, self.goal, self.duration)
        return Motion.to_rest(self.start, *self.start_motion, self.goal, self.duration)

    @property
    def is_moving(self) -> bool:
        """True where the joints are not at rest at the start."""
        return any(k is not None and any(k) for k in (self.start_rate, self.start_acceleration))

    @property
    def is_loaded(self) -> bool:
        """True where limits hold for what the moving base makes of the joints' motion."""
        moves = self.base is not None or self.servo.holds(self.system.arm)
        return moves and self.system.drive == "motor"

    @property
    def start_motion(self) -> tuple[Array, Array]:
        """Rate and acceleration of the joints at the start (n,) [rad/s, rad/s^2]."""
        still = np.zeros(self.system.arm.n)
        rate, acceleration = (
            still if k is None else np.array(k)
            for k in (self.start_rate, self.start_acceleration)
        )
        return rate, acceleration

    @property
    def speed(self) -> Array:
        """Speed limits (n,) of the query, or of the arm where it has none [rad/s]."""
        return self.system.arm.column("v_max") if self.v_max is None else np.array(self.v_max)

    @property
    def ends_in_words(self) -> str:
        """Start, goal [deg] and duration as text."""
        start, goal = (
            "(" + ", ".join(f"{np.rad2deg(x) + 0.0:.4g}" for x in end) + ")"
            for end in (self.start, self.goal)
        )
        return f"{start} to {goal} deg in {self.duration:g} s"

    def __repr__(self) -> str:
        return f"<Query: {self.name or self.ends_in_words} on {self.system!r}>"

    def is_goal(self, q: Array) -> bool:
        """Return True where joints (n,) are at the goal, free ones anywhere."""
        bound = [i for i in range(len(self.goal)) if i not in (self.free_joints or ())]
        return bool(np.allclose(q[bound], np.array(self.goal)[bound]))

    @property
    def ends(self) -> tuple[Array, Array]:
        """start and goal as arrays (n,)."""
        return np.array(self.start), np.array(self.goal)


@dataclass(frozen=True, kw_only=True, repr=False)
class Case:
    """A system with a query, a motion or both: the motion then answers the query.

    `log` is the file that the run is recorded in, None where nothing says it.
    """

    system: System = field(default_factory=System)
    query: Query | None = None
    motion: Motion | None = None
    servo: JointServo = OWN_SERVO
    seed: int = 0
    log: str | None = None

    def __post_init__(self) -> None:
        require_types(self, "system", "query", "motion", "servo", "log")
        arm = self.system.arm
        object.__setattr__(self, "seed", integer(self.seed, "Case.seed"))
        if self.motion is not None and self.motion.n != arm.n:
            raise ParameterError(
                f"motion: {arm.name} has {arm.n} joints, got {self.motion.n} in the motion"
            )
        if self.system.drive == "motor":
            base = None if self.query is None else self.query.base
            servo = _of_arm(self.servo, self.system, base)
            object.__setattr__(self, "servo", servo)  # the class is frozen
        query = self.query
        if query is not None and (query.system != self.system or query.servo != self.servo):
            raise ParameterError("Case.query must be of the case's own system and servo")

    def __repr__(self) -> str:
        what = self.motion or self.query or "no motion"
        return f"<Case: {what!r} of {self.system!r}>"

    def to_dict(self) -> dict[str, Any]:
        """Return plain data, as written: arms and vehicles of the package by their names."""
        plain: dict[str, Any] = {"seed": self.seed}
        if self.log is not None:
            plain["log"] = self.log
        plain["system"] = _named(self.system)
        plain["servo"] = to_plain(self.servo)
        if self.query is not None:
            query = {k: v for k, v in to_plain(self.query).items() if k not in _OF_THE_CASE}
            query.setdefault("v_max", "none")
            if self.query.weight == FAST:
                del query["weight"]
            plain["query"] = query
        if self.motion is not None:
            plain["motion"] = to_plain(self.motion)
        return plain

    @staticmethod
    def from_dict(plain: Mapping[str, Any], where: str = "case", folder: Path = Path()) -> Case:
        """Rebuild a case from what `to_dict` gives; `where` is what messages call it.

        Arm, vehicle, system and surroundings may be names of files, relative to `folder`; a
        query without `v_max` keeps the arm's own speed limits.

        Raises:
            ParameterError: unknown keys, or values out of their ranges.
        """
        table = dict(plain)
        try:
            system = _read_system(table.get("system", {}), folder)
            table["system"] = to_plain(system)
            if isinstance(table.get("query"), Mapping):
                table["query"] = _read_query(table, system, folder)
            if isinstance(table.get("log"), str):
                table["log"] = str(folder / table["log"])
            case: Case = from_plain(Case, table, where)
        except ParameterError as error:
            message = str(error)
            raise ParameterError(
                message if message.startswith(where) else f"{where}: {message}"
            ) from None
        return case

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write as .toml or .json, completely or not at all; the log's name from its folder."""
        plain = self.to_dict()
        if self.log is not None:
            folder = Path(path).resolve().parent
            plain["log"] = Path(os.path.relpath(Path(self.log).resolve(), folder)).as_posix()
        write_table(path, plain)


def _of_arm(servo: JointServo, system: System, base: BaseState | None) -> JointServo:
    """A servo with the arm's gains; against a base that moves already motors cannot hold."""
    fitted = servo.for_arm(system.arm, system.vehicle)
    return fitted if base is None else replace(fitted, moving_base=False)


def whole_goal(arm: Arm, start: Any, goal: Any) -> tuple[Any, tuple[int, ...] | None]:
    """Return a goal of all joints, and those that it leaves free, None for none.

    Args:
        arm: one, or several side by side.
        start: (n,) [rad].
        goal: (n,) [rad], or of the last arm's joints alone, or a tool pose.
    """
    others = arm.spans[-1].start
    pose = isinstance(goal, ToolPose)
    if not others or not (pose or np.shape(goal) == (arm.n - others,)):
        return goal, None
    return goal if pose else (*start[:others], *goal), tuple(range(others))


def speed_limits(arm: Arm, v_max: npt.ArrayLike | None = None) -> Vector | None:
    """Return the speed limits of a query that `plan` makes, None for none.

    Args:
        arm: whose own limits hold unless others are given.
        v_max: (n,) [rad/s], "none" to lift them, None for those of the arm.
    """
    if isinstance(v_max, str):
        if v_max != "none":
            raise ParameterError(
                f"v_max must be {arm.n} numbers in rad/s, or none, got {v_max!r}"
            )
        return None
    limits = arm.column("v_max") if v_max is None else finite(v_max, (arm.n,), "v_max")
    return tuple(limits.tolist())


def load_case(path: str | os.PathLike[str]) -> Case:
    """Read a case from .toml or .json; file names in it are relative to its folder.

    Raises:
        ParameterError: unknown keys, or values out of their ranges.
    """
    return Case.from_dict(read_table(path), str(path), Path(path).parent)


def _named(system: System) -> dict[str, Any]:
    """A system as plain data, what comes with the package by its name."""
    plain = system.to_dict()
    if system.arm.name in arm_names() and get_arm(system.arm.name) == system.arm:
        plain["arm"] = system.arm.name
    if (name := vehicle_name(system.vehicle)) in VEHICLES:
        plain["vehicle"] = name
    return plain


def _read_system(value: Any, folder: Path) -> System:
    if isinstance(value, str):
        return get_system(_located(value, folder))
    if isinstance(value, Mapping):
        parts = {k: _located(value[k], folder) for k in ("arm", "vehicle") if k in value}
        value = {**value, **parts}
    return System.from_dict(value, "system")


def _read_query(table: Mapping[str, Any], system: System, folder: Path) -> dict[str, Any]:
    query = dict(table["query"])
    for key in _OF_THE_CASE:
        if key in query:
            raise ParameterError(f"query.{key} is said once, as {key} of the case")
        query[key] = table.get(key, to_plain(OWN_SERVO))
    limits = speed_limits(system.arm, query.pop("v_max", None))
    if limits is not None:
        query["v_max"] = list(limits)
    if isinstance(query.get("surroundings"), str):
        file = _located(query["surroundings"], folder)
        query["surroundings"] = to_plain(read_surroundings(file))
    return query


def _located(value: Any, folder: Path) -> Any:
    """The name of a file from the case's folder; names without a suffix as they are."""
    if isinstance(value, str) and Path(value.partition("#")[0]).suffix:
        return str(folder / value)
    return value
