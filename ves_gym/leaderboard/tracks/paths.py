"""Track *paths*: planners on reach100, the motions played again on the full system.

Score: E_mean over that of the straight line on the same query. A motion that breaks a limit or
touches something as it is commanded is a failure, and is not played; nor is one an answer with
which the arm, at any physics step, is too fast, misses or touches something. Built-in planners
leave a reserve of the speed limits (`solve_with_reserve`) where they can.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import lru_cache

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym._util.process_pool import Workers
from ves_gym.leaderboard.entry import Code, Refused, Results, refusing
from ves_gym.leaderboard.files import Recording
from ves_gym.leaderboard.problems import DURATIONS, OBSTACLES, Problem, Seeds
from ves_gym.leaderboard.tracks.base import Answers, BoardTrack, Progress, no_progress
from ves_gym.mechanics.motion import DEGREE, Motion
from ves_gym.mechanics.servo import OWN_GAINS
from ves_gym.planners.execution_check import executed_violation, solve_with_reserve
from ves_gym.planners.query import Plan, Planner, Query, first_violation, solve
from ves_gym.planners.registry import PLANNERS
from ves_gym.planners.suites import reach100
from ves_gym.simulation.machines import Divergence
from ves_gym.simulation.playback import play_motions
from ves_gym.system.energy import TAIL, Energies
from ves_gym.system.energy_balance import EnergyBalance
from ves_gym.system.system import System

LEDGER = 1e-2  # residual over the work through the base port; measured 2e-4 at most
_RECORD = 12.5e-3  # s between records of a motion and its tail
_AT_ONCE = 25  # motions played together: their records fit the processor's cache
_SETTLE = 0.5  # s after a motion that its energy account covers
_MOST = 512  # control points of a motion
_MEASURES = ("E_mean", "E_peak", "E_res")


class PathTrack(BoardTrack):
    """Planners on queries of one vehicle and duration: control points, none of no motion."""

    def shape(self) -> tuple[int, ...]:
        return (System().arm.n,)

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
        points = [none if p.motion is None else np.array(p.motion.control) for p in plans]
        groups = [points[k : k + len(queries)] for k in range(0, len(points), len(queries))]
        seconds = np.array([plan.seconds for plan in plans]).reshape(len(agents), -1)
        return Answers(groups, seconds)

    def replay(self, recording: Recording) -> Results:
        queries = path_queries(self.problem, self.seeds)
        lines = _lines(self.problem, self.seeds)
        parts = []
        for group in recording:
            motions = [_motion(q, points) for q, points in zip(queries, group, strict=True)]
            playable = [
                m if m is not None and first_violation(q, m) is None else None
                for q, m in zip(queries, motions, strict=True)
            ]
            parts.append(_measured(_played(queries, playable)))
        out = {name: np.stack([part[name] for part in parts]) for name in _MEASURES}
        with np.errstate(invalid="ignore"):  # no answer, on a query without a straight line
            score = out["E_mean"] / lines
        score = np.where(np.isfinite(score), score, np.inf)
        return {"score": score, "success": np.isfinite(score).astype(float), **out}


def path_queries(problem: Problem, seeds: Seeds) -> list[Query]:
    """The questions of a problem of the track."""
    words = problem.base.removesuffix(OBSTACLES)
    vehicle, _, duration = words.rpartition("-")
    suite = reach100(
        System(),
        vehicle,
        problem.count,
        "on" if problem.base.endswith(OBSTACLES) else "off",
        seed=seeds.root,
        durations=(DURATIONS[duration],),
    )
    # the board's servo: it takes the base to stand still
    return [replace(query, servo=OWN_GAINS) for _, query in suite.queries]


@lru_cache(maxsize=16)
def _lines(problem: Problem, seeds: Seeds) -> Array:
    """(queries,) E_mean of the straight lines, the same for whoever is compared with them."""
    queries = path_queries(problem, seeds)
    played = _played(queries, [q.straight for q in queries], account=False)
    return _measured(played)["E_mean"]


def _measured(played: Sequence[Energies | None]) -> dict[str, Array]:
    """(queries,) of every measure, infinite where there is no answer."""
    plain = [{} if e is None else e.to_dict() for e in played]
    return {name: np.array([e.get(name, np.inf) for e in plain]) for name in _MEASURES}


def _planned(job: tuple[Planner, Query, int]) -> Plan:
    planner, query, seed = job
    try:
        if planner.name in PLANNERS:
            return solve_with_reserve(planner, query, seed)
        return solve(planner, query, seed)
    except ParameterError:
        raise
    except Exception as error:  # a planner that fails has no answer to this query
        return Plan(planner.name, query, None, None, 0.0, f"{type(error).__name__}: {error}")


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
    queries: Sequence[Query], motions: Sequence[Motion | None], account: bool = True
) -> list[Energies | None]:
    """Energies of the motions that there are, None where the arm does not do them.

    With `account` every physics step is looked at, and the energies must add up.
    """
    moving = [k for k, m in enumerate(motions) if m is not None]
    out: list[Energies | None] = [None] * len(queries)
    for at in range(0, len(moving), _AT_ONCE):
        part = moving[at : at + _AT_ONCE]
        for k, played in zip(part, _batch(queries, motions, part, account), strict=True):
            out[k] = played
    return out


def _batch(
    queries: Sequence[Query],
    motions: Sequence[Motion | None],
    which: Sequence[int],
    account: bool,
) -> list[Energies | None]:
    system, servo = queries[0].system, queries[0].servo
    moving = [m for k in which if (m := motions[k]) is not None]
    try:
        run = play_motions(system, moving, servo=servo, settle=TAIL, record_dt=_RECORD)
        done = _done(queries, moving, which) if account else [True] * len(moving)
    except Divergence:
        if len(which) == 1:
            return [None]
        return [_batch(queries, motions, [k], account)[0] for k in which]
    return [e if well else None for e, well in zip(run.energies(), done, strict=True)]


def _done(
    queries: Sequence[Query], motions: Sequence[Motion], which: Sequence[int]
) -> list[bool]:
    """Play motions with a record per physics step: True for each that the arm does.

    The energies must add up.
    """
    system, servo = queries[0].system, queries[0].servo
    dense = play_motions(
        system, motions, servo=servo, settle=_SETTLE, record_dt=system.physics_dt
    )
    out = []
    for i, k in enumerate(which):
        out.append(executed_violation(queries[k], dense, i) is None)
        relative = EnergyBalance.of(dense.log(i)).relative
        if not relative <= LEDGER:
            raise Refused(
                Code.LEDGER_RESIDUAL,
                f"{queries[k].name}: {relative:.3g} of the work through the base port is"
                f" unaccounted for, at most {LEDGER:g}",
            )
    return out
