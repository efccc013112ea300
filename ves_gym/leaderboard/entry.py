"""An entry: what one planner, policy or controller achieved on one problem, as plain data."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from ves_gym.core.params import ParameterError

SCHEMA = "ves-entry/1"
TRACKS = ("paths", "policies", "damping", "discrepancy")
KINDS = ("planner", "policy", "controller", "gains", "selector")
LEVELS = ("replayed", "reproduced")
SEEDS = ("public", "official")


@dataclass(frozen=True, kw_only=True)
class Entry:
    """What stands in one line of the journal; lower is better in every score.

    `rows`: one per episode, query or case, with id, seed, group (which of several training
    seeds), score (None: failed, which counts as worst), success and failed.
    """

    schema: str
    track: str
    protocol: int
    problem: str
    name: str
    author: str
    kind: str
    level: str
    seeds: str
    bundle: str
    score: Mapping[str, str]
    rows: tuple[Mapping[str, Any], ...]
    about: Mapping[str, Any]


def check_entry(data: Mapping[str, Any]) -> Entry:
    """Read an entry from plain data.

    Raises:
        ParameterError: a key is missing, unknown or holds what it cannot.
    """
    known = {f.name for f in fields(Entry)}
    if not isinstance(data, Mapping) or data.keys() != known:
        given = sorted(data) if isinstance(data, Mapping) else data
        raise ParameterError(f"an entry has {', '.join(sorted(known))}, got {given!r}")
    for key, choices in (
        ("schema", (SCHEMA,)),
        ("track", TRACKS),
        ("kind", KINDS),
        ("level", LEVELS),
        ("seeds", SEEDS),
    ):
        if data[key] not in choices:
            raise ParameterError(
                f"entry.{key} must be one of {', '.join(choices)}, got {data[key]!r}"
            )
    if not isinstance(data["rows"], (list, tuple)) or not data["rows"]:
        raise ParameterError(f"entry.rows must be a list of rows, got {data['rows']!r}")
    for k, row in enumerate(data["rows"]):
        _check_row(row, f"entry.rows[{k}]")
    return Entry(**{**data, "rows": tuple(data["rows"])})


def _check_row(row: Any, where: str) -> None:
    needed = {"id", "seed", "group", "score", "success", "failed"}
    if not isinstance(row, Mapping) or not needed <= row.keys():
        raise ParameterError(f"{where} must have {', '.join(sorted(needed))}, got {row!r}")
    for key, value in row.items():
        if isinstance(value, float) and not math.isfinite(value):
            raise ParameterError(f"{where}.{key} must be finite or null, got {value!r}")
