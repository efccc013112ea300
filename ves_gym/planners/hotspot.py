"""The hot-spot method (thesis 4.2) as an algorithm: follow least coupling, avoid hot spots.

The coupling matrix is a metric on joint space: a path's length in it is small when it
runs along minimum-energy lines and keeps out of hot spots. The planner finds a short
path on a lattice or, with more than three joints, on a roadmap of points spread evenly
through the whole joint space, relaxes it into a smooth geodesic, and times it with a quintic.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.optimize
import scipy.sparse
import scipy.spatial
from scipy.sparse.csgraph import dijkstra
from scipy.stats import qmc

from ves_gym._util.params import Array
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.motion import Motion, quintic
from ves_gym.planners.coupling import coupling_length, coupling_matrix, metric
from ves_gym.planners.metric import LEAST, Metric
from ves_gym.planners.paths import feasible_part, resample
from ves_gym.planners.query import NoPlan, Query
from ves_gym.system.system import System

Ints = npt.NDArray[np.signedinteger[Any]]
_PITCH = np.deg2rad(15.0)  # lattice spacing
_LARGEST = 200_000  # lattice edges; beyond that a lattice is the wrong tool
_ROADMAP = 4000  # points of a roadmap
_POINTS = 16  # segments of the relaxed path
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
        network = _network(query.system, duration)
        routes = [straight, resample(network.route(start, goal), _POINTS + 1)]
        relaxed = [_relax(query.system, route, duration) for route in routes]
        lengths = [coupling_length(query.system, path, duration) for path in relaxed]
        best = int(np.argmin(lengths))
        motion, share = feasible_part(query, relaxed[best])
        info = {
            "coupling_length": lengths[best],
            "straight_coupling_length": coupling_length(query.system, straight, duration),
            "from": ("straight", network.name)[best],
            "share": share,  # of the way from the straight line that the limits allow
        }
        return motion, info


# ------------------------------------------------------------------------- networks


class SpotNetwork:
    """Joint space as points, with the coupling lengths of straight ways between neighbours.

    Args:
        name: lattice or roadmap.
        points: (N, n) [rad].
        edges: neighbours, two (E,) of their numbers.
        costs: (E,) their lengths.
        lengths: of ways from (k, n) to (k, n), (k,).
        near: numbers of the points that a configuration (n,) is joined to.
        joins_ends: start and goal are neighbours, too.
    """

    def __init__(
        self,
        name: str,
        points: Array,
        edges: tuple[Ints, Ints],
        costs: Array,
        lengths: Callable[[Array, Array], Array],
        near: Callable[[Array], Ints],
        joins_ends: bool,
    ) -> None:
        self.name, self.points, self.edges, self.costs = name, points, edges, costs
        self._lengths, self._near, self._joins_ends = lengths, near, joins_ends

    def route(self, start: Array, goal: Array) -> Array:
        """Return the shortest path (k, n) [rad] through the network."""
        size = len(self.points)
        a, b, costs = [self.edges[0]], [self.edges[1]], [self.costs]
        for k, q in enumerate((start, goal)):
            near = self._near(q)
            a.append(np.full(len(near), size + k))
            b.append(near)
            places = self.points[near]
            costs.append(self._lengths(np.broadcast_to(q, places.shape), places))
        if self._joins_ends:
            a.append(np.array([size]))
            b.append(np.array([size + 1]))
            costs.append(self._lengths(start[None], goal[None]))
        # 32-bit indices: what SciPy's graph routines take in every supported release
        ends = tuple(np.concatenate(k).astype(np.int32) for k in (a, b))
        shape = (size + 2, size + 2)
        graph = scipy.sparse.csr_array((np.concatenate(costs), ends), shape=shape)
        _, before = dijkstra(graph, directed=False, indices=size, return_predecessors=True)
        nodes = [size + 1]
        while nodes[-1] != size:
            nodes.append(int(before[nodes[-1]]))
        return np.vstack([self.points, start, goal])[nodes[::-1]]


def lattice(system: System, duration: float | None) -> SpotNetwork:
    """A regular lattice of `_PITCH`, every point joined to all around it."""
    axes = _axes(system.arm)
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
    index = np.arange(len(points)).reshape([len(axis) for axis in axes])
    heads, tails = [], []
    for move in itertools.product((-1, 0, 1), repeat=len(axes)):
        if move > (0,) * len(axes):
            pairs = list(zip(move, index.shape, strict=True))
            heads.append(index[tuple(slice(max(0, -m), s - max(0, m)) for m, s in pairs)])
            tails.append(index[tuple(slice(max(0, m), s - max(0, -m)) for m, s in pairs)])
    a, b = (np.concatenate([k.ravel() for k in part]) for part in (heads, tails))
    Q = metric(system, (points[a] + points[b]) / 2, duration)
    least = float(LEAST * np.mean(np.trace(Q, axis1=-2, axis2=-1)) / len(axes))

    def size(step: Array, Q: Array) -> Array:
        squares = np.einsum("ki,kij,kj->k", step, Q, step) + least * np.sum(step**2, axis=-1)
        return np.sqrt(np.maximum(squares, 0))

    def lengths(start: Array, end: Array) -> Array:
        return size(end - start, metric(system, (start + end) / 2, duration))

    def near(q: Array) -> Ints:
        return np.flatnonzero((np.abs(points - q) <= 1.5 * _PITCH).all(axis=1))

    costs = size(points[b] - points[a], Q)
    return SpotNetwork("lattice", points, (a, b), costs, lengths, near, joins_ends=False)


def roadmap(system: System, duration: float | None) -> SpotNetwork:
    """Halton's points in joint space of any dimension, joined to their neighbours.

    As many as in PRM* (Karaman and Frazzoli 2011).
    """
    arm = system.arm
    halton = qmc.Halton(arm.n, scramble=False).random(_ROADMAP)
    points = qmc.scale(halton, arm.column("q_min"), arm.column("q_max"))
    count = int(np.ceil(math.e * (1 + 1 / arm.n) * np.log(_ROADMAP)))
    tree = scipy.spatial.cKDTree(points)
    _, neighbours = tree.query(points, count + 1)
    edges = np.repeat(np.arange(_ROADMAP), count), neighbours[:, 1:].ravel()
    # "qt" and "q" as the lattice has them, compiled
    lengths = Metric(system, "q" if duration is None else "qt", duration).lengths

    def near(q: Array) -> Ints:
        return np.asarray(tree.query(q, count)[1])

    costs = lengths(points[edges[0]], points[edges[1]])
    return SpotNetwork("roadmap", points, edges, costs, lengths, near, joins_ends=True)


def _axes(arm: Arm) -> list[Array]:
    low, high = arm.column("q_min"), arm.column("q_max")
    return [
        np.arange(np.ceil(a / _PITCH), np.floor(b / _PITCH) + 1) * _PITCH
        for a, b in zip(low, high, strict=True)
    ]


@lru_cache(maxsize=16)
def _network(system: System, duration: float | None) -> SpotNetwork:
    """A lattice where it is small enough."""
    nodes = int(np.prod([len(axis) for axis in _axes(system.arm)]))
    small = nodes * (3**system.arm.n - 1) // 2 <= _LARGEST
    return (lattice if small else roadmap)(system, duration)


# ---------------------------------------------------------------------- relaxation


def _relax(system: System, path: Array, duration: float | None) -> Array:
    """Minimise the path energy sum dq^T (Q + least) dq over the inner points."""
    n, k = path.shape[1], len(path) - 1
    middle = metric(system, path, duration)
    least = LEAST * float(np.mean(np.trace(middle, axis1=-2, axis2=-1))) / n

    def value(x: Array) -> tuple[float, Array]:
        points = np.vstack([path[0], x.reshape(-1, n), path[-1]])
        step, at = np.diff(points, axis=0), (points[1:] + points[:-1]) / 2
        shifts = np.concatenate(
            [np.zeros((1, n)), _DIFFERENCE * np.eye(n), -_DIFFERENCE * np.eye(n)]
        )
        Q = metric(system, at + shifts[:, None, :], duration)
        squares = np.einsum("ki,skij,kj->sk", step, Q, step)
        by_point = (squares[1 : n + 1] - squares[n + 1 :]).T / (2 * _DIFFERENCE)
        by_step = 2 * (np.einsum("kij,kj->ki", Q[0], step) + least * step)
        gradient = np.zeros_like(points)
        gradient[1:] += by_step + by_point / 2
        gradient[:-1] += -by_step + by_point / 2
        return k * float(squares[0].sum() + least * np.sum(step**2)), k * gradient[1:-1].ravel()

    arm = system.arm
    bounds = scipy.optimize.Bounds(
        np.tile(arm.column("q_min"), k - 1), np.tile(arm.column("q_max"), k - 1)
    )
    scale = max(value(path[1:-1].ravel())[0], 1e-12)
    result = scipy.optimize.minimize(
        lambda x: tuple(part / scale for part in value(x)),
        path[1:-1].ravel(),
        jac=True,
        method="L-BFGS-B",
        bounds=bounds,
        options={"maxiter": 200},
    )
    return np.vstack([path[0], result.x.reshape(-1, n), path[-1]])


_CONTROLS = 64  # of the joint-by-joint motion: follows it to about 1e-4 rad
_STEPS = 60  # of a joint's part of the path
_MOST = 12  # joints: beyond, 2^n sets of joints are too many
_AT_ONCE = 200_000  # configurations


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
        order.append(moving[last[moved]])
        moved &= ~(1 << int(last[moved]))
    return order[::-1]


def _parts(system: System, start: Array, goal: Array, moving: list[int]) -> Array:
    """Coupling length (k, 2^k) of each moving joint's part, by which have moved before.

    Of a joint alone it is the integral of sqrt(Q_jj) along its way.
    """
    count = 2 ** len(moving)
    u = quintic(np.linspace(0, 1, _STEPS + 1))
    out = np.zeros((len(moving), count))
    bits = np.arange(count)[:, None] >> np.arange(len(moving)) & 1
    at_once = max(1, _AT_ONCE // _STEPS)
    for k, j in enumerate(moving):
        sets = np.flatnonzero(bits[:, k] == 0)
        way = goal[j] - start[j]
        steps = np.diff(u) * abs(way)
        for first in range(0, len(sets), at_once):
            chunk = sets[first : first + at_once]
            q = np.repeat(start[None], len(chunk), axis=0)
            q[:, moving] += bits[chunk] * (goal - start)[moving]
            q = np.repeat(q[:, None], _STEPS, axis=1)
            q[..., j] = start[j] + (u[1:] + u[:-1]) / 2 * way
            Q = coupling_matrix(system, q)[..., j, j]
            out[k, chunk] = np.sqrt(np.maximum(Q, 0.0)) @ steps
    return out
