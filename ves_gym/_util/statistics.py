"""Numbers with their 95 % intervals: bootstrap, interquartile mean, rates.

Values may be infinite: a run that failed is the worst there is, not a missing one.
Every draw comes from one fixed seed, so the same values give the same interval.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, Mask

RESAMPLES = 2000
_Z = 1.959964  # standard deviations of a two-sided 95 % interval

Statistic = Callable[[Array], Array]
Places = npt.NDArray[np.int64]


class Estimate(NamedTuple):
    """A number and its 95 % interval."""

    value: float
    low: float
    high: float


def iqm(x: Array) -> Array:
    """Interquartile mean along the last axis: n // 4 values are cut off at either end."""
    ordered = np.sort(x, axis=-1)
    cut = x.shape[-1] // 4
    out: Array = ordered[..., cut : x.shape[-1] - cut].mean(axis=-1)
    return out


STATISTICS: dict[str, Statistic] = {
    "mean": lambda x: np.asarray(x.mean(axis=-1)),
    "median": lambda x: np.asarray(np.median(x, axis=-1)),
    "iqm": iqm,
}


def bootstrap(strata: Sequence[Array], statistic: Statistic) -> Estimate:
    """Percentile interval of a statistic, of the last axis, of all values; every stratum keeps
    its size.

    A stratum is (n,), or (n, m): m values that belong together and are drawn together, such as
    the same episode under m policies.
    """
    pooled = np.concatenate([g.ravel() for g in strata])
    with np.errstate(invalid="ignore"):  # inf - inf inside a median
        value = float(statistic(pooled))
    low, high = interval(resample(strata, statistic))
    return Estimate(value, float(low), float(high))


def resample(strata: Sequence[Array], statistic: Statistic) -> Array:
    """Return the statistic of every bootstrap draw (RESAMPLES,); strata of equal sizes are
    drawn alike."""
    places = _places(tuple(len(g) for g in strata))
    drawn = [g[at].reshape(RESAMPLES, -1) for g, at in zip(strata, places, strict=True)]
    with np.errstate(invalid="ignore"):
        return np.asarray(statistic(np.concatenate(drawn, axis=1)))


@functools.lru_cache(maxsize=8)
def _places(sizes: tuple[int, ...]) -> tuple[Places, ...]:
    """Which values each draw takes of groups of these sizes, (RESAMPLES, size) each."""
    rng = np.random.Generator(np.random.PCG64(0))
    return tuple(rng.integers(size, size=(RESAMPLES, size)) for size in sizes)


def interval(spread: Array) -> tuple[Array, Array]:
    """Ends of the 95 % percentile interval of draws along the first axis.

    Order statistics, not interpolated: between a number and infinity there is nothing.
    """
    ordered, n = np.sort(spread, axis=0), len(spread)
    return ordered[int(0.025 * n)], ordered[int(0.975 * n) - 1]


def rate(hits: Array | Mask) -> Estimate:
    """Share of hits with its Wilson interval: a bootstrap of all or none has no width.

    Hits (n,) or (n, m), or shares of hits (n,): what belongs together counts once for the
    width, as if the m always agreed.
    """
    p = float(hits.mean())
    low, high = wilson(np.asarray(p), len(hits))
    return Estimate(p, float(low), float(high))


def wilson(p: Array, n: int) -> tuple[Array, Array]:
    """Ends of the 95 % Wilson intervals of shares p of n trials, shaped as p."""
    middle = (p + _Z**2 / (2 * n)) / (1 + _Z**2 / n)
    half = _Z * np.sqrt(p * (1 - p) / n + (_Z / (2 * n)) ** 2) / (1 + _Z**2 / n)
    return np.maximum(0.0, middle - half), np.minimum(1.0, middle + half)
