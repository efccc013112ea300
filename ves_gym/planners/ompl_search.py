"""Minimum-coupling paths by sampling-based search (OMPL) in joint space.

A search adds up costs edge by edge, so it minimises coupling length, on raw Q (thesis 4.2)
or Q_T, or time. The energy of a timed path is not a sum over its edges: `refined` takes these
paths, where there are obstacles, to motions of least energy.
"""

from __future__ import annotations

import itertools
import math
import pickle
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from ves_gym._util import child_process
from ves_gym._util.child_process import Child, ChildDied
from ves_gym._util.optional import require
from ves_gym._util.params import Array, require_choice
from ves_gym.mechanics.motion import Motion
from ves_gym.planners.metric import Metric
from ves_gym.planners.obstacles import RESOLUTION, collisions
from ves_gym.planners.paths import time_path
from ves_gym.planners.query import NoPlan, Query, first_violation, require_possible

OBJECTIVES = {
    "q": "coupling length on raw Q (thesis 4.2)",
    "qt": "coupling length on Q_T",
    "time": "least time at the speed limits",
}
_GRACE = 10.0  # s a search may take longer than asked before it is killed


@dataclass(frozen=True, kw_only=True)
class Ompl:
    """OMPL's best path for a coupling objective, passed in the query's time."""

    objective: str = "qt"
    algorithm: str = "bitstar"
    evaluations: int = 5000  # budget of edge costs; repeatable, unlike seconds
    seconds: float = 30.0

    def __post_init__(self) -> None:
        require_choice(self, "algorithm", tuple(ALGORITHMS))

    @property
    def name(self) -> str:
        return f"ompl-{self.objective}"

    @property
    def summary(self) -> str:
        return f"OMPL {ALGORITHMS[self.algorithm]} on {OBJECTIVES[self.objective]}"

    def find(self, query: Query, seed: int) -> tuple[Motion, dict[str, Any]]:
        """Search a new tree every time; the seed and the budget decide the path.

        Raises:
            NoPlan: no path within the budget, or the child process failed.
        """
        require_possible(query)
        result = self.search(query, seed)
        assert result.path is not None
        motion, share = time_path(query, result.path)
        hurried = first_violation(query, motion) is not None and self.objective != "time"
        if hurried:  # no time for this path: the fastest is the next best
            fast = replace(self, objective="time").search(query, seed)
            assert fast.path is not None
            motion, share = time_path(query, fast.path)
        effort = {k: getattr(result, k) for k in ("cost", "bound", "evaluations", "checks")}
        return motion, {
            "objective": self.objective,
            "algorithm": self.algorithm,
            **effort,
            "points": len(result.path),
            "share": share,  # of the way from the straight line that the limits allow
            "hurried": hurried,
        }

    def search(self, query: Query, seed: int) -> PathSearchResult:
        """Return the best way-points found, from the child process.

        Raises:
            MissingPackageError: OMPL is not installed.
            NoPlan: no path within the budget, or the child failed.
        """
        require(f"planner {self.name}", "ompl")
        request = Request(self, replace(query, system=query.system.ideal()), seed)
        result = searched(request, self.seconds + _GRACE)
        if result.path is None:
            raise NoPlan(
                f"no path found within {result.evaluations} cost evaluations and"
                f" {result.checks} validity checks"
            )
        return result


# ----------------------------------------------------------------------------- child


# A planner that crashes or hangs takes this process with it, and nothing else.
SEARCH_PROCESS = Child("from ves_gym.planners.ompl_search import serve; serve()")


def searched(request: Request, limit: float) -> PathSearchResult:
    """Return the answer of the searching process, which has `limit` seconds for it.

    Raises:
        NoPlan: it crashed, failed or did not answer in time.
    """
    try:
        answer = pickle.loads(SEARCH_PROCESS.ask(pickle.dumps(request), limit))
    except ChildDied as died:
        raise NoPlan(f"the search {died}") from None
    if not isinstance(answer, PathSearchResult):
        raise NoPlan(f"the search failed: {answer}")
    return answer


CHECKPOINTS = 20  # at which a search ends if its path cannot be improved
_CHECKS = 5  # validity checks allowed per cost evaluation of the budget
_GUESSES = 20  # lower bounds likewise
_PROVEN = 1 + 1e-9  # times the lower bound: a cost that cannot be improved
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


