"""Least values over some coordinates at every point of a grid of two others.

Neighbours share what they find: the least value is continuous over the grid, so a good
choice at one point is one beside it. Hooke and Jeeves's pattern search at all points at once.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from scipy.stats import qmc

from ves_gym._util.params import Array

_SAMPLES = 32  # Halton's points over the free coordinates, the same at every grid point
_SWEEPS = 12  # of the pattern search
_FIRST = 0.2  # of a coordinate's range: first step


def minimise_on_grid(
    value: Callable[[Array], Array],
    grid: Array,
    free: list[int],
    low: Array,
    high: Array,
    progress: Callable[[float], None] | None = None,
) -> Array:
    """Choose the free coordinates at every grid point so that a function is least.

    Args:
        value: (N, n) points -> (N,).
        grid: (ni, nj, n) points; a start among others.
        free: numbers of the coordinates that may change.
        low, high: (n,) bounds of all coordinates.
        progress: called with the fraction done.

    Returns:
        (ni, nj, n) the grid, its free coordinates chosen.
    """
    best = _Best(value, grid)
    if not free:
        return grid
    steps, done = _SAMPLES + _SWEEPS * (2 * len(free) + 5), 0

    def compare(trial: Array) -> npt.NDArray[np.bool_]:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done / steps)
        return best.compare(trial)

    for sample in qmc.Halton(len(free), scramble=False).random(_SAMPLES):
        trial = best.q.copy()
        trial[..., free] = low[free] + sample * (high - low)[free]
        compare(trial)
    size = np.full(grid.shape[:2], _FIRST)
    for _ in range(_SWEEPS):
        before, better = best.q.copy(), np.zeros(grid.shape[:2], bool)
        for rows, columns in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            trial = best.q.copy()
            trial[..., free] = _shifted(best.q, rows, columns)[..., free]
            better |= compare(trial)
        for k in free:
            for sign in (1.0, -1.0):
                trial = best.q.copy()
                trial[..., k] += sign * size * (high - low)[k]
                better |= compare(np.clip(trial, low, high))
        compare(np.clip(2 * best.q - before, low, high))  # on in the direction that was good
        size = np.where(better, size, size / 2)
    return best.q


class _Best:
    """The best points so far and their values."""

    def __init__(self, value: Callable[[Array], Array], grid: Array) -> None:
        self._value, self.q = value, grid.astype(float)
        self.least = self._of(self.q)

    def _of(self, q: Array) -> Array:
        return self._value(q.reshape(-1, q.shape[-1])).reshape(q.shape[:2])

    def compare(self, trial: Array) -> npt.NDArray[np.bool_]:
        """Take over where a trial is better, and return where (ni, nj)."""
        values = self._of(trial)
        better = np.asarray(values < self.least)
        self.q[better], self.least[better] = trial[better], values[better]
        return better


def _shifted(q: Array, rows: int, columns: int) -> Array:
    """Every point's neighbour; at the edge the point itself."""
    i = np.clip(np.arange(q.shape[0]) + rows, 0, q.shape[0] - 1)
    j = np.clip(np.arange(q.shape[1]) + columns, 0, q.shape[1] - 1)
    out: Array = q[np.ix_(i, j)]
    return out
