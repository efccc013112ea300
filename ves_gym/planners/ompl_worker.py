"""One OMPL search, in a process of its own: `ompl_search` starts it and may kill it.

OMPL is C++ with Python callbacks: a planner can crash, hang, hold the interpreter's lock or
outlast its time limit. Here it harms nobody. Requests come on standard input, answers go out
on standard output, one pickle each.
"""

from __future__ import annotations

import math
import os
import signal
import time
from collections.abc import Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

import numpy as np

from ves_gym._util.params import Array
from ves_gym.mechanics.motion import Motion
from ves_gym.planners.obstacles import RESOLUTION, collisions
from ves_gym.planners.query import Query
from ves_gym.planners.search_costs import cost_of

CHECKPOINTS = 20  # of the anytime curve
_CHECKS = 5  # validity checks allowed per cost evaluation of the budget
_GUESSES = 20  # lower bounds likewise
_SEARCHED = 0.5  # of the budget, where the rest goes to relaxing what the search found
_PROVEN = 1 + 1e-9  # times the lower bound: a cost that cannot be improved
_SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)  # of the way from the straight line that are judged
_ORPHAN = 60.0  # s beyond its time after which a search that nobody kills ends by itself
_OVERRUN = 1.5  # of the budget, after which a planner that does not stop is stopped

# OMPL's classes that take a cost written in Python, by name here. Measured on 2.0.1: PRM,
# PRM* hang on such a cost; AORRTC and RRTConnect never ask for it; FMT* and BFMT* do not
# stop in time and cannot go on.
ALGORITHMS = {
    "rrtstar": "RRTstar",
    "informed-rrtstar": "InformedRRTstar",
    "sorrtstar": "SORRTstar",
    "bitstar": "BITstar",
}


@dataclass(frozen=True, kw_only=True)
class Request:
    """One search. The same request gives the same path while `seconds` is not reached."""

    query: Query
    objective: str  # q, qt, time or energy
    algorithm: str  # of ALGORITHMS
    seed: int
    evaluations: int  # of edge costs
    seconds: float
    relax: bool = True  # what the search finds, in the same budget; never objective time


class Point(NamedTuple):
    """The best of a search at a moment."""

    seconds: float
    evaluations: int
    cost: float  # coupling length [J^(1/2)], time [s], or predicted E_mean [J]


@dataclass(frozen=True)
class PathSearchResult:
    """The best path of a search, its cost and the effort."""

    path: Array | None  # (k, n) way-points
    cost: float
    curve: tuple[Point, ...]  # anytime
    evaluations: int
    checks: int  # of validity
    bound: float = 0.0  # no path costs less; E_mean has no such bound
    searched: float = math.nan  # cost before relaxation
    motion: Motion | None = None  # along the path, where its timing was relaxed as well


class BadCost(Exception):
    """A cost that OMPL cannot take: it crashes on negative ones and returns NaN as exact."""


class _BudgetSpent(Exception):
    """The budget is used up and the planner does not stop."""


def serve() -> None:
    """Answer requests until standard input ends."""
    requests = Connection(os.dup(0), writable=False)
    answers = Connection(os.dup(1), readable=False)
    os.dup2(2, 1)  # what OMPL prints is not an answer
    answers.send("ready")
    while True:
        try:
            request = requests.recv()
        except EOFError:
            return
        signal.alarm(math.ceil(min(request.seconds + _ORPHAN, 1e9)))
        try:
            answer: PathSearchResult | str = search(request)
        except Exception as error:  # all of it is the parent's to report
            answer = f"{type(error).__name__}: {error}"
        signal.alarm(0)
        answers.send(answer)


