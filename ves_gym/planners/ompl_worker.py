"""One OMPL search, in a process of its own: `ompl_search` starts it and may kill it.

OMPL is C++ with Python callbacks: a planner can crash, hang, hold the interpreter's lock or
outlast its time limit. Here it harms nobody. Requests come on standard input, answers go out
on standard output, one pickle each.
"""

from __future__ import annotations

import itertools
import math
import os
import pickle
import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ves_gym._util.params import Array
from ves_gym.planners.metric import Metric
from ves_gym.planners.obstacles import RESOLUTION, collisions
from ves_gym.planners.query import Query

CHECKPOINTS = 20  # of the anytime curve
_CHECKS = 5  # validity checks allowed per cost evaluation of the budget
_GUESSES = 20  # lower bounds likewise
_PROVEN = 1 + 1e-9  # times the lower bound: a cost that cannot be improved
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
    objective: str  # q, qt or time
    algorithm: str  # of ALGORITHMS
    seed: int
    evaluations: int  # of edge costs
    seconds: float


@dataclass(frozen=True)
class PathSearchResult:
    """The best path of a search, its cost and the effort."""

    path: Array | None  # (k, n) way-points
    cost: float  # coupling length [J^(1/2)] or time [s]
    curve: tuple[tuple[float, int, float], ...]  # anytime: (seconds, evaluations, cost)
    evaluations: int
    checks: int  # of validity
    bound: float  # no path costs less


EdgeCost = Callable[[Array, Array], float]
Bound = Callable[[Sequence[float], Sequence[float]], float]


class BadCost(Exception):
    """A cost that OMPL cannot take: it crashes on negative ones and returns NaN as exact."""


class _BudgetSpent(Exception):
    """The budget is used up and the planner does not stop."""


def serve() -> None:
    """Answer requests until standard input ends."""
    requests, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what OMPL prints is not an answer
    while True:
        try:
            request = pickle.load(requests)
        except EOFError:
            return
        signal.alarm(math.ceil(min(request.seconds + _ORPHAN, 1e9)))
        try:
            answer: PathSearchResult | str = search(request)
        except Exception as error:  # all of it is the parent's to report
            answer = f"{type(error).__name__}: {error}"
        signal.alarm(0)
        pickle.dump(answer, answers)
        answers.flush()


def search(request: Request) -> PathSearchResult:
    """Run OMPL on a request."""
    from ompl import base as ob
    from ompl import geometric as og
    from ompl import util as ou

    ou.setLogLevel(ou.LOG_NONE)
    ou.RNG.setSeed(request.seed + 1)  # zero would mean a random seed
    run, query = _Search(request), request.query
    space, bounds = ob.RealVectorStateSpace(run.n), ob.RealVectorBounds(run.n)
    for i, link in enumerate(query.system.arm.links):
        bounds.setLow(i, link.q_min)
        bounds.setHigh(i, link.q_max)
    space.setBounds(bounds)
    information = ob.SpaceInformation(space)
    validity, objective = run.validity(ob, information), run.objective(ob, information)
    information.setStateValidityChecker(validity)
    information.setStateValidityCheckingResolution(RESOLUTION / space.getMaximumExtent())
    information.setup()
    problem = ob.ProblemDefinition(information)
    ends = [space.allocState() for _ in range(2)]
    for state, q in zip(ends, query.ends, strict=True):
        for i, angle in enumerate(q):
            state[i] = float(angle)
    problem.setStartAndGoalStates(*ends)
    problem.setOptimizationObjective(objective)
    planner = getattr(og, ALGORITHMS[request.algorithm])(information)
    planner.setProblemDefinition(problem)
    planner.setup()
    for k in range(CHECKPOINTS):
        run.share = (k + 1) / CHECKPOINTS
        try:
            planner.solve(ob.PlannerTerminationCondition(run.is_enough))
        except _BudgetSpent:
            run.share = 1.0
        if problem.hasExactSolution():
            path = problem.getSolutionPath()
            states = (path.getState(i) for i in range(path.getStateCount()))
            run.consider(np.array([[s[j] for j in range(run.n)] for s in states]))
        if run.share >= 1.0 or run.used >= 1.0 or run.cost <= _PROVEN * run.bound:
            break
    return PathSearchResult(
        run.path, run.cost, tuple(run.curve), run.evaluations, run.checks, run.bound
    )


