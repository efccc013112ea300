"""Evenly spaced curves along a field of directions without sign: minimum-energy lines of a map.

Plain floats: a curve takes thousands of steps, too small for arrays to pay.
"""

from __future__ import annotations

import math

import numpy as np

from ves_gym._util.params import Array

_STRIDE = 7919  # prime: seeds of lines come from all over the map, not row by row

Point = tuple[float, float]
Cell = tuple[int, int]


def trace_lines(
    axes: tuple[Array, Array], field: Array, spacing: float, step: float
) -> list[Array]:
    """Trace lines until none is missing anywhere.

    A line ends at the edge, where another one runs already, or where it has come round.

    Args:
        axes: grid of both coordinates, evenly spaced, (ni,) and (nj,).
        field: (ni, nj, 2) unit directions, their sign without meaning.
        spacing: least distance between lines, as a fraction of the map's width.
        step: integration step in grid cells.

    Returns:
        Polylines (k, 2) in the unit of the axes.
    """
    origin = np.array([axes[0][0], axes[1][0]])
    cell = np.array([axes[0][1] - axes[0][0], axes[1][1] - axes[1][0]])
    tracer = _Tracer(field / cell, max(2, round(1 / spacing)), step)
    least = 1.5 / spacing / tracer.bins
    curves = [c for c in map(tracer.trace, tracer.seeds()) if len(c) * step > least]
    return [origin + np.array(curve) * cell for curve in curves]


class _Tracer:
    """Marches in units of grid cells and remembers where lines have been."""

    def __init__(self, field: Array, bins: int, step: float) -> None:
        self.field: list[list[list[float]]] = field.tolist()  # per cell, not normalised
        self.size = field.shape[0] - 1, field.shape[1] - 1
        self.bins, self.step = bins, step
        self.taken: set[Cell] = set()
        self.longest = int(8 * max(self.size) / step)
        # longer away from a bin than this, a line has come round
        self.lap = int(3 * max(self.size) / bins / step)

    def seeds(self) -> list[Point]:
        """The middles of all bins, in an order that jumps about."""
        count = self.bins**2
        at = [divmod(k * _STRIDE % count, self.bins) for k in range(count)]
        width, height = self.size
        return [((a + 0.5) / self.bins * width, (b + 0.5) / self.bins * height) for a, b in at]

    def trace(self, seed: Point) -> list[Point]:
        """The curve through a seed both ways; none where a line runs already."""
        if self.bin_of(seed) in self.taken:
            return []
        visited = {self.bin_of(seed)}
        i, j = (min(round(x), most) for x, most in zip(seed, self.size, strict=True))
        dx, dy = self.field[i][j]
        length = math.hypot(dx, dy)
        heading = dx / length, dy / length
        back = self.march(seed, (-heading[0], -heading[1]), visited)
        ahead = self.march(seed, heading, visited)
        self.taken |= visited
        return [*back[::-1], seed, *ahead]

    def march(self, at: Point, heading: Point, visited: set[Cell]) -> list[Point]:
        """Steps of the midpoint rule until the line has to end."""
        curve, (x, y), step = [], at, self.step
        width, height = self.size
        last_visit = {self.bin_of(at): 0}  # when the line was last in a bin
        for i in range(1, self.longest):
            heading = self.towards(x, y, heading)
            middle_x = min(max(x + heading[0] * step / 2, 0.0), width)
            middle_y = min(max(y + heading[1] * step / 2, 0.0), height)
            heading = self.towards(middle_x, middle_y, heading)
            x, y = x + heading[0] * step, y + heading[1] * step
            if x < 0 or y < 0 or x > width or y > height:
                break
            cell = self.bin_of((x, y))
            if cell in self.taken and cell not in visited:
                break
            if i - last_visit.get(cell, i) > self.lap:
                break
            last_visit[cell] = i
            visited.add(cell)
            curve.append((x, y))
        return curve

    def towards(self, x: float, y: float, heading: Point) -> Point:
        """The field between its grid points, turned to go on along a heading."""
        i, j = min(int(x), self.size[0] - 1), min(int(y), self.size[1] - 1)
        fx, fy = x - i, y - j
        hx, hy = heading
        total_x = total_y = 0.0
        for row, share in ((self.field[i], 1 - fx), (self.field[i + 1], fx)):
            for (dx, dy), weight in ((row[j], share * (1 - fy)), (row[j + 1], share * fy)):
                if dx * hx + dy * hy < 0:
                    weight = -weight
                total_x += weight * dx
                total_y += weight * dy
        length = math.hypot(total_x, total_y)
        return (total_x / length, total_y / length) if length > 0 else heading

    def bin_of(self, p: Point) -> Cell:
        """The bin that a point lies in."""
        a, b = (
            min(int(x / most * self.bins), self.bins - 1)
            for x, most in zip(p, self.size, strict=True)
        )
        return a, b