def search(request: Request) -> PathSearchResult:
    """Run OMPL on a request."""
    from ompl import base as ob
    from ompl import geometric as og
    from ompl import util as ou

    ou.setLogLevel(ou.LOG_NONE)
    ou.RNG.setSeed(request.seed + 1)  # zero would mean a random seed
    run = _Search(request)
    space = run.space(ob)
    information = ob.SpaceInformation(space)
    validity, objective = run.validity(ob, information), run.objective(ob, information)
    information.setStateValidityChecker(validity)
    information.setStateValidityCheckingResolution(RESOLUTION / space.getMaximumExtent())
    information.setup()
    problem = ob.ProblemDefinition(information)
    ends = [space.allocState() for _ in range(2)]
    for state, q in zip(ends, request.query.ends, strict=True):
        for i, angle in enumerate(q):
            state[i] = float(angle)
    problem.setStartAndGoalStates(*ends)
    problem.setOptimizationObjective(objective)
    planner = getattr(og, ALGORITHMS[request.algorithm])(information)
    planner.setProblemDefinition(problem)
    planner.setup()
    for k in range(CHECKPOINTS):
        run.share = run.searched * (k + 1) / CHECKPOINTS
        try:
            planner.solve(ob.PlannerTerminationCondition(run.enough))
        except _BudgetSpent:
            run.share = run.searched
        if problem.hasExactSolution():
            path = problem.getSolutionPath()
            states = (path.getState(i) for i in range(path.getStateCount()))
            run.consider(np.array([[s[j] for j in range(run.n)] for s in states]))
        if run.over:
            break
    run.relax()
    return run.result()