class _Search:
    """Budget, costs and the best path of one request."""

    def __init__(self, request: Request) -> None:
        self.request, self.n = request, request.query.system.arm.n
        self.edge, self.least = _costs(request.query, request.objective)
        self.bound = self.least(request.query.start, request.query.goal)
        self.begin = time.perf_counter()
        self.share = 0.0  # of the budget that may be used now
        self.evaluations = self.checks = self.guesses = 0
        self.path: Array | None = None
        self.cost = math.inf
        self.curve: list[tuple[float, int, float]] = []

    @property
    def used(self) -> float:
        """Share of the budget used up; alike on every machine until the time is up."""
        if time.perf_counter() - self.begin > self.request.seconds:
            return math.inf
        work = max(self.evaluations, self.checks / _CHECKS, self.guesses / _GUESSES)
        return work / self.request.evaluations

    def is_enough(self) -> bool:
        """OMPL's termination condition."""
        return self.used >= self.share

    def stop_if_overrun(self) -> None:
        """Leave a planner that looks at its termination condition too seldom."""
        if self.used > _OVERRUN + 1000 / self.request.evaluations:
            raise _BudgetSpent

    def consider(self, path: Array) -> None:
        """Keep the better path (k, n) [rad], and a point of the curve."""
        cost = sum(require_cost(self.edge(a, b)) for a, b in itertools.pairwise(path))
        if cost < self.cost:
            self.path, self.cost = path, cost
        self.curve.append((time.perf_counter() - self.begin, self.evaluations, self.cost))

    def validity(self, ob: Any, information: Any) -> Any:
        """OMPL's checker of one configuration."""
        query, search, joints = self.request.query, self, range(self.n)
        if query.surroundings is None:
            return ob.AllValidStateValidityChecker(information)
        checker = collisions(query.system, query.surroundings)

        class Validity(ob.StateValidityChecker):
            def isValid(self, state: Any) -> bool:
                search.checks += 1
                search.stop_if_overrun()
                return checker.is_clear(np.array([state[i] for i in joints]))

        return Validity(information)

    def objective(self, ob: Any, information: Any) -> Any:
        """OMPL's objective: the cost of a straight edge, and what none is below."""
        search, joints, identity = self, range(self.n), ob.Cost(0.0)

        # of the class itself: costs of a subclass of StateCostIntegralObjective are ignored
        class Coupling(ob.OptimizationObjective):
            def stateCost(self, state: Any) -> Any:
                return identity

            def motionCost(self, a: Any, b: Any) -> Any:
                search.evaluations += 1
                search.stop_if_overrun()
                ends = (np.array([state[i] for i in joints]) for state in (a, b))
                return ob.Cost(require_cost(search.edge(*ends)))

            def motionCostHeuristic(self, a: Any, b: Any) -> Any:
                search.guesses += 1
                return ob.Cost(search.least([a[i] for i in joints], [b[i] for i in joints]))

        return Coupling(information)


def _costs(
    query: Query, objective: str
) -> tuple[
    Callable[[Array, Array], float], Callable[[Sequence[float], Sequence[float]], float]
]:
    """Cost of a straight edge, and what no path between two configurations is below.

    Time at the speed limits is a norm: the straight edge's is the least. A step of 1 rad is
    nowhere shorter than the metric's `floor`.
    """
    if objective == "time":
        speed = query.speed.tolist()

        def least(a: Sequence[float], b: Sequence[float]) -> float:
            return max(abs(y - x) / v for x, y, v in zip(a, b, speed, strict=True))

        return lambda a, b: least(a.tolist(), b.tolist()), least
    metric = Metric(query.system, objective, query.duration if objective == "qt" else None)
    floor = metric.floor
    return metric.edge, lambda a, b: floor * math.dist(a, b)


def require_cost(cost: float) -> float:
    """A cost that is finite and not negative, or BadCost."""
    if not (math.isfinite(cost) and cost >= 0):
        raise BadCost(f"a cost must be finite and >= 0, got {cost}")
    return cost
