"""The hot-spot method (thesis 4.2) as an algorithm: follow least coupling, avoid hot spots.

The coupling matrix is a metric on joint space: a path's length in it is small when it
runs along minimum-energy lines and keeps out of hot spots. The planner finds a short
path on a lattice or, with more than three joints, on a roadmap of points spread evenly
through the whole joint space, relaxes it into a smooth geodesic, and times it with a quintic.
"""

from __future__ import annotations

import itertools
import math
from functools import lru_cache
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
import scipy.optimize
import scipy.sparse
import scipy.spatial
from scipy.sparse.csgraph import dijkstra
from scipy.stats import qmc

from ves_gym._util.params import Array
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.motion import Motion
from ves_gym.planners.coupling import coupling_length, metric
from ves_gym.planners.metric import LEAST, Metric
from ves_gym.planners.query import NoPlan, Query, is_feasible
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

        Args:
            query: the ends, the duration and limits.
            seed: not used.

        Returns:
            The motion, and coupling lengths [J^(1/2)].

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


# ------------------------------------------------------------------------- lattice


class JointSpaceGraph(Protocol):
    """Joint space as a graph of coupling lengths."""

    name: str

    def route(self, start: Array, goal: Array) -> Array:
        """Return the shortest path through the graph.

        Args:
            start, goal: (n,) [rad].

        Returns:
            (k, n) way-points [rad].
        """


class Lattice:
    """Joint space on a regular lattice with coupling lengths on its edges."""

    name = "lattice"

    def __init__(self, system: System, duration: float | None) -> None:
        self.axes = _axes(system.arm)
        self.shape = tuple(len(axis) for axis in self.axes)
        self.points = np.stack(np.meshgrid(*self.axes, indexing="ij"), axis=-1)
        self.system, self.duration = system, duration
        self.graph, self.least = self._edges(_moves(system.arm.n))

    def _edges(self, moves: list[tuple[int, ...]]) -> tuple[scipy.sparse.csr_array, float]:
        index = np.arange(int(np.prod(self.shape))).reshape(self.shape)
        heads, tails = [], []
        for move in moves:
            from_cells = tuple(
                slice(max(0, -m), s - max(0, m)) for m, s in zip(move, self.shape, strict=True)
            )
            to_cells = tuple(
                slice(max(0, m), s - max(0, -m)) for m, s in zip(move, self.shape, strict=True)
            )
            heads.append(index[from_cells].ravel())
            tails.append(index[to_cells].ravel())
        a, b = np.concatenate(heads), np.concatenate(tails)
        flat = self.points.reshape(-1, len(self.shape))
        lengths, least = self._lengths(flat[a], flat[b])
        return _graph(lengths, a, b, len(flat)), least

    def _lengths(self, a: Array, b: Array, least: float | None = None) -> tuple[Array, float]:
        step = b - a
        Q = metric(self.system, (a + b) / 2, self.duration)
        if least is None:
            least = float(LEAST * np.mean(np.trace(Q, axis1=-2, axis2=-1)) / step.shape[-1])
        squares = np.einsum("ki,kij,kj->k", step, Q, step) + least * np.sum(step**2, axis=-1)
        return np.sqrt(np.maximum(squares, 0)), least

    def route(self, start: Array, goal: Array) -> Array:
        """Return the shortest path from start to goal through the lattice.

        Args:
            start, goal: (n,) [rad].

        Returns:
            (k, n) way-points [rad].
        """
        flat = self.points.reshape(-1, len(self.shape))
        size = len(flat)
        rows, columns, values = [], [], []
        for end, q in ((size, start), (size + 1, goal)):
            near = np.flatnonzero((np.abs(flat - q) <= 1.5 * _PITCH).all(axis=1))
            lengths, _ = self._lengths(
                np.broadcast_to(q, flat[near].shape), flat[near], self.least
            )
            rows.append(np.full(len(near), end))
            columns.append(near)
            values.append(lengths)
        old = self.graph.tocoo()
        a = np.concatenate([old.row, *rows])
        b = np.concatenate([old.col, *columns])
        graph = _graph(np.concatenate([old.data, *values]), a, b, size + 2)
        return np.vstack([flat, start, goal])[_shortest(graph, size, size + 1)]


