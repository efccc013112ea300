"""Track *paths*: planners on reach100, the motions played again on the full system."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym._util.process_pool import Workers
from ves_gym.leaderboard import lower_bounds
from ves_gym.leaderboard.errors import BundleError, Code
from ves_gym.leaderboard.npy_io import pack, unpack
from ves_gym.leaderboard.protocol import (
    DURATIONS,
    LEDGER_PATHS,
    MODES,
    Problem,
    Seeds,
)
from ves_gym.leaderboard.tracks.base import (
    Answers,
    Case,
    Method,
    Progress,
    Row,
    no_progress,
    require_as_good,
    row,
)
from ves_gym.mechanics.motion import DEGREE, Motion
from ves_gym.mechanics.vehicle import get_vehicle
from ves_gym.planners.execution_check import executed_violation, solve_with_reserve
from ves_gym.planners.query import Plan, Planner, Query, first_violation, solve
from ves_gym.planners.registry import PLANNERS, get_planner
from ves_gym.planners.suites import reach100
from ves_gym.simulation.divergence import Divergence
from ves_gym.simulation.playback import play_motions
from ves_gym.system.energy import TAIL, Energies
from ves_gym.system.energy_balance import EnergyBalance
from ves_gym.system.system import System

_VEHICLE = "bent-thesis"
_RECORD = 12.5e-3  # s between records of a motion and its tail
_AT_ONCE = 25  # motions played together: their records fit the processor's cache
_SETTLE = 0.5  # s after a motion that its energy account covers
_MOST = 512  # control points of a motion


class PathTrack:
    """Planners on the queries of one duration, among obstacles or not.

    Score: E_mean over that of the straight line on the same query. A motion that breaks a
    limit or touches something as it is commanded is a failure, and is not played; nor is one an
    answer with which the arm, at any physics step, is too fast, misses or touches something.
    Built-in planners leave a reserve of the speed limits (`solve_with_reserve`) where they can.

    Args:
        workers: processes that plan.
        progress: called with the stage and the fraction done where a method runs again.
    """

    def __init__(self, workers: int = 1, progress: Progress = no_progress) -> None:
        self.workers, self.progress = workers, progress

    def payload(self, problem: Problem) -> str:
        """See `LeaderboardTrack`."""
        return "motions.npy"

    def system(self, problem: Problem) -> System:
        """See `LeaderboardTrack`."""
        return System(vehicle=get_vehicle(_VEHICLE))

    def queries(self, problem: Problem, seeds: Seeds) -> list[Query]:
        """The questions."""
        words = problem.base.split("-")
        suite = reach100(
            System(),
            _VEHICLE,
            problem.count,
            "on" if "obstacles" in words else "off",
            seed=seeds.root,
            durations=(DURATIONS[words[1]],),
        )
        return [query for _, query in suite.queries]

    def seed_list(self, problem: Problem, seeds: Seeds) -> list[int]:
        """See `LeaderboardTrack`."""
        return [seeds.root]

    def cases(self, problem: Problem, seeds: Seeds, method: Method, group: int) -> list[Case]:
        """See `LeaderboardTrack`. The seed is the planner's."""
        seed = method.seeds[group]
        return [Case(q.name, seed) for q in self.queries(problem, seeds)]

    def run(
        self,
        problem: Problem,
        seeds: Seeds,
        planner: Planner,
        method: Method,
        on_progress: Progress = no_progress,
    ) -> Answers:
        """Plan every query, with each of the method's seeds."""
        plans = self._plans(problem, seeds, planner, method, on_progress)
        motions = [plan.motion for plan in plans]
        effort = [_effort_of(plan) for plan in plans]
        rows = self._rows(problem, seeds, method, motions, effort)
        points = [np.array(m.control) for m in motions if m is not None]
        n = self.system(problem).arm.n
        packed = np.concatenate(points) if points else np.zeros((0, n))
        return Answers(rows, pack(packed), method)

    def replay(
        self, problem: Problem, seeds: Seeds, method: Method, rows: Sequence[Row], data: bytes
    ) -> list[Row]:
        """See `LeaderboardTrack`. What is told of the planning is taken over as it is."""
        effort = [{k: r.get(k) for k in ("seconds", "evaluations", "anytime")} for r in rows]
        motions = self._motions(problem, seeds, method, rows, data)
        return self._rows(problem, seeds, method, motions, effort)

    def require_possible(self, problem: Problem, seeds: Seeds, rows: Sequence[Row]) -> None:
        """See `LeaderboardTrack`."""
        queries = self.queries(problem, seeds)
        for k, result in enumerate(rows):
            query = queries[k % len(queries)]
            lower_bounds.require_energies(result)
            least = lower_bounds.path_floor(query.system, *query.ends, query.duration)
            lower_bounds.require_path(result, least)

    def reproduce(
        self,
        problem: Problem,
        seeds: Seeds,
        method: Method,
        members: Mapping[str, bytes],
        rows: Sequence[Row],
    ) -> list[Row]:
        """See `LeaderboardTrack`. Energies are compared, not motions."""
        if method.name not in PLANNERS:
            raise BundleError(Code.NOT_REPRODUCIBLE, f"no built-in planner {method.name!r:.80}")
        plans = self._plans(problem, seeds, get_planner(method.name), method, self.progress)
        mine = self._rows(
            problem, seeds, method, [p.motion for p in plans], [_effort_of(p) for p in plans]
        )
        require_as_good(rows, mine)
        return mine

    def _plans(
        self,
        problem: Problem,
        seeds: Seeds,
        planner: Planner,
        method: Method,
        on_progress: Progress = no_progress,
    ) -> list[Plan]:
        """Plans of every query with every seed, in order, whoever made them."""
        queries = self.queries(problem, seeds)
        jobs = [(planner, query, seed) for seed in method.seeds for query in queries]
        plans: list[Plan] = []
        with ExitStack() as stack:
            planned: Iterator[Plan] = map(_planned, jobs)
            if self.workers > 1:
                pool = stack.enter_context(Workers(self.workers))
                futures = [pool.submit(_planned, job) for job in jobs]
                planned = (future.result() for future in futures)
            for plan in planned:
                plans.append(plan)
                on_progress("planning", len(plans) / len(jobs))
        return plans

    # ---------------------------------------------------------------------- rows

    def _motions(
        self, problem: Problem, seeds: Seeds, method: Method, rows: Sequence[Row], data: bytes
    ) -> list[Motion | None]:
        """The motions of the rows; a row of length 0 has none."""
        queries = self.queries(problem, seeds)
        points = unpack(data, self.payload(problem), (None, queries[0].system.arm.n))
        lengths = [r["length"] for r in rows]
        if sum(lengths) != len(points):
            raise BundleError(
                Code.EPISODE_LENGTH,
                f"{len(points)} control points, the rows speak of {sum(lengths)}",
            )
        out: list[Motion | None] = []
        end = 0
        for k, length in enumerate(lengths):
            query = queries[k % len(queries)]
            part = points[end : end + length]
            end += length
            out.append(_motion(query, part) if length else None)
        return out

    def _rows(
        self,
        problem: Problem,
        seeds: Seeds,
        method: Method,
        motions: Sequence[Motion | None],
        efforts: Sequence[dict],
    ) -> list[Row]:
        queries = self.queries(problem, seeds)
        straight = _lines(problem, seeds)
        out: list[Row] = []
        for group in range(len(method.seeds)):
            part = slice(group * len(queries), (group + 1) * len(queries))
            played = _remembered(problem, seeds, motions[part])
            cases = self.cases(problem, seeds, method, group)
            for k, case in enumerate(cases):
                motion, energies_of, straight_line = motions[part][k], played[k], straight[k]
                score = None
                if (
                    energies_of is not None
                    and straight_line is not None
                    and straight_line.E_mean > 0
                ):
                    score = energies_of.E_mean / straight_line.E_mean
                result = row(
                    case,
                    group,
                    score=score,
                    success=score is not None,
                    failed=score is None,
                    energies={} if energies_of is None else energies_of.to_dict(),
                    length=0 if motion is None else len(motion.control),
                    **efforts[part][k],
                )
                out.append(result)
        return out


