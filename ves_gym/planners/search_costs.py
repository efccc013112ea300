"""Costs that a search minimises: of an edge, of a whole path, and bounds that no path beats.

A search adds up the cost of edges and asks for an admissible estimate of the cost to go, one
that no path undercuts. The cost of the whole path decides; relaxation takes it to a minimum.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Protocol

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym.mechanics.motion import Motion
from ves_gym.planners.cost_to_go import LeastLength
from ves_gym.planners.direct import MotionProblem
from ves_gym.planners.metric import Metric
from ves_gym.planners.obstacles import collisions
from ves_gym.planners.query import Query, is_feasible
from ves_gym.planners.relaxation import Relaxed, bends, settle, shorten

_FEW = 4  # paths whose length is relaxed at most
_MANY = 6  # starts from which energy is relaxed at most: it has more minima;
_FOUND = 3  # of them from the search and the straight line, where there are no obstacles
_LEAST_BUDGET = 1200  # evaluations worth a further start
_FREE = 24  # control points of a relaxed motion


class PathCost(Protocol):
    """Cost of a path."""

    relaxes: bool  # whether `relax` does anything

    def edge(self, a: Array, b: Array) -> float:
        """Cost of the straight edge between configurations (n,), which the search adds up."""

    def value(self, path: Array, motion: Motion | None = None) -> float:
        """Cost of way-points (k, n), or of a motion along them, which decides."""

    def bound(self, a: Sequence[float], b: Sequence[float]) -> float:
        """Sum of edge costs that no path between configurations of n joints is below."""

    def floor(self) -> float:
        """Value that no path of the query is below."""

    def breaks(self, path: Array, motion: Motion | None = None) -> bool:
        """True if limits matter to this cost and way-points (k, n) or a motion break one."""

    def relax(self, starts: Sequence[Array], seed: int, budget: int) -> Iterator[Relaxed]:
        """Paths of locally least value near some."""


class Time:
    """Least time at the speed limits: a norm, so that the straight line's is a bound."""

    relaxes = False

    def __init__(self, query: Query) -> None:
        self.speed, self._ends = speed_limits(query), query.ends
        self._limits = self.speed.tolist()

    def edge(self, a: Array, b: Array) -> float:
        """Time [s] with one joint at its speed limit."""
        return float(np.max(np.abs(b - a) / self.speed))

    def bound(self, a: Sequence[float], b: Sequence[float]) -> float:
        """Time [s] of the straight edge."""
        return max(abs(y - x) / v for x, y, v in zip(a, b, self._limits, strict=True))

    def value(self, path: Array, motion: Motion | None = None) -> float:
        """Time [s] of way-points (k, n)."""
        return fastest(path, self.speed)

    def floor(self) -> float:
        """Time [s] of the straight line."""
        return self.edge(*self._ends)

    def breaks(self, path: Array, motion: Motion | None = None) -> bool:
        """Time is how the limits are kept."""
        return False

    def relax(self, starts: Sequence[Array], seed: int, budget: int) -> Iterator[Relaxed]:
        """Nothing: a maximum over joints has no derivative."""
        return iter(())


class Length:
    """Coupling length [J^(1/2)] on Q or Q_T."""

    relaxes = True

    def __init__(self, query: Query, kind: str) -> None:
        self.query = query
        self.metric = Metric(query.system, kind, query.duration if kind == "qt" else None)
        self.edge: Callable[[Array, Array], float] = self.metric.edge
        self.bound: Callable[[Sequence[float], Sequence[float]], float]
        self.bound = LeastLength(self.metric)

    def value(self, path: Array, motion: Motion | None = None) -> float:
        """Length of a polyline (k, n), however it is timed."""
        return self.metric.length(path)

    def floor(self) -> float:
        """Length that no path between the ends is below."""
        return self.bound(self.query.start, self.query.goal)

    def breaks(self, path: Array, motion: Motion | None = None) -> bool:
        """No limit is on lengths."""
        return False

    def relax(self, starts: Sequence[Array], seed: int, budget: int) -> Iterator[Relaxed]:
        """Shorten as many starts as the budget lets come near their minimum."""
        query, spent = self.query, 0
        checker = None
        if query.surroundings is not None:
            checker = collisions(query.system, query.surroundings)
        count = int(np.clip(budget // _LEAST_BUDGET, 1, min(_FEW, len(starts))))
        for k, start in enumerate(starts[:count]):
            relaxed = shorten(self.metric, start, (budget - spent) // (count - k), checker)
            spent += relaxed.evaluations
            yield relaxed


class Energy(Length):
    """Predicted E_mean [J] of the timed path; its edges are those of Q_T."""

    def __init__(self, query: Query) -> None:
        super().__init__(query, "qt")
        self._problem = MotionProblem(query, _FREE)

    def value(self, path: Array, motion: Motion | None = None) -> float:
        """Return the energy [J] of a motion, by default that along way-points (k, n)."""
        return self._problem.energy.of(motion or self._timed(path))

    def breaks(self, path: Array, motion: Motion | None = None) -> bool:
        """True if a motion, by default that along way-points (k, n), is no answer."""
        return not is_feasible(self.query, motion or self._timed(path))

    def _timed(self, path: Array) -> Motion:
        return Motion.through(path, self.query.duration)

    def floor(self) -> float:
        """Nothing is known but that energy is not negative."""
        return 0.0

    def relax(self, starts: Sequence[Array], seed: int, budget: int) -> Iterator[Relaxed]:
        """Settle from the starts; without obstacles also from random bends of the line."""
        tried = list(starts[:_MANY])
        if self.query.surroundings is None:
            tried = [*tried[:_FOUND], *bends(self.query, _MANY - len(tried[:_FOUND]), seed)]
        count = max(1, min(len(tried), budget // _LEAST_BUDGET))
        timed = [self._timed(path) for path in tried[:count]]
        return iter(settle(self._problem, timed, budget))


def cost_of(query: Query, objective: str) -> PathCost:
    """Return the cost of a query's paths.

    Args:
        query: the ends, the duration and limits.
        objective: q, qt, energy or time.

    Raises:
        ParameterError: another objective.
    """
    if objective == "time":
        return Time(query)
    if objective == "energy":
        return Energy(query)
    if objective in ("q", "qt"):
        return Length(query, objective)
    raise ParameterError(f"objective must be q, qt, energy or time, got {objective!r}")


def speed_limits(query: Query) -> Array:
    """(n,) of the query, or of the arm where it has none [rad/s]."""
    return query.system.arm.column("v_max") if query.v_max is None else np.array(query.v_max)


def fastest(path: Array, speed: Array) -> float:
    """Time a path takes with one joint at its speed limit throughout.

    Args:
        path: (k, n) way-points [rad].
        speed: (n,) limits [rad/s].

    Returns:
        The time [s].
    """
    return float(np.sum(np.max(np.abs(np.diff(path, axis=0)) / speed, axis=1)))