class Roadmap:
    """Joint space of any dimension as Halton's points, joined to their neighbours.

    The number of neighbours is that of PRM* (Karaman and Frazzoli 2011).
    """

    name = "roadmap"

    def __init__(self, system: System, duration: float | None) -> None:
        arm = system.arm
        low, high = arm.column("q_min"), arm.column("q_max")
        # "qt" and "q" as the lattice has them, compiled
        self.metric = Metric(system, "q" if duration is None else "qt", duration)
        halton = qmc.Halton(arm.n, scramble=False).random(_ROADMAP)
        self.points = qmc.scale(halton, low, high)
        self.neighbours = int(np.ceil(math.e * (1 + 1 / arm.n) * np.log(_ROADMAP)))
        self.tree = scipy.spatial.cKDTree(self.points)
        _, near = self.tree.query(self.points, self.neighbours + 1)
        a = np.repeat(np.arange(_ROADMAP), self.neighbours)
        self.edges = a, near[:, 1:].ravel()
        self.lengths = self.metric.lengths(self.points[a], self.points[self.edges[1]])

    def route(self, start: Array, goal: Array) -> Array:
        """Return the shortest path from start to goal through the roadmap.

        Args:
            start, goal: (n,) [rad].

        Returns:
            (k, n) way-points [rad].
        """
        ends, size = np.array([start, goal]), len(self.points)
        _, near = self.tree.query(ends, self.neighbours)
        a = np.repeat([size, size + 1], self.neighbours)
        lengths = self.metric.lengths(ends[a - size], self.points[near.ravel()])
        graph = _graph(
            np.concatenate([self.lengths, lengths, [self.metric.lengths(start, goal)]]),
            np.concatenate([self.edges[0], a, [size]]),
            np.concatenate([self.edges[1], near.ravel(), [size + 1]]),
            size + 2,
        )
        return np.vstack([self.points, ends])[_shortest(graph, size, size + 1)]


def _shortest(graph: scipy.sparse.csr_array, a: int, b: int) -> list[int]:
    """Nodes on the shortest way from a to b."""
    _, before = dijkstra(graph, directed=False, indices=a, return_predecessors=True)
    nodes = [b]
    while nodes[-1] != a:
        nodes.append(int(before[nodes[-1]]))
    return nodes[::-1]


def _axes(arm: Arm) -> list[Array]:
    low, high = arm.column("q_min"), arm.column("q_max")
    return [
        np.arange(np.ceil(a / _PITCH), np.floor(b / _PITCH) + 1) * _PITCH
        for a, b in zip(low, high, strict=True)
    ]


def _moves(n: int) -> list[tuple[int, ...]]:
    return [m for m in itertools.product((-1, 0, 1), repeat=n) if m > (0,) * n]


def _graph(lengths: Array, a: Ints, b: Ints, size: int) -> scipy.sparse.csr_array:
    # 32-bit indices: what SciPy's graph routines take in every supported release
    ends = a.astype(np.int32), b.astype(np.int32)
    return scipy.sparse.csr_array((lengths, ends), shape=(size, size))


@lru_cache(maxsize=16)
def _network(system: System, duration: float | None) -> JointSpaceGraph:
    """A lattice where it is small enough."""
    nodes = int(np.prod([len(axis) for axis in _axes(system.arm)]))
    if nodes * (3**system.arm.n - 1) // 2 <= _LARGEST:
        return Lattice(system, duration)
    return Roadmap(system, duration)


# ---------------------------------------------------------------------- relaxation


def resample(path: Array, points: int) -> Array:
    """Points evenly spaced in joint-space length along a polyline, its ends unchanged.

    Args:
        path: (k, n) way-points [rad].
        points: how many.

    Returns:
        (points, n) [rad].
    """
    length = np.r_[0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))]
    at = np.linspace(0, length[-1], points)
    return np.stack([np.interp(at, length, path[:, j]) for j in range(path.shape[1])], axis=1)


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


def feasible_part(query: Query, path: Array) -> tuple[Motion, float]:
    """Time a path, drawn towards the straight line until it respects the limits.

    Args:
        query: the duration and limits.
        path: (k, n) way-points [rad].

    Returns:
        The motion, and the share of the way from the straight line that is left [1].
    """
    straight = np.linspace(path[0], path[-1], len(path))

    def timed(share: float) -> Motion:
        return Motion.through(straight + share * (path - straight), query.duration)

    if is_feasible(query, timed(1.0)) or not is_feasible(query, timed(0.0)):
        return timed(1.0), 1.0
    low, high = 0.0, 1.0
    for _ in range(8):
        middle = (low + high) / 2
        low, high = (middle, high) if is_feasible(query, timed(middle)) else (low, middle)
    return timed(low), low