class _Asked(NamedTuple):
    """A motion that was an answer to a question."""

    problem: Problem
    seeds: Seeds
    question: int
    motion: Motion


# What was simulated last: a method that is run again gives the same motions, mostly.
_REMEMBERED: OrderedDict[_Asked, Energies | None] = OrderedDict()
_MOST_REMEMBERED = 4096


def _remembered(
    problem: Problem, seeds: Seeds, motions: Sequence[Motion | None]
) -> list[Energies | None]:
    """Energies of answers to all queries, None for what is none; each is simulated once."""
    queries = PathTrack().queries(problem, seeds)
    asked = [None if m is None else _Asked(problem, seeds, k, m) for k, m in enumerate(motions)]
    new = [
        a.motion
        if a is not None and a not in _REMEMBERED and first_violation(q, a.motion) is None
        else None
        for q, a in zip(queries, asked, strict=True)
    ]
    found = _played(queries, new)
    out: list[Energies | None] = []
    for a, energies_of in zip(asked, found, strict=True):
        if a is not None:
            _REMEMBERED.setdefault(a, energies_of)
            _REMEMBERED.move_to_end(a)
        out.append(None if a is None else _REMEMBERED[a])
    while len(_REMEMBERED) > _MOST_REMEMBERED:
        _REMEMBERED.popitem(last=False)
    return out


@lru_cache(maxsize=len(DURATIONS) * len(MODES))
def _lines(problem: Problem, seeds: Seeds) -> tuple[Energies | None, ...]:
    """Energies of the straight lines, the same for whoever is compared with them."""
    queries = PathTrack().queries(problem, seeds)
    return tuple(_played(queries, [q.straight for q in queries], account=False))


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


def _effort_of(plan: Plan) -> dict:
    """Return the seconds, evaluations and history of a plan."""
    evaluations = plan.info.get("evaluations")
    curve: list[list[float]] = []
    for seconds, _, cost in plan.info.get("curve") or ():
        if not curve or cost < curve[-1][1]:
            curve.append([float(seconds), float(cost)])
    return {
        "seconds": float(plan.seconds),
        "evaluations": None if evaluations is None else int(evaluations),
        "anytime": curve or None,
    }


def _motion(query: Query, control: Array) -> Motion:
    if not DEGREE + 1 <= len(control) <= _MOST:
        raise BundleError(
            Code.BAD_ACTION,
            f"{query.name}: a motion has {DEGREE + 1} to {_MOST} control points, got"
            f" {len(control)}",
        )
    points = tuple(tuple(p) for p in control.tolist())
    try:
        return Motion(duration=query.duration, control=points)
    except ParameterError as error:
        raise BundleError(Code.BAD_ACTION, f"{query.name}: {error}") from None


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
        if not relative <= LEDGER_PATHS:
            raise BundleError(
                Code.LEDGER_RESIDUAL,
                f"{queries[k].name}: {relative:.3g} of the work through the base port is"
                f" unaccounted for, at most {LEDGER_PATHS:g}",
            )
    return out
