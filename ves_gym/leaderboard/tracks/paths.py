"""Track *paths*: planners on reach100, the motions played again on the full system.

Score: E_mean over that of the straight line on the same query. A motion that breaks a limit or
touches something as it is commanded is a failure, and is not played; nor is one an answer with
which the arm, at any physics step, is too fast, misses or touches something, or whose energy
account stays open. Built-in planners leave a reserve of the speed limits
(`solve_with_reserve`) where they can.
"""

from __future__ import annotations

import os
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym._util.process_pool import Workers
from ves_gym.leaderboard.entry import Code, Refused, Results, refusing
from ves_gym.leaderboard.files import Recording
from ves_gym.leaderboard.problems import PATHS, THESIS, Problem, Seeds
from ves_gym.leaderboard.tracks.base import Answers, BoardTrack, Progress, no_progress
from ves_gym.mechanics.arm_library import get_arm
from ves_gym.mechanics.motion import DEGREE, Motion
from ves_gym.mechanics.servo import JointServo
from ves_gym.planners.bounds import NO_MORE
from ves_gym.planners.execution_check import executed_violation, solve_with_reserve
from ves_gym.planners.query import Plan, Planner, Query, first_violation, solve
from ves_gym.planners.registry import PLANNERS
from ves_gym.planners.suites import reach100, thesis
from ves_gym.simulation.machines import Divergence
from ves_gym.simulation.playback import play_motions
from ves_gym.system.energy import TAIL, Energies
from ves_gym.system.system import System

_RECORD = 12.5e-3  # s between records of a motion and its tail
_AT_ONCE = 25  # motions played together: their records fit the processor's cache
_MOST = 512  # control points of a motion
_ENERGIES = ("E_mean", "E_peak", "E_res")
_MEASURES = (*_ENERGIES, "acceleration")


class Played(NamedTuple):
    """Effect of a motion on its base."""

    energies: Energies
    peaks: tuple[float, float]  # of the mount's acceleration: m/s^2, rad/s^2


class PathTrack(BoardTrack):
    """Planners on queries of one vehicle and duration: control points, none of no motion."""

    def shape(self) -> tuple[int, ...]:
        return (path_queries(self.problem, self.seeds)[0].system.arm.n,)

    def answer(self, agents: Sequence[Planner], progress: Progress = no_progress) -> Answers:
        queries = path_queries(self.problem, self.seeds)
        jobs = [
            (planner, query, seed)
            for planner, seed in zip(agents, self.method.seeds, strict=True)
            for query in queries
        ]
        plans: list[Plan] = []
        with ExitStack() as stack:
            planned: Iterator[Plan] = map(_planned, jobs)
            if self.workers > 1:
                pool = stack.enter_context(Workers(self.workers))
                futures = [pool.submit(_planned, job) for job in jobs]
                planned = (future.result() for future in futures)
            for plan in planned:
                plans.append(plan)
                progress("planning", len(plans) / len(jobs))
        none = np.zeros((0, *self.shape()))
        points = [none if p.found is None else np.array(p.motion.control) for p in plans]
        groups = [points[k : k + len(queries)] for k in range(0, len(points), len(queries))]
        seconds = np.array([plan.seconds for plan in plans]).reshape(len(agents), -1)
        return Answers(groups, seconds)

    def replay(self, recording: Recording) -> Results:
        queries = path_queries(self.problem, self.seeds)
        lines = _lines(self.problem, self.seeds)
        calm = self.problem.base in PATHS and PATHS[self.problem.base].calm
        parts = []
        for group in recording:
            motions = [_motion(q, points) for q, points in zip(queries, group, strict=True)]
            playable = [
                m if m is not None and first_violation(q, m) is None else None
                for q, m in zip(queries, motions, strict=True)
            ]
            answers = _played(queries, playable)
            parts.append([_row(a, o, calm) for a, o in zip(answers, lines, strict=True)])
        return {
            name: np.array([[row[name] for row in part] for part in parts])
            for name in ("score", "success", *_MEASURES)
        }


