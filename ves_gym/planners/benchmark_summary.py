"""What a benchmark's rows come to: medians, ratios to the straight line, ranks, scores.

`best_known.json` holds the least energy anybody found for a question, written from results
(`ves-gym benchmark --keep-best FILE`): whatever planner simulates to less takes its place.
"""

from __future__ import annotations

import json
import os
from collections import defaultdict
from collections.abc import Iterable, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import scipy.stats

from ves_gym._util.params import Array, ParameterError, read_table, write_text
from ves_gym._util.statistics import STATISTICS, bootstrap
from ves_gym._util.version import __version__
from ves_gym.system.disturbance import MEASURES

FORMAT = "ves-best/1"
PACKAGED = "best_known.json"
_NO_LESS = 1e-6  # relative: what is no more than this below is the same

BASELINE = "straight"
_NO_RATIO = 1e-4  # of the run's own peak energy: below it there is no ratio to speak of


def summarise(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Medians per vehicle, duration and planner; ratios are to the straight line's.

    A ratio is taken query by query; `ratio_low` and `ratio_high` are the 95 % bootstrap
    interval of its median. A failed plan stays in the medians: the straight line's own
    energy and its own are both simulated facts; `success_rate` says how many failed.
    Errors of the prediction are those of motions that keep their limits. A stopped run and
    a query without an answer have no energy and are in none. A query is solvable if any
    planner of the run solved it.
    """
    baseline = {(r["vehicle"], r["query"]): r for r in rows if r["planner"] == BASELINE}
    solvable = {(r["vehicle"], r["query"]) for r in rows if r["success"]}
    groups: dict[tuple[str, float, str], list[dict[str, Any]]] = defaultdict(list)
    for row in rows:
        groups[row["vehicle"], row["duration"], row["planner"]].append(row)
    out = []
    for (vehicle, duration, planner), members in groups.items():
        ratios = {key: _ratios(members, baseline, key) for key in ("E_mean", "E_res", "E_peak")}
        low, high = _interval(ratios["E_mean"])
        emulated = {}
        if "stopped" in members[0]:
            emulated = {
                "stopped": sum(r["stopped"] is not None for r in members),
                "emulation_error_median": _median(_numbers(members, "emulation_error")),
                "base_error_median": _median(_numbers(members, "base_error")),
            }
        feasible = [r for r in members if r["failure"] is None]
        errors = [abs(e) for e in _numbers(feasible, "prediction_error")]
        possible = [r["success"] for r in members if (vehicle, r["query"]) in solvable]
        seconds = [r["plan_seconds"] for r in members]
        out.append(
            {
                "vehicle": vehicle,
                "duration": duration,
                "planner": planner,
                "n": len(members),
                "success_rate": float(np.mean([r["success"] for r in members])),
                "reference_breaks": sum(_outside(r, "reference_breaks") for r in members),
                "arm_breaks": sum(_outside(r, "arm_breaks") for r in members),
                "E_mean_median": _median(_numbers(members, "E_mean")),
                "ratio_median": _median(ratios["E_mean"]),
                "ratio_low": low,
                "ratio_high": high,
                "E_res_ratio_median": _median(ratios["E_res"]),
                "E_peak_ratio_median": _median(ratios["E_peak"]),
                **{f"{k}_median": _median(_numbers(members, k)) for k in MEASURES},
                **{
                    f"{k}_ratio_median": _median(_shares(members, baseline, k))
                    for k in MEASURES
                },
                "solvable": len(possible),
                "solvable_rate": float(np.mean(possible)) if possible else None,
                "prediction_error_median": _median(errors),
                "prediction_error_max": max(errors, default=None),
                "plan_seconds_median": _median(seconds),
                "plan_seconds_p95": float(np.percentile(seconds, 95)),
                "plan_seconds_max": max(seconds),
                "score_median": _median(_numbers(members, "score")),
                "near_best": near_best(members),
                **emulated,
            }
        )
    return out


def anytime(rows: Sequence[dict[str, Any]], points: int = 41) -> list[dict[str, Any]]:
    """Return how the best cost of each search came down, medians over a duration's queries.

    For planners that list a `curve` of (seconds, evaluations, cost) in their `info`: cost over
    the final cost at times spaced geometrically, from when half the queries have a solution,
    and the time to come within 5 % of it.

    Args:
        rows: of `run_benchmark`.
        points: times per curve.

    Returns:
        A table per vehicle, duration and planner: `seconds` [s], `ratio` [1], both (points,)
        at most, and the times to 5 % [s].
    """
    groups: dict[tuple[str, float, str], list[Array]] = defaultdict(list)
    for row in rows:
        if row["info"].get("curve"):
            curve = np.array(row["info"]["curve"], float)
            groups[row["vehicle"], row["duration"], row["planner"]].append(curve)
    out = []
    for (vehicle, duration, planner), curves in groups.items():
        last = max(c[-1, 0] for c in curves)
        first = float(np.median([c[0, 0] for c in curves]))
        at = np.geomspace(min(first, last), last, points)
        ratios = np.full((len(curves), points), np.inf)
        for i, c in enumerate(curves):
            k = np.searchsorted(c[:, 0], at, side="right") - 1
            ratios[i, k >= 0] = c[k[k >= 0], 2] / max(c[-1, 2], 1e-300)
        median = np.median(ratios, axis=0)
        there = np.isfinite(median)
        within = [float(c[np.argmax(c[:, 2] <= 1.05 * c[-1, 2]), 0]) for c in curves]
        out.append(
            {
                "vehicle": vehicle,
                "duration": duration,
                "planner": planner,
                "n": len(curves),
                "seconds": [float(f"{k:.4g}") for k in at[there]],
                "ratio": [float(f"{k:.5g}") for k in median[there]],
                "to_5_percent_median": _median(within),
                "to_5_percent_max": max(within),
            }
        )
    return out


def rank_correlation(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Spearman's rho of the planners' order in the laboratory and in space, by query.

    Per vehicle and duration the median of rho over queries with three planners or more that
    have an energy in both.
    """
    queries: dict[tuple[str, float, str], list[tuple[float, float]]] = defaultdict(list)
    for row in rows:
        if row["E_mean"] is not None:
            pair = (row["E_mean"], row["E_mean_ideal"])
            queries[row["vehicle"], row["duration"], row["query"]].append(pair)
    groups: dict[tuple[str, float], list[float]] = defaultdict(list)
    for (vehicle, duration, _), pairs in queries.items():
        emulated, ideal = np.array(pairs).T
        if len(pairs) >= 3 and np.ptp(emulated) > 0 and np.ptp(ideal) > 0:
            rho_query = scipy.stats.spearmanr(emulated, ideal).statistic
            groups[vehicle, duration].append(float(rho_query))
    return [
        {"vehicle": v, "duration": d, "n": len(rho), "rho_median": _median(rho)}
        for (v, d), rho in groups.items()
    ]


def _ratios(
    rows: Sequence[dict[str, Any]], baseline: dict[tuple[str, str], dict[str, Any]], key: str
) -> list[float]:
    """Energy over the straight line's, where that is not nothing.

    A free base is at rest after any motion: its E_res has no ratio.
    """
    out = []
    for row in rows:
        reference = baseline[row["vehicle"], row["query"]]
        if None in (row[key], reference[key]):
            continue
        if reference[key] > _NO_RATIO * reference["E_peak"]:
            out.append(row[key] / reference[key])
    return out


def _shares(
    rows: Sequence[dict[str, Any]], baseline: dict[tuple[str, str], dict[str, Any]], key: str
) -> list[float]:
    """Disturbance measures over the straight line's."""
    pairs = [(row.get(key), baseline[row["vehicle"], row["query"]].get(key)) for row in rows]
    return [value / whole for value, whole in pairs if value is not None and whole]


def _outside(row: dict[str, Any], key: str) -> bool:
    """True for a success that breaks a limit: within the tolerance, or one not asked for."""
    return bool(row["success"] and row.get(key))


def _numbers(rows: Iterable[dict[str, Any]], key: str) -> list[float]:
    return [row[key] for row in rows if row.get(key) is not None]


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if len(values) else None


def _interval(values: Sequence[float]) -> tuple[float | None, float | None]:
    """95 % percentile bootstrap interval of the median."""
    if not values:
        return None, None
    interval = bootstrap([np.array(values)], STATISTICS["median"])
    return interval.low, interval.high


# ----------------------------------------------------------------------- best known energies


@cache
def packaged() -> dict[str, dict[str, Any]]:
    """Entries of the file that comes with the package, by `key`."""
    text = files("ves_gym.planners").joinpath(PACKAGED).read_text(encoding="utf-8")
    return _entries(json.loads(text), PACKAGED)


def read_best(path: str | os.PathLike[str]) -> dict[str, dict[str, Any]]:
    """Entries of a file, none if there is no such file."""
    if not Path(path).exists():
        return {}
    return _entries(read_table(path), str(path))


def _entries(table: dict[str, Any], where: str) -> dict[str, dict[str, Any]]:
    if table.get("format") != FORMAT:
        raise ParameterError(f"{where}: format must be {FORMAT!r}, got {table.get('format')!r}")
    entries: dict[str, dict[str, Any]] = table.get("entries", {})
    for name, entry in entries.items():
        if not (isinstance(entry, dict) and isinstance(entry.get("E_mean"), float | int)):
            raise ParameterError(f"{where}: {name!r} must hold a number E_mean, got {entry!r}")
    return entries


def key(system_hash: str, query: str) -> str:
    """Name of a question: another system is another question.

    Args:
        system_hash: `System.hash` of the ideal system, hexadecimal.
        query: the query's name.

    Returns:
        The first twelve digits of the hash and the name.
    """
    return f"{system_hash[:12]} {query}"


def merge_best(path: str | os.PathLike[str], result: dict[str, Any]) -> int:
    """Merge a benchmark result into a file of best known energies.

    Only motions in space that keep every limit count.

    Args:
        path: of the JSON file; made if it does not exist.
        result: of `run_benchmark`, mode ideal; energies in J.

    Returns:
        How many entries are new or lower.

    Raises:
        ParameterError: a result of mode emulated, or a file of another format.
    """
    if result["mode"] != "ideal":
        raise ParameterError(f"best known energies are of mode ideal, got {result['mode']}")
    before = read_best(path)
    entries = dict(before)
    for row in result["rows"]:
        if not row["success"] or not row["E_mean"]:
            continue
        name = key(result["systems"][row["vehicle"]]["hash"], row["query"])
        previous = entries.get(name)
        if previous is None or row["E_mean"] < (1 - _NO_LESS) * previous["E_mean"]:
            entries[name] = {
                "E_mean": float(f"{row['E_mean']:.9g}"),
                "planner": row["planner"],
                "seed": result["seed"],
                "version": __version__,
            }
    head = f'{{"format": "{FORMAT}", "unit": "J", "entries": {{\n'
    lines = [f"{json.dumps(name)}: {json.dumps(entries[name])}" for name in sorted(entries)]
    write_text(path, head + ",\n".join(lines) + "\n}}\n")
    return sum(before.get(name) != entry for name, entry in entries.items())


def add_scores(rows: Iterable[dict[str, Any]], hashes: dict[str, str], baseline: str) -> None:
    """Add `best_known` [J] and `score` [1] to rows, None where nothing is known.

    The score is 0 for the energy of the straight line and 1 for the best known one; only
    motions that keep every limit have one.

    Args:
        rows: of `run_benchmark`; changed in place.
        hashes: `System.hash` of each vehicle's ideal system.
        baseline: name of the planner whose energy scores 0.

    Raises:
        KeyError: a row of a vehicle without a hash.
    """
    every = list(rows)
    baselines = {
        (r["vehicle"], r["query"]): r["E_mean"] for r in every if r["planner"] == baseline
    }
    for row in every:
        entry = packaged().get(key(hashes[row["vehicle"]], row["query"]))
        best = row["best_known"] = None if entry is None else entry["E_mean"]
        straight_energy, energy = baselines.get((row["vehicle"], row["query"])), row["E_mean"]
        row["score"] = None
        if (
            row["success"]
            and best is not None
            and straight_energy is not None
            and straight_energy > best
        ):
            row["score"] = (straight_energy - energy) / (straight_energy - best)


def near_best(rows: Sequence[dict[str, Any]], share: float = 1.05) -> float | None:
    """Share of the rows with a best known energy that succeed within `share` times it.

    Args:
        rows: of `run_benchmark`, scored.
        share: of the best known energy, >= 1.

    Returns:
        The fraction, or None where no row has a best known energy.
    """
    rated = [r for r in rows if r["best_known"] is not None]
    if not rated:
        return None
    good = [r["success"] and r["E_mean"] <= share * r["best_known"] for r in rated]
    return sum(good) / len(good)
