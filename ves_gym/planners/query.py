"""One planner interface: (system, start, goal, duration, seed) -> motion and prediction."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np

from ves_gym._util.params import Array, ParameterError, integer
from ves_gym._util.threads import on_one_thread
from ves_gym._util.views import Viewable
from ves_gym.mechanics.dynamics import inverse_dynamics
from ves_gym.mechanics.limits import (
    LimitCheck,
    check_limits,
    check_reference,
    limits_of,
    middle_of_range,
)
from ves_gym.mechanics.motion import Motion
from ves_gym.planners.case import Case as Case
from ves_gym.planners.case import Query as Query
from ves_gym.planners.obstacles import RESOLUTION, collisions
from ves_gym.planners.prediction import (
    FINE,
    Prediction,
    joint_loads,
    predict,
)
from ves_gym.planners.unmodelled import notes

SCHEMA = "ves-plan/1"
_NO_SPEED = 1e9  # rad/s: as good as no limit


class Found(NamedTuple):
    """A motion that a planner found."""

    motion: Motion
    predicted: Prediction  # energies of it


@dataclass(frozen=True, repr=False)
class Plan(Viewable):
    """A planner's answer: a motion, or the reason why there is none."""

    planner: str
    query: Query
    found: Found | None
    seconds: float  # planning time, prediction included
    failure: str | None = None  # why there is no motion, or what limit it breaks
    info: dict[str, Any] = field(default_factory=dict)
    seed: int = 0

    @property
    def motion(self) -> Motion:
        """The motion; NoPlan is raised where there is none."""
        return self._answer.motion

    @property
    def predicted(self) -> Prediction:
        """Energies of the motion; NoPlan is raised where there is none."""
        return self._answer.predicted

    @property
    def _answer(self) -> Found:
        if self.found is None:
            raise NoPlan(f"{self.planner} found no motion: {self.failure}")
        return self.found

    @property
    def case(self) -> Case:
        """Query and motion, to be saved, played and repeated."""
        q, motion = self.query, self.found and self.found.motion
        return Case(system=q.system, query=q, motion=motion, servo=q.servo, seed=self.seed)

    @property
    def feasible(self) -> bool:
        """True if there is a motion, inside the limits and clear of everything."""
        return self.failure is None

    @cached_property
    def reference(self) -> LimitCheck | None:
        """The motion against the limits of arm and query; None without a motion."""
        if self.found is None:
            return None
        return check_motion(self.query, self.motion, limits_of_query(self.query))

    @property
    def notes(self) -> tuple[str, ...]:
        """Return parts of the machine that the plan ignores, a sentence each."""
        return notes(self.query, self.found and self.found.motion)

    def __repr__(self) -> str:
        if self.found is None:
            return f"<Plan: {self.planner}, no motion: {self.failure}>"
        verdict = f"NOT feasible: {self.failure}"
        if self.feasible and self.reference is not None:
            verdict = self.reference.brief("reference")
        return (
            f"<Plan: {self.planner}, {self.query.duration:g} s, E_mean"
            f" {self.predicted.E_mean:.4g} J predicted; {verdict}>"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return plain data, the case included."""
        return {
            "schema": SCHEMA,
            "planner": self.planner,
            "case": self.case.to_dict(),
            "predicted": self.found and self.predicted.to_dict(),
            "seconds": self.seconds,
            "feasible": self.feasible,
            "failure": self.failure,
            "notes": list(self.notes),
            "info": self.info,
        }


class NoPlan(ParameterError):
    """A planner found no motion; the message says why."""


class Planner(Protocol):
    """Finds a motion for a query. The same query and seed give the same motion."""

    @property
    def name(self) -> str:
        """Name in the registry and on the command line."""

    @property
    def summary(self) -> str:
        """Description of the method in one sentence."""

    def find(self, query: Query, seed: int) -> tuple[Motion, dict[str, Any]]:
        """Find a motion, and anything worth reporting about the search.

        Args:
            query: the ends, the duration and limits.
            seed: of whatever is random, >= 0.

        Returns:
            The motion, and plain data for `Plan.info`; `unmet` in it says why the motion is
            no answer by a rule of the planner's own.

        Raises:
            NoPlan: there is none, or none was found.
        """


def solve(planner: Planner, query: Query, seed: int = 0) -> Plan:
    """Run a planner on a query and predict the energy of its motion.

    Linear algebra runs on one thread meanwhile: its matrices are small, and a sum split
    over threads would make the last bits depend on the machine's load.

    Raises:
        ParameterError: a negative seed.
    """
    seed = integer(seed, "seed")
    begin = time.perf_counter()
    answer = None
    info: dict[str, Any] = {}
    with on_one_thread():
        try:
            returned = planner.find(query, seed)
        except NoPlan as error:
            failure: str | None = str(error)
        else:
            if not (isinstance(returned, tuple) and isinstance(returned[0], Motion)):
                what = f"find of planner {planner.name} must return (motion, info)"
                raise TypeError(f"{what}, got {type(returned).__name__}")
            motion, info = returned
            if query.free_joints:  # the answer is to the ends that it chose
                query = replace(query, goal=motion.control[-1])
            predicted = predict(query.system, motion, query.servo, base=query.base, parts=FINE)
            answer = Found(motion, predicted)
            failure = first_violation(query, motion) or info.get("unmet")
    seconds = time.perf_counter() - begin
    return Plan(planner.name, query, answer, seconds, failure, info, seed)


def first_violation(query: Query, motion: Motion) -> str | None:
    """Name the first limit that keeps a motion from being an answer to a query, if any.

    Ends, duration, position, the query's speed and acceleration limits, on motor drives the
    joint torque, and collisions at four times the planning resolution.
    """
    if not (np.allclose(motion.start, query.start) and query.is_goal(motion.goal)):
        return "the motion does not join the ends of the query"
    if not math.isclose(motion.duration, query.duration):
        return f"the motion takes {motion.duration:g} s, asked {query.duration:g} s"
    if query.is_moving or motion.moving:
        begin = motion.at([0.0])
        if not all(map(np.allclose, (begin.v[0], begin.a[0]), query.start_motion)):
            return "the joints do not move at the start as the query says"
    broken = check_motion(query, motion, answer_limits(query)).broken
    if broken:
        return broken[0].short
    return _touched(query, motion)


def min_duration(query: Query, motion: Motion) -> float:
    """Return how long a motion's way and timing must take to keep speed and torque limits [s].

    From rest to rest on a base at rest nothing weighs on the joints: played k times slower,
    rates are a k-th, accelerations and torques a k^2-th.
    """
    limits = answer_limits(query)
    orders = {"velocity": 1.0, "acceleration": 0.5, "torque": 0.5}
    extremes = check_motion(query, motion, limits).extremes
    slower = [e.ratio ** orders[e.kind] for e in extremes if e.kind in orders]
    return motion.duration * max(slower, default=0.0)


def answer_limits(query: Query) -> dict[str, Array]:
    """Return what the joints of an answer may do: speeds as the query says, see `limits_of`."""
    limits = limits_of_query(query)
    if query.v_max is None:
        del limits["velocity"]  # an answer may be faster than the arm: the question says so
    else:
        limits["velocity"] = np.array(query.v_max)
    return limits


def check_motion(query: Query, motion: Motion, limits: Mapping[str, Array]) -> LimitCheck:
    """Check a motion as it is commanded, or as a moving base lets the joints follow it.

    With a base that moves at the start, and on a servo that is fed forward against the base,
    angles, rates and torques are those that the linear base makes of them. `limits`: see
    `limits_of`.
    """
    arm = query.system.arm
    if not query.is_loaded:
        return check_reference(arm, motion, limits)
    loads = joint_loads(query.system, motion, query.servo, query.base)
    s = motion.at(loads.t)
    torque = inverse_dynamics(arm, s.q, s.v, s.a)[0] + loads.torque
    if query.servo.holds(arm):  # the joints are where they are told to be
        others = {kind: limit for kind, limit in limits.items() if kind != "torque"}
        sent = check_limits({"torque": limits["torque"]}, s.t, {"torque": torque})
        return LimitCheck((*check_reference(arm, motion, others).extremes, *sent.extremes))
    values = {
        "position": s.q + loads.away - middle_of_range(arm),
        "velocity": s.v + loads.rate,
        "acceleration": s.a,
        "torque": torque,
    }
    return check_limits(limits, s.t, values)


def limits_of_query(query: Query) -> dict[str, Array]:
    """Return what joints may do: the limits of the arm and of the query, see `limits_of`."""
    return limits_of(
        query.system.arm,
        v_max=query.v_max,
        a_max=query.a_max,
        motor=query.system.drive == "motor",
    )


def _touched(query: Query, motion: Motion) -> str | None:
    if query.surroundings is None:
        return None
    checker = collisions(query.system.ideal(), query.surroundings)
    path = sample_path(motion, RESOLUTION / 4)
    k = checker.first_contact(path)
    return None if k is None else f"too near: {', '.join(checker.contact_names(path[k]))}"


def sample_path(motion: Motion, step: float) -> Array:
    """Configurations (N, n) [rad] along a motion, at most `step` [rad] apart in joint space."""
    q = motion.at(np.linspace(0, motion.duration, 4001)).q
    length = np.r_[0, np.cumsum(np.linalg.norm(np.diff(q, axis=0), axis=1))]
    count = max(2, 2 + int(length[-1] / (0.9 * step)))
    at = np.searchsorted(length, np.linspace(0, length[-1], count))
    return np.asarray(q[np.unique(np.minimum(at, len(q) - 1))])


def require_time(query: Query) -> None:
    """Raise NoPlan where a joint cannot cover its way within speed and acceleration limits."""
    start, goal = query.ends
    way = np.abs(goal - start)
    v = _NO_SPEED if query.v_max is None else np.array(query.v_max)
    a = _NO_SPEED**2 if query.a_max is None or query.is_moving else np.array(query.a_max)
    # from rest to rest: up to the speed limit, or half-way, and down again
    least = np.where(way * a > v**2, way / v + v / a, 2 * np.sqrt(way / a))
    if least.max() > query.duration:
        j = int(least.argmax())
        limits = "speed limit" if query.a_max is None else "limits of speed and acceleration"
        raise NoPlan(
            f"no motion: joint {j + 1} needs {least[j]:.3g} s at its {limits}, there are"
            f" {query.duration:g} s for the motion"
        )


def require_possible(query: Query) -> None:
    """Raise NoPlan where the ends alone rule a motion out: too far, or too near something."""
    require_time(query)
    start, goal = query.ends
    if query.surroundings is None:
        return
    checker = collisions(query.system.ideal(), query.surroundings)
    for name, q in (("start", start), ("goal", goal)):
        if not checker.is_clear(q):
            raise NoPlan(
                f"no motion: the {name} is too near: {', '.join(checker.contact_names(q))}"
            )
