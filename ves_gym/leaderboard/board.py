"""From the journal to what the page shows: entries ranked, with all their statistics.

The board is derived: the same journal gives the same board, to the last bit.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym.baselines.policy import task_name
from ves_gym.baselines.registry import REFERENCES
from ves_gym.leaderboard import statistics
from ves_gym.leaderboard.entry import LEVELS
from ves_gym.leaderboard.evaluators import history_reason
from ves_gym.leaderboard.journal import Journal
from ves_gym.leaderboard.protocol import QUICK
from ves_gym.leaderboard.record import Record
from ves_gym.leaderboard.tracks.base import NEAR, difference

SCHEMA = "ves-board/2"
ALL = "all problems"
TRACKS = {  # in the order of the page
    "paths": "Paths",
    "policies": "Policies",
    "tasks": "Tasks",
    "damping": "Damping",
    "discrepancy": "Discrepancy",
}
RANKED = "reproduced"  # level of entries that are compared
_SHOWN = "replayed: the method itself was not run again"
ENERGIES = ("E_mean", "E_decay", "E_peak", "E_res")
RATIOS = ("paths", "damping")  # tracks whose scores are ratios to something that is done today
RELATIVE = ("paths",)  # tracks whose scores mean the same in every problem
_COMPARED = 12  # entries in the matrix of improvements: the best
_POINTS = 41  # of anytime curves
_DIGITS = 6

Plain = dict[str, Any]
History = Callable[[Mapping[str, Any]], str | None]


def make_board(journal: Journal, history: History = history_reason) -> Plain:
    """Return plain data of schema ves-board/2.

    Rows of two seasons of official seeds are never compared: their seeds are two.
    Of an entry that came again (same track, problem, seeds, author and name) the latest
    counts, but none of a lower level than one before. Ranked is what was reproduced; what was
    only replayed is in `shown`. An entry that cannot be compared, for too few or other
    episodes, is not ranked; `unranked` says why. One by an evaluator of another version than
    today's is in `history`.

    Args:
        journal: what is on the board.
        history: why an entry is not of today's version, None where it is.
    """
    unranked: list[Plain] = []
    present, past = divided(journal.records, history)
    shown = [r for r in present if r.entry["level"] != RANKED]
    ranked = [r for r in present if r.entry["level"] == RANKED]
    cells = _cells(ranked, unranked, journal.seasons)
    tracks = []
    for track, title in TRACKS.items():
        groups = [
            _group(*key[1:], members) for key, members in cells.items() if key[0] == track
        ]
        if groups:
            protocol = next(iter(groups))["protocol"]
            groups.sort(key=lambda g: (g["problem"] == ALL, g["problem"], g["seeds"]))
            tracks.append(
                {"track": track, "title": title, "protocol": protocol, "groups": groups}
            )
    return {
        "schema": SCHEMA,
        "head": journal.head,
        "entries": len(journal.records),
        "newest": max((r.entry["about"]["ended"] for r in journal.records), default=None),
        "tracks": tracks,
        "unranked": unranked,
        "shown": [_past(record, _SHOWN, journal.seasons) for record in shown],
        "history": [_past(record, why, journal.seasons) for record, why in past],
    }


def divided(
    records: Sequence[Record], history: History = history_reason
) -> tuple[list[Record], list[tuple[Record, str]]]:
    """Return the records that count, and those of older versions with the reason.

    In both the latest of each entry, of those with its highest level, in the order in which
    they were entered.

    Args:
        records: of the journal.
        history: why an entry is not of today's version, None where it is.
    """
    latest: dict[tuple[str, ...], tuple[Record, str | None]] = {}
    for record in records:
        e, why = record.entry, history(record.entry)
        key = (
            *(str(e[k]) for k in ("track", "problem", "seeds", "author", "name")),
            str(e["about"].get("salt")),
            why or "",
        )
        if key in latest and _level(record) < _level(latest[key][0]):
            continue
        latest[key] = record, why
    ordered = sorted(latest.values(), key=lambda pair: pair[0].order)
    return [r for r, why in ordered if why is None], [(r, w) for r, w in ordered if w]


def _level(record: Record) -> int:
    return LEVELS.index(record.entry["level"])


def named_seeds(entry: Mapping[str, Any], seasons: Mapping[str, str]) -> str:
    """Return which seeds a row is of: `public`, or `official` and the season.

    Args:
        entry: plain data of schema ves-entry/1.
        seasons: names, by the marks of their salts; of another the mark's first digits.
    """
    mark = entry["about"].get("salt")
    seeds = str(entry["seeds"])
    return seeds if mark is None else f"{seeds} {seasons.get(mark, mark[:8])}"


def _past(record: Record, why: str, seasons: Mapping[str, str]) -> Plain:
    """Return what stays readable of an entry that is not ranked."""
    e = record.entry
    try:
        score = _plain(statistics.score([e]))
    except ParameterError:  # too few episodes for an interval
        score = None
    return {
        "id": record.id,
        **{k: e[k] for k in ("track", "problem", "name", "author", "level", "bundle")},
        "seeds": named_seeds(e, seasons),
        "score": score,
        "why": why,
    }


Candidate = tuple[Record, ...]  # one record, or one per problem


def _cells(
    records: Sequence[Record], unranked: list[Plain], seasons: Mapping[str, str]
) -> dict[tuple[str, str, str], list[Candidate]]:
    """By track, problem and seeds: the candidates that can be compared with each other."""
    cells: dict[tuple[str, str, str], list[Record]] = defaultdict(list)
    for record in records:
        e = record.entry
        try:
            statistics.require_enough(e)
            statistics.values(e)
        except ParameterError as error:
            unranked.append(_why(record, str(error)))
        else:
            cells[e["track"], e["problem"], named_seeds(e, seasons)].append(record)
    out: dict[tuple[str, str, str], list[Candidate]] = {}
    for key, members in cells.items():
        out[key] = [(r,) for r in _alike(members, unranked)]
    for track, seeds in sorted({(k[0], k[2]) for k in out}):
        problems = sorted(k for k in out if (k[0], k[2]) == (track, seeds))
        overall = _over_all([out[k] for k in problems]) if track in RELATIVE else []
        if overall:
            out[track, ALL, seeds] = overall
    return out


def _alike(records: list[Record], unranked: list[Plain]) -> list[Record]:
    """Those with the episodes and the score that most have."""
    kinds = [_kind(r.entry) for r in records]
    usual = Counter(kinds).most_common(1)[0][0]
    for record, kind in zip(records, kinds, strict=True):
        if kind != usual:
            what = "other episodes" if kind[0] == usual[0] else "another score"
            unranked.append(_why(record, f"{what} than the rest"))
    return [r for r, kind in zip(records, kinds, strict=True) if kind == usual]


def _kind(entry: Mapping[str, Any]) -> tuple[Any, ...]:
    return tuple(sorted(entry["score"].items())), tuple(statistics.episodes(entry))


def _over_all(problems: list[list[Candidate]]) -> list[Candidate]:
    """Return those who have an entry in every problem of a track."""
    if len(problems) < 2:
        return []
    by_name = [
        {(c[0].entry["author"], c[0].entry["name"]): c[0] for c in members}
        for members in problems
    ]
    return [
        tuple(p[who] for p in by_name) for who in by_name[0] if all(who in p for p in by_name)
    ]


def _why(record: Record, reason: str) -> Plain:
    e = record.entry
    reason = reason.removeprefix(f"{e['name']} on {e['problem']}: ")
    return {"id": record.id, "name": e["name"], "problem": e["problem"], "why": reason}


# -------------------------------------------------------------------------- a group


def _group(problem: str, seeds: str, candidates: list[Candidate]) -> Plain:
    """Candidates ranked among each other, and what is drawn of them."""
    entries = [[r.entry for r in c] for c in candidates]
    stand = statistics.standings(entries)
    order = sorted(range(len(candidates)), key=lambda k: (stand[k].rank.value, k))
    candidates = [candidates[k] for k in order]
    entries = [entries[k] for k in order]
    stand = [stand[k] for k in order]
    first = entries[0][0]
    law = _law(first, candidates)
    return {
        "problem": problem,
        "seeds": seeds,
        "protocol": first["protocol"],
        "score": dict(first["score"]),
        "entries": [
            {
                "rank": _plain(place.rank),
                "score": _plain(place.score),
                **_solving(c[0].entry, place.level, law),
                **summary(group_entries),
                **_identity(c),
                "same": _same(k, entries),
            }
            for k, (c, group_entries, place) in enumerate(
                zip(candidates, entries, stand, strict=True)
            )
        ],
        "reference": 1.0 if first["track"] in RATIOS else None,
        "statistic": statistics.STATISTIC[first["track"]],
        "profiles": _profiles(entries)
        if statistics.STATISTIC[first["track"]] == "iqm"
        else None,
        "improvement": [
            [_plain(statistics.improvement(a, b), 4) for b in entries[i + 1 : _COMPARED]]
            for i, a in enumerate(entries[:_COMPARED])
        ],
        "anytime": _anytime(entries),
    }


def _law(first: Mapping[str, Any], candidates: Sequence[Candidate]) -> Mapping[str, Any] | None:
    """Return the entry of the controller that a task is measured by, if it is there."""
    if first["track"] not in statistics.BY_SUCCESS:
        return None
    name = REFERENCES.get(
        task_name(first["problem"].removesuffix(QUICK)).removesuffix("Emulated")
    )
    laws = [
        c[0]
        for c in candidates
        if (c[0].entry["kind"], c[0].entry["name"]) == ("controller", name)
    ]
    return min(laws, key=lambda record: record.order).entry if laws else None


def _solving(entry: Mapping[str, Any], level: int, law: Mapping[str, Any] | None) -> Plain:
    """Return the class of success, and the energy beside that of the task's reference law."""
    if entry["track"] not in statistics.BY_SUCCESS:
        return {}
    out: Plain = {"class": level}
    over = None if law is None else statistics.energy_over(entry, law)
    if law is not None and over is not None:
        out["over"] = {"law": law["name"], "ratio": _plain(over[0]), "episodes": over[1]}
    return out