def path_queries(problem: Problem, seeds: Seeds) -> list[Query]:
    """The questions of a problem of the track."""
    if problem.base == THESIS:
        return [query for _, query in thesis(System(), "bent").queries]
    settings = PATHS[problem.base]
    suite = reach100(
        System(arm=get_arm(settings.arm)),
        settings.vehicle,
        problem.count,
        "on" if settings.obstacles else "off",
        seed=seeds.root,
        durations=(settings.duration,),
    )
    return [query for _, query in suite.queries]


@lru_cache(maxsize=16)
def _lines(problem: Problem, seeds: Seeds) -> list[Played]:
    """Return the results of the straight lines, the same for all compared with them."""
    queries = path_queries(problem, seeds)
    lines = _played(queries, [q.straight for q in queries], judged=False)
    return [line for line in lines if line is not None]  # all of them: they are slow


def _row(answer: Played | None, line: Played, calm: bool) -> dict[str, float]:
    """Score, success and measures of one answer; infinite where there is none."""
    if answer is None:
        return {**dict.fromkeys(("score", *_MEASURES), np.inf), "success": 0.0}
    shaken = [a / b for a, b in zip(answer.peaks, line.peaks, strict=True)]
    well = not calm or max(shaken) <= NO_MORE
    energies = {name: getattr(answer.energies, name) for name in _ENERGIES}
    score = answer.energies.E_mean / line.energies.E_mean if well else np.inf
    return {"score": score, "success": float(well), **energies, "acceleration": shaken[0]}


def _planned(job: tuple[Planner, Query, int]) -> Plan:
    planner, query, seed = job
    begin = _processor_seconds()
    try:
        planned = solve_with_reserve if planner.name in PLANNERS else solve
        plan = planned(planner, query, seed)
    except ParameterError:
        raise
    except Exception as error:  # a planner that fails has no answer to this query
        plan = Plan(planner.name, query, None, 0.0, f"{type(error).__name__}: {error}")
    return replace(plan, seconds=_processor_seconds() - begin)


def _processor_seconds() -> float:
    """Time of this process and the programs it ran: a board is filled on a computer in use."""
    times = os.times()
    return time.process_time() + times.children_user + times.children_system


def _motion(query: Query, control: Array) -> Motion | None:
    """The motion of control points (k, n); none of no points."""
    if not len(control):
        return None
    if not DEGREE + 1 <= len(control) <= _MOST:
        raise Refused(
            Code.BAD_RECORDING,
            f"{query.name}: a motion has {DEGREE + 1} to {_MOST} control points, got"
            f" {len(control)}",
        )
    with refusing(Code.BAD_RECORDING):
        motion = Motion(duration=query.duration, control=tuple(map(tuple, control.tolist())))
    return motion


def _played(
    queries: Sequence[Query], motions: Sequence[Motion | None], judged: bool = True
) -> list[Played | None]:
    """Return the results of the motions, None where there is none or the arm fails to play it.

    With `judged` what the arm does at every physics step, and the energy account, decide.
    """
    alike: dict[tuple[System, JointServo, float], list[int]] = defaultdict(list)
    for k, (query, motion) in enumerate(zip(queries, motions, strict=True)):
        if motion is not None:
            alike[query.system, query.servo, query.duration].append(k)
    out: list[Played | None] = [None] * len(queries)
    for members in alike.values():
        for at in range(0, len(members), _AT_ONCE):
            part = members[at : at + _AT_ONCE]
            for k, played in zip(part, _batch(queries, motions, part, judged), strict=True):
                out[k] = played
    return out


def _batch(
    queries: Sequence[Query],
    motions: Sequence[Motion | None],
    which: Sequence[int],
    judged: bool,
) -> list[Played | None]:
    system, servo = queries[which[0]].system, queries[which[0]].servo
    moving = [m for k in which if (m := motions[k]) is not None]
    try:
        run = play_motions(
            system, moving, servo=servo, settle=TAIL, record_dt=_RECORD, watch=True
        )
    except Divergence:
        if len(which) == 1:
            return [None]
        return [_batch(queries, motions, [k], judged)[0] for k in which]
    out: list[Played | None] = []
    for i, (k, energies) in enumerate(zip(which, run.energies(), strict=True)):
        moved = run.disturbance(i)
        well = not judged or executed_violation(queries[k], run, i) is None
        peaks = moved.acceleration_peak, moved.angular_peak
        out.append(Played(energies, peaks) if well else None)
    return out
