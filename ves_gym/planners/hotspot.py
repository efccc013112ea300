"""The hot-spot method (thesis 4.2) as an algorithm: follow least coupling, avoid hot spots.

The coupling matrix is a metric on joint space: a path's length in it is small when it
runs along minimum-energy lines and keeps out of hot spots. The planner finds a short
path on a roadmap of points spread evenly through the whole joint space, relaxes it into a
smooth geodesic, and times it with a quintic. Its opposite is the bad path.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
import scipy.optimize
import scipy.sparse
import scipy.spatial
from scipy.sparse.csgraph import dijkstra
from scipy.stats import qmc

from ves_gym._util.params import Array
from ves_gym.mechanics.motion import Motion, quintic
from ves_gym.planners.coupling import coupling_length, coupling_matrix, metric
from ves_gym.planners.metric import LEAST, Metric
from ves_gym.planners.paths import feasible_part, resample
from ves_gym.planners.query import NoPlan, Query
from ves_gym.system.system import System

_ROADMAP = 4000  # points of a roadmap
_POINTS = 16  # segments of the relaxed path
_CONTROLS = 64  # of the joint-by-joint motion: follows it to about 1e-4 rad
_STEPS = 60  # of a joint's part of the path
_MOST = 12  # joints: beyond, 2^n sets of joints are too many
_DIFFERENCE = 1e-5  # rad


class HotSpot:
    """Geodesic of the coupling metric: raw Q (the historic method) or Q_T."""

    def __init__(self, *, band_limited: bool) -> None:
        self.band_limited = band_limited
        self.name = "hotspot-qt" if band_limited else "hotspot-q"
        matrix = "Q_T, band-limited to the duration" if band_limited else "raw Q (thesis 4.2)"
        self.summary = f"hot-spot method on {matrix}"

    def find(self, query: Query, seed: int) -> tuple[Motion, dict[str, Any]]:
        """Relax the shortest path and the straight line, and time the shorter; deterministic.

        Raises:
            NoPlan: the base has no stiffness, so that no joint motion stores energy in it.
        """
        if not query.system.base.K.any():
            raise NoPlan(
                "no hot spots: they are where joint motion strains the base, and"
                f" {query.system.vehicle.source} has no stiffness (Q = 0)"
            )
        duration = query.duration if self.band_limited else None
        start, goal = query.ends
        straight = np.linspace(start, goal, _POINTS + 1)
        route = _roadmap(query.system, duration).route(start, goal)
        routes = [straight, resample(route, _POINTS + 1)]
        relaxed = [_relax(query.system, route, duration) for route in routes]
        lengths = [coupling_length(query.system, path, duration) for path in relaxed]
        best = int(np.argmin(lengths))
        motion, share = feasible_part(query, relaxed[best])
        info = {
            "coupling_length": lengths[best],
            "straight_coupling_length": coupling_length(query.system, straight, duration),
            "from": ("straight", "roadmap")[best],
            "share": share,  # of the way from the straight line that the limits allow
        }
        return motion, info


class Roadmap:
    """Halton's points in joint space of any dimension, joined to their neighbours.

    As many as in PRM* (Karaman and Frazzoli 2011); an edge costs its length in Q_T of a
    duration [s], in raw Q for None.
    """

    def __init__(self, system: System, duration: float | None) -> None:
        arm = system.arm
        halton = qmc.Halton(arm.n, scramble=False).random(_ROADMAP)
        self.points = qmc.scale(halton, arm.column("q_min"), arm.column("q_max"))
        self._count = int(np.ceil(math.e * (1 + 1 / arm.n) * np.log(_ROADMAP)))
        self._tree = scipy.spatial.cKDTree(self.points)
        _, neighbours = self._tree.query(self.points, self._count + 1)
        heads = np.repeat(np.arange(_ROADMAP), self._count)
        self._edges = heads, neighbours[:, 1:].ravel()
        self._lengths = Metric(system, duration).lengths
        self._costs = self._lengths(*(self.points[k] for k in self._edges))

    def route(self, start: Array, goal: Array) -> Array:
        """Return the shortest path (k, n) [rad] through the network."""
        places = np.vstack([self.points, start, goal])
        size = len(self.points)
        near = self._tree.query([start, goal], self._count)[1].ravel()
        heads = np.r_[np.repeat([size, size + 1], self._count), size]
        tails = np.r_[near, size + 1]  # start and goal are neighbours, too
        costs = self._lengths(places[heads], places[tails])
        # 32-bit indices: what SciPy's graph routines take in every supported release
        ends = tuple(np.hstack([self._edges, (heads, tails)]).astype(np.int32))
        graph = scipy.sparse.csr_array((np.r_[self._costs, costs], ends), shape=(size + 2,) * 2)
        _, before = dijkstra(graph, directed=False, indices=size, return_predecessors=True)
        nodes = [size + 1]
        while nodes[-1] != size:
            nodes.append(int(before[nodes[-1]]))
        return places[nodes[::-1]]


_roadmap = lru_cache(maxsize=16)(Roadmap)


# ---------------------------------------------------------------------- relaxation


def _relax(system: System, path: Array, duration: float | None) -> Array:
    """Minimise the path energy sum dq^T (Q + least) dq over the inner points."""
    n, k = path.shape[1], len(path) - 1
    middle = metric(system, path, duration)
    least = LEAST * float(np.mean(np.trace(middle, axis1=-2, axis2=-1))) / n

    def value(x: Array) -> tuple[float, Array]:
        points = np.vstack([path[0], x.reshape(-1, n), path[-1]])
        step, at = np.diff(points, axis=0), (points[1:] + points[:-1]) / 2
        shifts = _DIFFERENCE * np.vstack([np.zeros(n), np.eye(n), -np.eye(n)])
        Q = metric(system, at + shifts[:, None, :], duration)
        squares = np.einsum("ki,skij,kj->sk", step, Q, step)
        by_point = (squares[1 : n + 1] - squares[n + 1 :]).T / (2 * _DIFFERENCE)
        by_step = 2 * (np.einsum("kij,kj->ki", Q[0], step) + least * step)
        gradient = np.zeros_like(points)
        gradient[1:] += by_step + by_point / 2
        gradient[:-1] += -by_step + by_point / 2
        return k * float(squares[0].sum() + least * np.sum(step**2)), k * gradient[1:-1].ravel()

    low, high = (np.tile(system.arm.column(end), k - 1) for end in ("q_min", "q_max"))
    scale = max(value(path[1:-1].ravel())[0], 1e-12)
    result = scipy.optimize.minimize(
        lambda x: tuple(part / scale for part in value(x)),
        path[1:-1].ravel(),
        jac=True,
        method="L-BFGS-B",
        bounds=scipy.optimize.Bounds(low, high),
        options={"maxiter": 200},
    )
    return np.vstack([path[0], result.x.reshape(-1, n), path[-1]])


class BadPath:
    """The bad path of thesis 4.2: one joint after the other, in the order of most coupling.

    Of all orders of the joints, the one of greatest coupling length on raw Q; each joint
    moves from rest to rest in its share of the time.
    """

    name = "bad-path"
    summary = "one joint after the other, in the order of greatest coupling length"

    def find(self, query: Query, seed: int) -> tuple[Motion, dict[str, Any]]:
        """Move the joints one by one, in the worst order; deterministic.

        Raises:
            NoPlan: too many joints to compare all their orders.
        """
        start, goal = query.ends
        moving = np.flatnonzero(start != goal)
        if len(moving) > _MOST:
            raise NoPlan(
                f"no bad path: {_MOST} joints have {2**_MOST} sets whose coupling lengths are"
                f" compared, more would take too long; {len(moving)} move here"
            )
        route = np.tile(start, (3 * _STEPS + 1, 1))
        if len(moving):
            turn = np.zeros(len(start))  # when each joint moves
            turn[worst_order(query.system, start, goal)] = np.arange(len(moving))
            # enough samples for the fit where only one joint moves
            u = np.linspace(0, len(moving), max(3, len(moving)) * _STEPS + 1)[:, None]
            route = start + quintic(u - turn) * (goal - start)
            route[-1] = goal  # not to rounding only
        motion = Motion.fit(route, query.duration, controls=_CONTROLS)
        return motion, {"coupling_length": coupling_length(query.system, route, None)}


def worst_order(system: System, start: Array, goal: Array) -> list[int]:
    """Numbers of the moving joints, from 0, in the order of greatest coupling length on raw Q.

    A joint's part depends on which joints moved before it, not on their order: the longest way
    through the sets of joints (Held and Karp).
    """
    moving = np.flatnonzero(start != goal).tolist()
    part = _parts(system, start, goal, moving)
    count = 2 ** len(moving)
    longest, last = np.full(count, -1.0), np.zeros(count, int)
    longest[0] = 0.0
    for moved in range(count):  # bits: joints that have moved
        for k in range(len(moving)):
            after = moved | 1 << k
            if after != moved and longest[moved] + part[k, moved] > longest[after]:
                longest[after], last[after] = longest[moved] + part[k, moved], k
    order, moved = [], count - 1
    while moved:
        k = int(last[moved])
        order.append(moving[k])
        moved -= 1 << k
    return order[::-1]


def _parts(system: System, start: Array, goal: Array, moving: list[int]) -> Array:
    """Coupling length (k, 2^k) of each moving joint's part, by which have moved before.

    Of a joint alone it is the integral of sqrt(Q_jj) along its way.
    """
    count = 2 ** len(moving)
    u = quintic(np.linspace(0, 1, _STEPS + 1))
    out = np.zeros((len(moving), count))
    bits = np.arange(count)[:, None] >> np.arange(len(moving)) & 1
    for k, j in enumerate(moving):
        sets = np.flatnonzero(bits[:, k] == 0)
        way = goal[j] - start[j]
        q = np.tile(start, (len(sets), _STEPS, 1))
        q[..., moving] += (bits[sets] * (goal - start)[moving])[:, None]
        q[..., j] = start[j] + (u[1:] + u[:-1]) / 2 * way
        Q = coupling_matrix(system, q)[..., j, j]
        out[k, sets] = np.sqrt(np.maximum(Q, 0.0)) @ (np.diff(u) * abs(way))
    return out