def _same(k: int, entries: Sequence[Sequence[Mapping[str, Any]]]) -> list[str]:
    """Names of the entries that do what entry k does in most episodes."""
    if len(entries[k]) > 1:
        return []
    (mine,) = entries[k]
    out = []
    for j, (other, *more) in enumerate(entries):
        if j == k or more or len(other["rows"]) != len(mine["rows"]):
            continue
        apart = difference(mine["rows"], other["rows"])
        if apart is not None and apart <= NEAR:
            out.append(str(other["name"]))
    return out


def summary(entries: Sequence[Mapping[str, Any]]) -> Plain:
    """Numbers of one candidate that need no others; without those that no row has."""
    rows = [row for e in entries for row in e["rows"]]
    spread = [statistics.by_training_seed(e) for e in entries]
    middles = {
        key: statistics.middle(entries, key) for key in (*ENERGIES, "seconds", "evaluations")
    }
    return {
        "success": _plain(statistics.success(entries)),
        "failed": sum(bool(row["failed"]) for row in rows),
        "episodes": sum(len(statistics.episodes(e)) for e in entries),
        "training_seeds": min(map(len, spread)),
        "by_training_seed": _plain(spread[0])
        if len(spread) == 1 and len(spread[0]) > 1
        else [],
        **{key: _plain(value) for key, value in middles.items() if value is not None},
    }


