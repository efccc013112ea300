"""Coupling maps: two joints of an arm swept, the others given or chosen, thesis figure 4-1."""

from __future__ import annotations

import io
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.stats import qmc

from ves_gym._util.params import Array, ParameterError, require_one_of, write_bytes
from ves_gym._util.views import Viewable
from ves_gym.planners.coupling import metric
from ves_gym.planners.metric import Metric
from ves_gym.system.system import System

OTHERS = ("given", "least", "most")


@dataclass(frozen=True)
class CouplingMap(Viewable):
    """A cross-section of the coupling matrix: two joints swept, the others given or chosen."""

    joints: tuple[int, int]  # which joints, from 0
    axes: tuple[Array, Array]  # grid of each [rad]
    fixed: Array  # (n,) configuration of the others, where they are given [rad]
    duration: float | None  # of Q_T [s]; None is raw Q
    least: Array  # (ni, nj) smaller eigenvalue of the 2x2 block [J/rad^2]
    most: Array  # (ni, nj) larger eigenvalue
    direction: Array  # (ni, nj, 2) unit joint direction of least coupling
    others: str = "given"  # or chosen at every point: one of OTHERS
    angles: Array | None = None  # (ni, nj, n) configurations, where the others are chosen

    def __repr__(self) -> str:
        i, j = self.joints
        kind = "Q" if self.duration is None else f"Q_T for {self.duration:g} s"
        return (
            f"<CouplingMap: {kind} of joints {i + 1} and {j + 1}, {self.most.min():.4g} to"
            f" {self.most.max():.4g} J/rad^2 along the worst direction>"
        )

    def __str__(self) -> str:
        i, j = self.joints
        return (
            f"joints {i + 1} and {j + 1}: coupling {self.most.min():.4g} to"
            f" {self.most.max():.4g} J/rad^2 along the worst direction,"
            f" {self.least.min():.4g} to {self.least.max():.4g} along the best"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return plain data, with lines along the direction of least coupling."""
        return {
            "joints": [k + 1 for k in self.joints],
            "q": [axis.tolist() for axis in self.axes],
            "least": self.least.tolist(),
            "most": self.most.tolist(),
            "direction": self.direction.tolist(),
            "lines": [curve.tolist() for curve in self.lines()],
            **({} if self.angles is None else {"angles": self.angles.tolist()}),
        }

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the arrays as .npz, completely or not at all."""
        if Path(path).suffix != ".npz":
            raise ParameterError(f"{path}: expected a .npz name, got {Path(path).suffix!r}")
        buffer = io.BytesIO()
        arrays: dict[str, Any] = {
            k: np.asarray(v) for k, v in vars(self).items() if v is not None
        }
        np.savez_compressed(buffer, **arrays)
        write_bytes(path, buffer.getvalue())

    def lines(self) -> list[Array]:
        """Minimum-energy lines: curves (k, 2) [rad] along the least-coupling direction.

        Traced until none is missing anywhere; a line ends at the edge, where another one runs
        already, or where it has come round.
        """
        origin, second = np.array([axis[:2] for axis in self.axes]).T
        tracer = _Tracer(self.direction / (second - origin), round(1 / _SPACING))
        least = 1.5 / _SPACING / tracer.bins
        curves = [c for c in map(tracer.trace, tracer.seeds()) if len(c) * _STEP > least]
        points = (np.array(curve).view(float).reshape(-1, 2) for curve in curves)
        return [origin + k * (second - origin) for k in points]


def cross_section(
    system: System, joints: tuple[int, int], fixed: npt.ArrayLike, points: int, *, least: int
) -> tuple[tuple[Array, Array], Array]:
    """Return both axes of a cross-section of joint space, and its grid (points, points, n).

    Args:
        system: its arm has n joints.
        joints: numbers of the two joints swept over their range, from 0.
        fixed: (n,) configuration of the others [rad].
        points: of the grid, per axis; `least` are needed.
    """
    arm, (i, j) = system.arm, joints
    arm.require_turning("a coupling map")
    if points < least:
        raise ParameterError(f"points must be >= {least}, got {points}")
    at = arm.require_within_limits(fixed, "fixed")
    links = arm.links[i], arm.links[j]
    first, second = (np.linspace(link.q_min, link.q_max, points) for link in links)
    q = np.tile(at, (points, points, 1))
    q[..., i], q[..., j] = np.meshgrid(first, second, indexing="ij")
    return (first, second), q


def coupling_map(
    system: System,
    joints: tuple[int, int],
    fixed: npt.ArrayLike,
    *,
    duration: float | None = None,
    points: int = 61,
    others: str = "given",
    progress: Callable[[float], None] | None = None,
) -> CouplingMap:
    """Sweep two joints over their range, the others given or chosen at every point.

    With `others` "least" ("most") they are where the larger eigenvalue of the two joints' block
    is least (greatest): the best (worst) that a posture can make of the two.

    Args:
        system: arm and vehicle.
        joints: numbers of the two joints, from 0.
        fixed: (n,) configuration of the others [rad]; where they are chosen, a first guess.
        duration: of Q_T [s]; None for raw Q.
        points: of the grid, per axis.
        others: one of OTHERS.
        progress: called with the fraction done.

    Raises:
        ParameterError: bad points, others, duration or configuration.
    """
    require_one_of("others", others, OTHERS)
    arm, (i, j) = system.arm, joints
    axes, q = cross_section(system, joints, fixed, points, least=4)

    def block(angles: Array) -> Array:
        return metric(system, angles, duration)[..., [i, j], :][..., :, [i, j]]

    chosen = others != "given"
    if chosen:
        sign = 1.0 if others == "least" else -1.0
        of = _fast_block(system, (i, j), duration) or block
        q = minimise_on_grid(
            lambda angles: sign * _larger(of(angles)),
            q,
            [k for k in range(arm.n) if k not in joints],
            arm.column("q_min"),
            arm.column("q_max"),
            progress or (lambda done: None),
        )
    values, vectors = np.linalg.eigh(block(q))
    least, most, direction = values[..., 0], values[..., 1], vectors[..., :, 0]
    return CouplingMap((i, j), axes, np.asarray(fixed, float), duration, least, most, direction,
                       others, q if chosen else None)  # fmt: skip


def _larger(block: Array) -> Array:
    """The larger eigenvalue of symmetric (..., 2, 2)."""
    a, b, c = block[..., 0, 0], block[..., 0, 1], block[..., 1, 1]
    return np.asarray((a + c) / 2 + np.hypot((a - c) / 2, b))


def _fast_block(
    system: System, joints: tuple[int, int], duration: float | None
) -> Callable[[Array], Array] | None:
    """The block from compiled squares (a's, c's and that of their sum), None for raw Q.

    Raw Q is compiled as a whole (`coupling_matrix`).
    """
    if duration is None or not system.base.K.any() or system.arm.bends:
        return None
    squares = Metric(system, duration)
    steps = np.eye(system.arm.n)[list(joints)]
    steps = np.stack([*steps, steps.sum(axis=0)])

    def block(angles: Array) -> Array:
        a, c, sum_of_both = squares.squares(angles, steps[:, None, :])
        b = (sum_of_both - a - c) / 2
        out = np.array([[a, b], [b, c]]) - squares.least * np.eye(2)[..., None]
        return np.moveaxis(out, -1, 0)

    return block


_SAMPLES = 32  # Halton's points over the free coordinates, the same at every grid point
_SWEEPS = 12  # of the pattern search
_FIRST = 0.2  # of a coordinate's range: first step


def minimise_on_grid(
    value: Callable[[Array], Array],
    grid: Array,
    free: list[int],
    low: Array,
    high: Array,
    progress: Callable[[float], None],
) -> Array:
    """Choose the free coordinates at every point of a grid so that a function is least.

    Neighbours share what they find: the least value is continuous over the grid, so a good
    choice at one point is one beside it. Hooke and Jeeves's pattern search at all points at
    once.

    Args:
        value: (N, n) points -> (N,).
        grid: (ni, nj, n) points; a start among others.
        free: numbers of the coordinates that may change.
        low, high: (n,) bounds of all coordinates.
        progress: called with the fraction done.
    """
    if not free:
        return grid

    def of(q: Array) -> Array:
        return value(q.reshape(-1, q.shape[-1])).reshape(q.shape[:2])

    steps, done = _SAMPLES + _SWEEPS * (2 * len(free) + 5), 0
    best = grid.astype(float)
    values = of(best)

    def compare(trial: Array) -> npt.NDArray[np.bool_]:
        """Take over where a trial is better, and return where (ni, nj)."""
        nonlocal done
        done += 1
        progress(done / steps)
        tried = of(trial)
        better = np.asarray(tried < values)
        best[better], values[better] = trial[better], tried[better]
        return better

    for sample in qmc.Halton(len(free), scramble=False).random(_SAMPLES):
        trial = best.copy()
        trial[..., free] = low[free] + sample * (high - low)[free]
        compare(trial)
    size = np.full(grid.shape[:2], _FIRST)
    for _ in range(_SWEEPS):
        before, better = best.copy(), np.zeros(grid.shape[:2], bool)
        for i, j in ((2, 1), (0, 1), (1, 2), (1, 0)):  # neighbours; at the edge itself
            around = np.pad(best, ((1, 1), (1, 1), (0, 0)), mode="edge")
            trial = best.copy()
            trial[..., free] = around[i : i + len(best), j : j + best.shape[1], free]
            better |= compare(trial)
        for k in free:
            for sign in (1.0, -1.0):
                trial = best.copy()
                trial[..., k] += sign * size * (high - low)[k]
                better |= compare(np.clip(trial, low, high))
        compare(np.clip(2 * best - before, low, high))  # on in the direction that was good
        size = np.where(better, size, size / 2)
    return best


_SPACING = 0.05  # between lines, of the map's width
_STEP = 0.2  # of a line, in grid cells
_STRIDE = 7919  # prime: seeds of lines come from all over the map, not row by row

Cell = tuple[int, int]


class _Tracer:
    """Marches in units of grid cells, x + j y, and remembers where lines have been."""

    def __init__(self, field: Array, bins: int) -> None:
        self.field: list[list[complex]] = (field @ [1, 1j]).tolist()  # not normalised
        self.size = field.shape[0] - 1, field.shape[1] - 1
        self.bins = bins
        self.taken: set[Cell] = set()
        self.longest = int(8 * max(self.size) / _STEP)
        # longer away from a bin than this, a line has come round
        self.lap = int(3 * max(self.size) / bins / _STEP)

    def seeds(self) -> list[complex]:
        """The middles of all bins, in an order that jumps about."""
        count, (width, height) = self.bins**2, self.size
        at = [divmod(k * _STRIDE % count, self.bins) for k in range(count)]
        return [complex((a + 0.5) * width, (b + 0.5) * height) / self.bins for a, b in at]

    def trace(self, seed: complex) -> list[complex]:
        """The curve through a seed both ways; none where a line runs already."""
        if self.bin_of(seed) in self.taken:
            return []
        visited, (width, height) = {self.bin_of(seed)}, self.size
        heading = self.field[min(round(seed.real), width)][min(round(seed.imag), height)]
        heading /= abs(heading)
        back, ahead = (self.march(seed, way, visited) for way in (-heading, heading))
        self.taken |= visited
        return [*back[::-1], seed, *ahead]

    def march(self, at: complex, heading: complex, visited: set[Cell]) -> list[complex]:
        """Steps of the midpoint rule until the line has to end."""
        curve, (width, height) = [], self.size
        last_visit = {self.bin_of(at): 0}  # when the line was last in a bin
        for i in range(1, self.longest):
            heading = self.towards(at, heading)
            half = at + heading * _STEP / 2
            inside = min(max(half.real, 0.0), width), min(max(half.imag, 0.0), height)
            heading = self.towards(complex(*inside), heading)
            at += heading * _STEP
            if not (0 <= at.real <= width and 0 <= at.imag <= height):
                break
            cell = self.bin_of(at)
            if cell in self.taken and cell not in visited:
                break
            if i - last_visit.get(cell, i) > self.lap:
                break
            last_visit[cell] = i
            visited.add(cell)
            curve.append(at)
        return curve

    def towards(self, at: complex, heading: complex) -> complex:
        """The field between its grid points, turned to go on along a heading."""
        i, j = min(int(at.real), self.size[0] - 1), min(int(at.imag), self.size[1] - 1)
        fx, fy = at.real - i, at.imag - j
        total = 0j
        for row, share in ((self.field[i], 1 - fx), (self.field[i + 1], fx)):
            for way, weight in ((row[j], share * (1 - fy)), (row[j + 1], share * fy)):
                ahead = (way * heading.conjugate()).real >= 0
                total += weight * way if ahead else -weight * way
        return total / abs(total) if total else heading

    def bin_of(self, p: complex) -> Cell:
        """The bin that a point lies in."""
        a, b = int(p.real / self.size[0] * self.bins), int(p.imag / self.size[1] * self.bins)
        return min(a, self.bins - 1), min(b, self.bins - 1)
