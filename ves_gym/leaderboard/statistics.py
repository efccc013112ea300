"""What the leaderboard says of an entry, and of two. Lower is better in every score.

An episode (a query, a case) is what is drawn in the bootstrap: always with all training seeds
that played it, and within its problem, so problems are strata. A failure is the worst score
there is, mostly infinity; it is never left out. See docs/leaderboard/statistics.md.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy.stats

from ves_gym._util.params import Array, Index, ParameterError
from ves_gym._util.statistics import (
    RESAMPLES,
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

Entry = Mapping[str, Any]  # plain data, as it stands in the journal
# Episodes. Of shares the interval is Wilson's, which holds for few (Brown et al. 2001).
MINIMUM = {"paths": 20, "policies": 50, "tasks": 50, "damping": 50, "discrepancy": 30}
STATISTIC = {
    "paths": "iqm",
    "policies": "iqm",
    "tasks": "iqm",
    "damping": "iqm",
    "discrepancy": "mean",
}
WORST = {"discrepancy": 1.0}  # what a failure scores where the scale has an end
BY_SUCCESS = ("tasks",)  # tracks that rank by classes of success before they do by the score


_FEWEST = 10  # episodes that two entries both solved, for their energies to be compared


class Profile(NamedTuple):
    """Share of episodes with a score of at most `at`, and its 95 % band; each (n,)."""

    at: Array
    share: Array
    low: Array
    high: Array


class Standing(NamedTuple):
    """Score, as `score` has it; rank by it, 1 the lowest; class of success, 1 the best.

    The interval of the rank is where it lies when episodes are drawn anew. In tracks that do
    not rank by success all are of one class.
    """

    score: Estimate
    rank: Estimate
    level: int = 1


def values(entry: Entry, key: str = "score") -> Array:
    """A number of every row, (episodes, training seeds); what is null is the worst there is.

    Episodes come in the order of their ids and seeds, whatever order the rows have.

    Raises:
        ParameterError: an episode is there twice, or not under every training seed.
    """
    groups = sorted({row["group"] for row in entry["rows"]})
    column = {g: k for k, g in enumerate(groups)}
    place = {episode: k for k, episode in enumerate(episodes(entry))}
    worst = WORST.get(entry["track"], np.inf) if key == "score" else np.inf
    out = np.full((len(place), len(groups)), np.nan)
    for row in entry["rows"]:
        at = place[row["id"], row["seed"]], column[row["group"]]
        if not np.isnan(out[at]):
            raise ParameterError(f"{_name(entry)}: {_row(row)} is there twice")
        out[at] = worst if row.get(key) is None else row[key]
    missing = np.argwhere(np.isnan(out))
    if len(missing):
        episode, group = list(place)[missing[0][0]], groups[missing[0][1]]
        raise ParameterError(
            f"{_name(entry)}: episode {episode[0]!r}, seed {episode[1]} is missing in group"
            f" {group}; every training seed plays the same episodes"
        )
    return out


def episodes(entry: Entry) -> list[tuple[str, int]]:
    """Id and seed of every episode, in order."""
    return sorted({(row["id"], row["seed"]) for row in entry["rows"]})


def require_enough(entry: Entry) -> None:
    """An entry on fewer episodes than its track demands is no evidence.

    Raises:
        ParameterError: names the track, the number of episodes and the least number.
    """
    least, n = MINIMUM[entry["track"]], len(episodes(entry))
    if n < least:
        raise ParameterError(
            f"{_name(entry)}: track {entry['track']} needs at least {least} episodes, got {n}"
        )


# ----------------------------------------------------------------------- one entry


def score(entries: Sequence[Entry]) -> Estimate:
    """The track's statistic of the score over one or several problems; lower is better.

    A share has the Wilson interval of so many episodes: one of draws has no width where all
    episodes agree, and is too narrow where there are few.
    """
    if _is_share(entries):
        return _share(entries)
    return bootstrap([values(e) for e in entries], statistic(entries[0]))


def _is_share(entries: Sequence[Entry]) -> bool:
    return STATISTIC[entries[0]["track"]] == "mean"


def _share(entries: Sequence[Entry]) -> Estimate:
    return rate(np.concatenate([values(e).mean(axis=1) for e in entries]))


def statistic(entry: Entry) -> Statistic:
    """Return the statistic of an entry's scores: interquartile mean, or the mean of 0 and 1."""
    return STATISTICS[STATISTIC[entry["track"]]]