def _identity(candidate: Candidate) -> Plain:
    """Whose entry it is, and by what it can be checked."""
    e = candidate[0].entry
    alone = len(candidate) == 1
    return {
        **{key: e[key] for key in ("name", "author", "kind")},
        "ids": [r.id for r in candidate],
        "bundle": e["bundle"] if alone else "",
        "about": dict(e["about"]) if alone else {"versions": e["about"]["versions"]},
    }


def _profiles(entries: Sequence[Sequence[Mapping[str, Any]]]) -> Plain:
    at = statistics.thresholds([e for group_entries in entries for e in group_entries])
    curves = [
        [_plain(k, 4) for k in statistics.profile(group_entries, at)[1:]]
        for group_entries in entries
    ]
    return {"at": _plain(at), "curves": curves}


def _anytime(entries: Sequence[Sequence[Mapping[str, Any]]]) -> Plain | None:
    """Curves of those that tell how they came to their score; None where nobody does."""
    anytime_entries = [
        group_entries[0]
        if len(group_entries) == 1 and any(r.get("anytime") for r in group_entries[0]["rows"])
        else None
        for group_entries in entries
    ]
    steps = [
        [s for s, _ in row["anytime"]]
        for e in anytime_entries
        if e
        for row in e["rows"]
        if row.get("anytime")
    ]
    if not steps:
        return None
    low = max(min(min(s) for s in steps), 1e-3)
    at = np.geomspace(low, max(max(s[-1] for s in steps), 2 * low), _POINTS)
    return {
        "at": _plain(at),
        "curves": [
            None if e is None else _plain(statistics.anytime(e, at)) for e in anytime_entries
        ],
    }


def _plain(value: float | Iterable[float] | Array | None, digits: int = _DIGITS) -> Any:
    """Numbers for JSON: rounded; what is infinite becomes null."""
    if value is None:
        return None
    if isinstance(value, float):
        return float(f"{value:.{digits}g}") if math.isfinite(value) else None
    return [_plain(float(k), digits) for k in value]