class Request(NamedTuple):
    """One search. The same request gives the same path while `seconds` is not reached."""

    planner: Ompl
    query: Query
    seed: int


class PathSearchResult(NamedTuple):
    """The best path of a search, its cost and the effort."""

    path: Array | None  # (k, n) way-points
    cost: float  # coupling length [J^(1/2)] or time [s]
    evaluations: int
    checks: int  # of validity
    bound: float  # no path costs less


class BadCost(Exception):
    """A cost that OMPL cannot take: it crashes on negative ones and returns NaN as exact."""


class _BudgetSpent(Exception):
    """The budget is used up and the planner does not stop."""


def serve() -> None:
    """Answer requests until standard input ends."""
    child_process.serve(_answer)


def _answer(request: bytes) -> bytes:
    try:
        return pickle.dumps(search(pickle.loads(request)))
    except Exception as error:  # all of it is the parent's to report
        return pickle.dumps(f"{type(error).__name__}: {error}")


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
    planner = getattr(og, ALGORITHMS[request.planner.algorithm])(information)
    planner.setProblemDefinition(problem)
    planner.setup()
    for k in range(CHECKPOINTS):
        run.share = (k + 1) / CHECKPOINTS
        try:
            planner.solve(ob.PlannerTerminationCondition(lambda: run.used >= run.share))
        except _BudgetSpent:
            run.share = 1.0
        if problem.hasExactSolution():
            path = problem.getSolutionPath()
            states = (path.getState(i) for i in range(path.getStateCount()))
            run.consider(np.array([[s[j] for j in range(run.n)] for s in states]))
        if run.share >= 1.0 or run.used >= 1.0 or run.cost <= _PROVEN * run.bound:
            break
    return PathSearchResult(run.path, run.cost, run.evaluations, run.checks, run.bound)


class _Search:
    """Budget, costs and the best path of one request."""

    def __init__(self, request: Request) -> None:
        self.request, self.n = request, request.query.system.arm.n
        self.edge, self.least = _costs(request.query, request.planner.objective)
        self.bound = self.least(request.query.start, request.query.goal)
        self.begin = time.perf_counter()
        self.share = 0.0  # of the budget that may be used now
        self.evaluations = self.checks = self.guesses = 0
        self.path: Array | None = None
        self.cost = math.inf

    @property
    def used(self) -> float:
        """Share of the budget used up; alike on every machine until the time is up."""
        if time.perf_counter() - self.begin > self.request.planner.seconds:
            return math.inf
        work = max(self.evaluations, self.checks / _CHECKS, self.guesses / _GUESSES)
        return work / self.request.planner.evaluations

    def stop_if_overrun(self) -> None:
        """Leave a planner that checks its termination condition too seldom."""
        if self.used > _OVERRUN + 1000 / self.request.planner.evaluations:
            raise _BudgetSpent

    def consider(self, path: Array) -> None:
        """Keep the better path (k, n) [rad]."""
        cost = sum(require_cost(self.edge(a, b)) for a, b in itertools.pairwise(path))
        if cost < self.cost:
            self.path, self.cost = path, cost

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


EdgeCost = Callable[[Array, Array], float]
Bound = Callable[[Sequence[float], Sequence[float]], float]


def _costs(query: Query, objective: str) -> tuple[EdgeCost, Bound]:
    """Cost of a straight edge, and what no path between two configurations is below.

    Time at the speed limits is a norm: the straight edge's is the least. A step of 1 rad is
    nowhere shorter than the metric's `floor`.
    """
    if objective == "time":
        speed = query.speed.tolist()

        def least(a: Sequence[float], b: Sequence[float]) -> float:
            return max(abs(y - x) / v for x, y, v in zip(a, b, speed, strict=True))

        return lambda a, b: least(a.tolist(), b.tolist()), least
    metric = Metric(query.system, query.duration if objective == "qt" else None)
    floor = metric.floor
    return metric.edge, lambda a, b: floor * math.dist(a, b)


def require_cost(cost: float) -> float:
    """A cost that is finite and not negative, or BadCost."""
    if not (math.isfinite(cost) and cost >= 0):
        raise BadCost(f"a cost must be finite and >= 0, got {cost}")
    return cost