class _Search:
    """Budget, costs and the best path of one request."""

    def __init__(self, request: Request) -> None:
        query = request.query
        self.request, self.n = request, query.system.arm.n
        self.cost = cost_of(query, request.objective)
        self.shares = _SHARES if request.objective == "energy" else (1.0,)
        self.begin = time.perf_counter()
        self.share = 0.0  # of the budget that may be used now
        self.evaluations = self.checks = self.guesses = 0
        # breaks limits, cost, path, motion if that was relaxed as well
        self.best: tuple[bool, float, Array, Motion | None] | None = None
        self.paths: list[Array] = []  # as the search found them, latest last
        self.curve: list[Point] = []
        relaxes = request.relax and self.cost.relaxes
        self.searched = _SEARCHED if relaxes else 1.0
        self.cost_searched = math.nan
        self.bound = self.cost.floor()

    @property
    def used(self) -> float:
        """Share of the budget used up; alike on every machine until the time is up."""
        request = self.request
        late = time.perf_counter() - self.begin > request.seconds
        return math.inf if late else self._work / request.evaluations

    @property
    def _work(self) -> float:
        """Effort in cost evaluations."""
        return max(self.evaluations, self.checks / _CHECKS, self.guesses / _GUESSES)

    @property
    def over(self) -> bool:
        return self.share >= self.searched or self.used >= self.searched or self._proven

    @property
    def _proven(self) -> bool:
        return self.best is not None and self.best[1] <= _PROVEN * self.bound

    def enough(self) -> bool:
        return self.used >= self.share

    def space(self, ob: Any) -> Any:
        space, bounds = ob.RealVectorStateSpace(self.n), ob.RealVectorBounds(self.n)
        for i, link in enumerate(self.request.query.system.arm.links):
            bounds.setLow(i, link.q_min)
            bounds.setHigh(i, link.q_max)
        space.setBounds(bounds)
        return space

    def validity(self, ob: Any, information: Any) -> Any:
        query, n = self.request.query, self.n
        if query.surroundings is None:
            return ob.AllValidStateValidityChecker(information)
        checker, search = collisions(query.system.ideal(), query.surroundings), self

        class Validity(ob.StateValidityChecker):
            def isValid(self, state: Any) -> bool:
                search.checks += 1
                search.stop_if_overrun()
                return checker.is_clear(np.array([state[i] for i in range(n)]))

        return Validity(information)

    def objective(self, ob: Any, information: Any) -> Any:
        search, n, cost = self, self.n, self.cost
        identity, joints = ob.Cost(0.0), range(n)

        def configuration(state: Any) -> Array:
            return np.array([state[i] for i in joints])

        # of the class itself: costs of a subclass of StateCostIntegralObjective are ignored
        class Coupling(ob.OptimizationObjective):
            def stateCost(self, state: Any) -> Any:
                return identity

            def motionCost(self, a: Any, b: Any) -> Any:
                search.evaluations += 1
                search.stop_if_overrun()
                return ob.Cost(require_cost(cost.edge(configuration(a), configuration(b))))

            def motionCostHeuristic(self, a: Any, b: Any) -> Any:
                search.guesses += 1
                return ob.Cost(cost.bound([a[i] for i in joints], [b[i] for i in joints]))

        return Coupling(information)

    def stop_if_overrun(self) -> None:
        """Leave a planner that looks at its termination condition too seldom."""
        if self._work > _OVERRUN * self.searched * self.request.evaluations + 1000:
            raise _BudgetSpent

    def consider(self, path: Array) -> None:
        """Keep the better path, and a point of the curve.

        For a cost that is not a sum over edges, also what lies between the path and the
        straight line, where that is clear; and a motion that keeps the limits is better than
        one that breaks them.

        Args:
            path: (k, n) way-points [rad].
        """
        self.paths.append(path)
        straight = straight_counterpart(path)
        for share in self.shares:
            candidate = straight + share * (path - straight)
            candidate[[0, -1]] = path[[0, -1]]  # not to rounding only
            self._judge(candidate, clear=share == 1.0)
        self._note()

    def _note(self) -> None:
        spent, least = time.perf_counter() - self.begin, self.best[1] if self.best else math.inf
        self.curve.append(Point(spent, self.evaluations, least))

    def _judge(self, path: Array, motion: Motion | None = None, *, clear: bool) -> None:
        value = require_cost(self.cost.value(path, motion))
        if self.best is not None and not self.best[0] and value >= self.best[1]:
            return  # no better, whether or not it keeps the limits
        if not (clear or self._clear(path)):
            return
        broken = self.cost.breaks(path, motion)
        if self.best is None or (broken, value) < self.best[:2]:
            self.best = broken, value, path, motion

    def relax(self) -> None:
        """Take the paths found and the straight line down to minima near them."""
        if self.best is None or self.evaluations == 0 or self.searched == 1.0 or self._proven:
            return
        request, self.cost_searched = self.request, self.best[1]
        starts = [self.best[2], np.array(request.query.ends), *self.paths[::-1]]
        remaining = request.evaluations - math.ceil(self._work)
        self.share = 1.0
        for relaxed in self.cost.relax(_different(starts), request.seed, remaining):
            self.evaluations += relaxed.evaluations
            self.checks += relaxed.checks
            self._judge(relaxed.path, relaxed.motion, clear=False)
            self._note()
            if self.used >= 1.0:
                return

    def _clear(self, path: Array) -> bool:
        query = self.request.query
        if query.surroundings is None:
            return True
        gaps = np.linalg.norm(np.diff(path, axis=0), axis=1) / RESOLUTION
        fine = [
            np.linspace(a, b, 2 + int(gap))
            for a, b, gap in zip(path[:-1], path[1:], gaps, strict=True)
        ]
        checker = collisions(query.system.ideal(), query.surroundings)
        return checker.first_contact(np.vstack(fine)) is None

    def result(self) -> PathSearchResult:
        _, cost, path, motion = self.best or (True, math.nan, None, None)
        if path is not None and len(path) > 2 and self.evaluations == 0:
            raise BadCost(f"{self.request.algorithm} never asked for the cost")
        effort = self.evaluations, self.checks
        searched = cost if math.isnan(self.cost_searched) else self.cost_searched
        return PathSearchResult(
            path, cost, tuple(self.curve), *effort, self.bound, searched, motion
        )


def _different(paths: Sequence[Array]) -> list[Array]:
    """Each path once, in order."""
    out: list[Array] = []
    for path in paths:
        if not any(np.array_equal(path, other) for other in out):
            out.append(path)
    return out


def require_cost(cost: float) -> float:
    """A cost that is finite and not negative, or BadCost."""
    if not (math.isfinite(cost) and cost >= 0):
        raise BadCost(f"a cost must be finite and >= 0, got {cost}")
    return cost


def straight_counterpart(path: Array) -> Array:
    """Points of the straight line at the same share of the length as those of a path."""
    length = np.r_[0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))]
    u = (length / max(length[-1], 1e-300))[:, None]
    out: Array = path[0] + u * (path[-1] - path[0])
    return out
