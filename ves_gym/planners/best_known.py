"""The least energy anybody found for a benchmark's question, and scores relative to it.

`best_known.json` is written from benchmark results (`ves-gym benchmark --keep-best FILE`):
whatever planner simulates to less takes the place of what stood there.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from ves_gym._util.params import ParameterError, read_table, write_text
from ves_gym._util.version import __version__

FORMAT = "ves-best/1"
PACKAGED = "best_known.json"
_TOLERANCE = 1e-6  # relative: what is no more than this below is the same


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
        if previous is None or row["E_mean"] < (1 - _TOLERANCE) * previous["E_mean"]:
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
