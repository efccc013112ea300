"""What the leaderboard says of results, and of several. Lower is better in every score.

An episode (a query, a release) is what is drawn in the bootstrap: always with all groups that
answered it. A failure is infinite, the worst score there is; it is never left out. See
docs/leaderboard/statistics.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.stats

from ves_gym._util.params import Array, Index
from ves_gym._util.statistics import (
    STATISTICS,
    Estimate,
    Statistic,
    bootstrap,
    interval,
    iqm,
    rate,
    resample,
    wilson,
)
from ves_gym.leaderboard.entry import MEASURES, Results

NEAR = 1e-3  # median relative difference of results below which two policies are one


class Standing(NamedTuple):
    """Score, as `score` has it; rank by it, 1 the lowest; class of success, 1 the best.

    The interval of the rank is where it lies when episodes are drawn anew. Where success does
    not rank, all are of one class.
    """

    score: Estimate
    rank: Estimate
    level: int = 1


def score(results: Results) -> Estimate:
    """Interquartile mean of the score over episodes and groups; lower is better."""
    return bootstrap([results["score"].T], iqm)


def success(results: Results) -> Estimate:
    """Share that succeeded, with the Wilson interval of so many episodes."""
    return rate(results["success"].mean(axis=0))


def middle(results: Results, name: str) -> float | None:
    """Interquartile mean of a measure; None where there is none."""
    return float(iqm(results[name].ravel())) if name in results else None


def standings(candidates: Sequence[Results], *, by_success: bool = False) -> list[Standing]:
    """Return the standing of each candidate on the same draws: what is hard moves none.

    Args:
        candidates: results on the same episodes.
        by_success: rank by classes of success before the score.
    """
    score = np.array([_drawn(results["score"].T, iqm) for results in candidates])
    share = np.ones_like(score)  # (candidates, 1 + draws): as it is, then drawn anew
    if by_success:
        mean = STATISTICS["mean"]
        share = np.array([_drawn(results["success"].T, mean) for results in candidates])
    level = success_classes(share, candidates[0]["score"].shape[1])
    rank = _ranked(level, score, share)
    return [
        Standing(_estimate(s), _estimate(r), int(k[0]))
        for s, r, k in zip(score, rank, level, strict=True)
    ]


def _drawn(values: Array, statistic: Statistic) -> Array:
    """Statistic of values (episodes, groups), then of every bootstrap draw of them."""
    return np.append(float(statistic(values.ravel())), resample([values], statistic))


def _estimate(x: Array) -> Estimate:
    """Return a number with the interval of its draws, which follow it."""
    low, high = interval(x[1:])
    return Estimate(float(x[0]), float(low), float(high))


def success_classes(share: Array, n: int) -> Index:
    """Classes of success (candidates, draws), 1 the best, from shares of n solved episodes.

    One solves clearly more than another where their Wilson intervals are apart. Class 1 are
    those than whom nobody solves clearly more; class 2 are these of all who are left, and so
    on. So any two of a class have intervals that overlap, and whoever solves clearly more than
    another is in a better class.

    Args:
        share: (candidates, draws).
        n: episodes.
    """
    low, high = wilson(share, n)
    out = np.zeros(share.shape, dtype=np.intp)
    for level in range(1, len(share) + 1):
        unplaced = out == 0
        best = np.where(unplaced, low, -np.inf).max(axis=0)
        out[unplaced & (high >= best)] = level
    return out


def _ranked(level: Index, score: Array, share: Array) -> Array:
    """Ranks (candidates, draws) by class, score and share solved; ties share the better one."""
    out = np.zeros(score.shape)
    for key in (level, score, -share):  # each orders what those before it left tied
        out = scipy.stats.rankdata(
            out * (len(score) + 1) + scipy.stats.rankdata(key, "min", axis=0), "min", axis=0
        )
    return out


def repeated(results: Results, kind: str) -> tuple[int, int] | None:
    """Two groups with the same results, which would count one of them twice.

    The same: to the last bit, and of policies within `NEAR`, for a copy with noise on its
    weights, or with its hidden units in another order, does what the original does. Groups
    that have no number at all do not count.

    Args:
        results: of all groups.
        kind: of the method.
    """
    within = NEAR if kind == "policy" else 0.0
    names = [k for k in MEASURES if k in results and k != "seconds"]
    values = np.concatenate([results[name] for name in names], axis=1)  # (groups, numbers)
    for k in range(1, len(values)):
        for earlier in range(k):
            gap = _gap(values[earlier], values[k])
            if gap is not None and gap <= within:
                return earlier, k
    return None


def _gap(a: Array, b: Array) -> float | None:
    """Median relative difference; what only one has counts as 1, what neither has as none."""
    any_, both = np.isfinite(a) | np.isfinite(b), np.isfinite(a) & np.isfinite(b)
    if not any_.any():
        return None
    with np.errstate(invalid="ignore"):
        relative = np.abs(a - b) / np.maximum(np.maximum(np.abs(a), np.abs(b)), 1e-300)
    return float(np.median(np.where(both, relative, 1.0)[any_]))