def success(entries: Sequence[Entry]) -> Estimate:
    """Share that succeeded, with the Wilson interval of so many episodes."""
    return rate(np.concatenate([values(e, "success").mean(axis=1) for e in entries]))


def middle(entries: Sequence[Entry], key: str) -> float | None:
    """Interquartile mean of another number; None where no row has it."""
    if all(row.get(key) is None for e in entries for row in e["rows"]):
        return None
    return float(iqm(np.concatenate([values(e, key).ravel() for e in entries])))


def by_training_seed(entry: Entry) -> list[float]:
    """The score of every training seed alone."""
    return [float(k) for k in statistic(entry)(values(entry).T)]


def thresholds(entries: Sequence[Entry], points: int = 61) -> Array:
    """Scores at which profiles are taken, ends included: evenly spaced, and where scores are.

    One in three is spaced evenly (geometrically where all are above zero), the others are
    quantiles of all scores.
    """
    scores = np.concatenate([values(e).ravel() for e in entries])
    scores = scores[np.isfinite(scores)]
    if not len(scores):
        return np.array([0.0, 1.0])
    low, high = float(scores.min()), float(scores.max())
    if low == high:  # some room to either side
        return np.array([low - 0.5 * (abs(low) or 1.0), low, high + 0.5 * (abs(high) or 1.0)])
    space = np.geomspace if low > 0 else np.linspace
    even = space(low, high, points // 3)[1:-1]
    dense = np.quantile(scores, np.linspace(0, 1, points - len(even)), method="nearest")
    return np.unique(np.concatenate([even, dense]))


def profile(entries: Sequence[Entry], at: Array) -> Profile:
    """Performance profile: the higher, the better; failures are above every threshold."""
    below = [(values(e)[:, :, None] <= at).mean(axis=1) for e in entries]
    n = sum(len(b) for b in below)
    share = np.concatenate(below).sum(axis=0) / n
    drawn = np.zeros((RESAMPLES, len(at)))
    for times, b in zip(_times(tuple(map(len, below))), below, strict=True):
        drawn += times @ b / n
    return Profile(at, share, *interval(drawn))


@functools.lru_cache(maxsize=8)
def _times(sizes: tuple[int, ...]) -> tuple[Array, ...]:
    """How often each of so many episodes is drawn, with replacement, (RESAMPLES, n) each."""
    rng = np.random.Generator(np.random.PCG64(0))
    drawn = (rng.multinomial(n, np.full(n, 1 / n), size=RESAMPLES) for n in sizes)
    return tuple(counts.astype(np.float64) for counts in drawn)


def anytime(entry: Entry, at: Array) -> Array:
    """Interquartile mean of the score that stood after `at` seconds, (n,); inf before any.

    The cost that a search tells of is its own; it is scaled to end in the score of the row.
    """
    stood = np.full((len(entry["rows"]), len(at)), np.inf)
    for k, row in enumerate(entry["rows"]):
        if row["score"] is None or not row.get("anytime"):
            continue
        seconds, cost = np.array(row["anytime"], float).T
        latest = np.searchsorted(seconds, at, side="right") - 1
        scale = row["score"] / cost[-1] if cost[-1] > 0 else 1.0
        stood[k, latest >= 0] = scale * cost[latest[latest >= 0]]
    return iqm(stood.T)


# --------------------------------------------------------------------- two and more


def improvement(a: Sequence[Entry], b: Sequence[Entry]) -> Estimate:
    """Probability that a scores lower than b on the same episode; a tie counts half.

    Args:
        a, b: entries of the same problems in the same order.

    Raises:
        ParameterError: they did not play the same episodes.
    """
    wins = [_wins(x, y) for x, y in zip(a, b, strict=True)]
    return bootstrap(wins, lambda x: np.asarray(x.mean(axis=-1)))


def _wins(a: Entry, b: Entry) -> Array:
    """By episode: share of pairs of training seeds in which a is lower."""
    if a["problem"] != b["problem"] or episodes(a) != episodes(b):
        raise ParameterError(f"{_name(a)} and {_name(b)} did not play the same episodes")
    x, y = values(a)[:, :, None], values(b)[:, None, :]
    return np.asarray(((x < y) + 0.5 * (x == y)).mean(axis=(1, 2)))


def standings(candidates: Sequence[Sequence[Entry]]) -> list[Standing]:
    """Return the standing of each candidate on the same draws: what is hard moves none."""
    played = [[(e["problem"], episodes(e)) for e in entries] for entries in candidates]
    for entries, cases in zip(candidates, played, strict=True):
        if cases != played[0]:
            raise ParameterError(
                f"{_name(entries[0])} and {_name(candidates[0][0])} did not play the same"
                " episodes"
            )
    of = statistic(candidates[0][0])
    strata = [[values(e) for e in entries] for entries in candidates]
    value = [float(of(np.concatenate([g.ravel() for g in group]))) for group in strata]
    drawn = np.array([resample(group, of) for group in strata])  # (candidates, draws)
    level = np.ones(len(candidates), dtype=np.intp)
    if candidates[0][0]["track"] in BY_SUCCESS:
        mean, n = STATISTICS["mean"], sum(len(k) for k in strata[0])
        solved = [[values(e, "success") for e in entries] for entries in candidates]
        share = np.array([success(entries).value for entries in candidates])
        level = success_classes(share[:, None], n)[:, 0]
        rank = _ranked(level[:, None], np.array(value)[:, None], share[:, None])[:, 0]
        shares = np.array([resample(group, mean) for group in solved])
        placed = _ranked(success_classes(shares, n), drawn, shares)
    else:
        rank = scipy.stats.rankdata(value, "min")
        placed = scipy.stats.rankdata(drawn, "min", axis=0)
    if _is_share(candidates[0]):
        scores = [_share(entries) for entries in candidates]
    else:
        ends = zip(*interval(drawn.T), strict=True)
        scores = [Estimate(v, *map(float, two)) for v, two in zip(value, ends, strict=True)]
    places = zip(*interval(placed.T), strict=True)
    return [
        Standing(found, Estimate(float(r), *map(float, two)), int(k))
        for found, r, two, k in zip(scores, rank, places, level, strict=True)
    ]


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
        left = out == 0
        best = np.where(left, low, -np.inf).max(axis=0)
        out[left & (high >= best)] = level
    return out


def _ranked(level: Index, score: Array, share: Array) -> Array:
    """Ranks (candidates, draws) by class, score and share solved; ties share the better one."""
    out = np.zeros(score.shape)
    for key in (level, score, -share):  # each orders what those before it left tied
        out = scipy.stats.rankdata(
            out * (len(score) + 1) + scipy.stats.rankdata(key, "min", axis=0), "min", axis=0
        )
    return out


def energy_over(a: Entry, b: Entry) -> tuple[Estimate, int] | None:
    """Median of a's E_mean over b's, of the episodes that both solved, and how many these are.

    Args:
        a: an entry, of any number of training seeds: an episode counts under those that solved
            it.
        b: what it is compared with, the first training seed of which counts.

    Returns:
        None where there are fewer than 10 such episodes, or b moves nothing in them.
    """
    if a["problem"] != b["problem"] or episodes(a) != episodes(b):
        raise ParameterError(f"{_name(a)} and {_name(b)} did not play the same episodes")
    x, y = values(a, "E_mean"), values(b, "E_mean")[:, :1]
    both = (values(a, "success") > 0) & (values(b, "success")[:, :1] > 0) & (y > 0)
    of_both = both.any(axis=1)
    if of_both.sum() < _FEWEST:
        return None
    ratio = np.where(both, x / np.where(y > 0, y, 1.0), np.nan)[of_both]
    found = bootstrap([np.nanmedian(ratio, axis=1)], STATISTICS["median"])
    return found, int(of_both.sum())


def _name(entry: Entry) -> str:
    return f"{entry['name']} on {entry['problem']}"


def _row(row: Mapping[str, Any]) -> str:
    return f"episode {row['id']!r}, seed {row['seed']}, group {row['group']}"
