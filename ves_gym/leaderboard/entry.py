"""`Entry`: a row of the leaderboard with everything it rests on, plain data (ves-entry/1).

Lower is better in every score. A score of None is a failure: it counts as worst and is never
dropped. Every number is finite or None.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from ves_gym._util.params import ParameterError, canonical_json, content_hash, to_plain
from ves_gym.leaderboard.names import require_name

SCHEMA = "ves-entry/1"
TRACKS = ("paths", "policies", "tasks", "damping", "discrepancy")
KINDS = ("planner", "policy", "controller", "gains", "selector")
LEVELS = ("replayed", "reproduced")
SEEDS = ("public", "official")
MEASURES = ("E_mean", "E_peak", "E_res", "E_int", "E_decay")  # J; E_int J s
DIGEST = re.compile(r"[0-9a-f]{64}")
FINGERPRINT = re.compile(r"SHA256:[A-Za-z0-9+/]{43}")  # of a key, as ssh-keygen writes it
_MOST = 200_000  # rows
_DIGITS = 6  # of a number on the board
_DEPTH = 8  # of nested plain data

Plain = Mapping[str, Any]

ROW = ("id", "seed", "group", "score", "success", "failed", "E_mean", "E_peak", "E_res",
       "seconds", "evaluations")  # fmt: skip
OPTIONAL = ("anytime", "E_int", "E_decay")
DECAYS = ("damping",)  # tracks whose episodes begin with a base that vibrates
ABOUT = ("versions", "cpu", "simd", "model", "evaluator", "settings", "training", "begun",
         "ended")  # fmt: skip
REPRODUCTION = ("rows", "equal", "largest")  # of the method's run here beside that submitted


@dataclass(frozen=True, kw_only=True)
class Entry:
    """Result as `verify` hands it to the journal. `rows` and `about` are plain data."""

    schema: str = SCHEMA
    track: str
    protocol: int  # version of the track's rules
    problem: str
    name: str
    author: str
    kind: str
    level: str  # how it was verified
    seeds: str
    bundle: str  # SHA-256 of the bundle's manifest
    score: Plain  # name, unit, better
    rows: tuple[Plain, ...]
    about: Plain

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        plain: dict[str, Any] = to_plain(self)
        return plain

    def shortened(self) -> dict[str, Any]:
        """Plain data for the board, numbers of rows to six digits; a bundle holds them all."""
        return {**self.to_dict(), "rows": [_shortened(dict(row)) for row in self.rows]}

    @property
    def hash(self) -> str:
        """SHA-256 of the canonical JSON."""
        return content_hash(self.to_dict())


def _shortened(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _shortened(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_shortened(v) for v in value]
    return float(f"{value:.{_DIGITS}g}") if isinstance(value, float) else value


def check_entry(data: Any) -> Entry:
    """An entry from plain data.

    Raises:
        ParameterError: what is missing, unknown, of the wrong kind or out of range.
    """
    names = tuple(Entry.__dataclass_fields__)
    plain_entry = table_of(data, names, "entry")
    if plain_entry["schema"] != SCHEMA:
        raise ParameterError(
            f"entry.schema must be {SCHEMA!r}, got {shown(plain_entry['schema'])}"
        )
    for name, choices in (
        ("track", TRACKS),
        ("kind", KINDS),
        ("level", LEVELS),
        ("seeds", SEEDS),
    ):
        if plain_entry[name] not in choices:
            got = shown(plain_entry[name])
            raise ParameterError(f"entry.{name} must be one of {', '.join(choices)}, got {got}")
    integer(plain_entry["protocol"], "entry.protocol", least=1)
    for name in ("problem", "name", "author"):
        require_name(
            text(plain_entry[name], f"entry.{name}", empty=name == "author"), f"entry.{name}"
        )
    if not (isinstance(plain_entry["bundle"], str) and DIGEST.fullmatch(plain_entry["bundle"])):
        raise ParameterError(
            f"entry.bundle must be a SHA-256, got {shown(plain_entry['bundle'])}"
        )
    score = table_of(plain_entry["score"], ("name", "unit", "better"), "entry.score")
    text(score["name"], "entry.score.name")
    text(score["unit"], "entry.score.unit")
    if score["better"] != "lower":
        raise ParameterError(
            f"entry.score.better must be 'lower', got {shown(score['better'])}"
        )
    rows = plain_entry["rows"]
    if not isinstance(rows, (list, tuple)) or not 0 < len(rows) <= _MOST:
        raise ParameterError(f"entry.rows must be a list of 1 to {_MOST} rows")
    keys = set()
    for k, row in enumerate(rows):
        checked_row(row, f"entry.rows[{k}]")
        key = (row["group"], row["id"])
        if key in keys:
            raise ParameterError(
                f"entry.rows[{k}]: {row['id']} of group {key[0]} is there twice"
            )
        keys.add(key)
    about = check_about(
        plain_entry["about"], ABOUT, "entry.about", ("reproduction", "key", "salt")
    )
    if "salt" in about and not (
        isinstance(about["salt"], str) and DIGEST.fullmatch(about["salt"])
    ):
        raise ParameterError("entry.about.salt must be the mark of a salt, 64 digits")
    if "reproduction" in about:
        measured = table_of(about["reproduction"], REPRODUCTION, "entry.about.reproduction")
        for name, value in measured.items():
            number(value, f"entry.about.reproduction.{name}")
    if "key" in about:
        key = about["key"]
        if not (isinstance(key, str) and FINGERPRINT.fullmatch(key)):
            raise ParameterError(f"entry.about.key must be SHA256:..., got {key!r:.80}")
    canonical_json(plain_entry)  # whatever else is in it
    return Entry(**{**plain_entry, "score": score, "rows": tuple(rows), "about": about})


def with_named_measures(entry: Plain) -> dict[str, Any]:
    """Return an entry whose mean energy has the name of what it is.

    Elsewhere `E_mean` is what motions bring into the base. On track damping the base has its
    energy at the start, and the mean while it decays is `E_decay`. Bundles, and entries of
    before, call both E_mean.

    Args:
        entry: plain data of an `Entry`.
    """
    if entry["track"] not in DECAYS:
        return dict(entry)
    rows = [
        row if row.get("E_mean") is None else {**row, "E_mean": None, "E_decay": row["E_mean"]}
        for row in entry["rows"]
    ]
    return {**entry, "rows": type(entry["rows"])(rows)}


def checked_row(row: Any, where: str, extra: tuple[str, ...] = ()) -> dict[str, Any]:
    """A row of an entry or, with `extra` keys, of a manifest."""
    plain = table_of(row, (*ROW, *extra), where, OPTIONAL)
    text(plain["id"], f"{where}.id")
    for name in ("seed", "group"):
        integer(plain[name], f"{where}.{name}")
    for name in ("success", "failed"):
        if not isinstance(plain[name], bool):
            raise ParameterError(
                f"{where}.{name} must be a truth value, got {shown(plain[name])}"
            )
    for name in ("score", *MEASURES, "seconds", "evaluations"):
        value = plain.get(name)
        if value is not None:
            number(value, f"{where}.{name}")
    for name in ("seconds", "evaluations"):
        if plain[name] is not None and plain[name] < 0:
            raise ParameterError(f"{where}.{name} must be >= 0, got {shown(plain[name])}")
    curve = plain.get("anytime")
    if curve is not None:
        _check_curve(curve, f"{where}.anytime")
    return plain


def _check_curve(curve: Any, where: str) -> None:
    expected = f"{where} must be [[seconds, cost], ...], times rising and costs falling"
    if not isinstance(curve, (list, tuple)) or len(curve) > 10_000:
        raise ParameterError(expected)
    before = (0.0, math.inf)
    for point in curve:
        if not isinstance(point, (list, tuple)) or len(point) != 2:
            raise ParameterError(expected)
        point_now = number(point[0], where), number(point[1], where)
        if point_now[0] < before[0] or point_now[1] > before[1] or point_now[1] < 0:
            raise ParameterError(expected)
        before = point_now


def check_about(
    about: Any, names: tuple[str, ...], where: str, optional: tuple[str, ...] = ()
) -> dict[str, Any]:
    """Check the account of how a result came about.

    Args:
        about: plain data.
        names: keys that must be there.
        where: path of the entry, for the message.
        optional: keys that may be there.
    """
    plain = table_of(about, names, where, optional)
    versions = plain["versions"]
    if not isinstance(versions, Mapping):
        raise ParameterError(f"{where}.versions must be a table, got {shown(versions)}")
    for key, value in versions.items():
        text(key, f"{where}.versions")
        text(value, f"{where}.versions.{key}")
    for name in ("cpu", "simd"):
        text(plain[name], f"{where}.{name}", empty=True, most=4000)
    for name in ("model", "evaluator"):
        if name in names and not (
            isinstance(plain[name], str) and DIGEST.fullmatch(plain[name])
        ):
            raise ParameterError(f"{where}.{name} must be a SHA-256, got {shown(plain[name])}")
    for name in ("settings", "training"):
        if not isinstance(plain[name], Mapping):
            raise ParameterError(f"{where}.{name} must be a table, got {shown(plain[name])}")
        plain_data(plain[name], f"{where}.{name}")
    begun, ended = (instant(plain[name], f"{where}.{name}") for name in ("begun", "ended"))
    if ended < begun:
        raise ParameterError(f"{where}.ended must not be before begun, got {plain['ended']}")
    return plain


# ------------------------------------------------------------------------------ values


def shown(value: Any) -> str:
    """Return what was received as a message holds it: 80 characters at most."""
    return f"{value!r:.80}" if isinstance(value, (str, int, float)) else type(value).__name__


def table_of(
    value: Any, names: tuple[str, ...], where: str, optional: tuple[str, ...] = ()
) -> dict[str, Any]:
    if not isinstance(value, Mapping):
        raise ParameterError(f"{where} must be a table, got {type(value).__name__}")
    missing = [k for k in names if k not in value]
    unknown = [k for k in value if k not in names and k not in optional]
    if missing or unknown:
        what = f"missing {missing[0]!r}" if missing else f"unknown {str(unknown[0])[:80]!r}"
        raise ParameterError(f"{where}: {what}; keys are {', '.join(names)}")
    return dict(value)


def text(value: Any, where: str, *, empty: bool = False, most: int = 200) -> str:
    """A line of characters that can be seen: no control, no change of direction."""
    good = isinstance(value, str) and len(value) <= most and (value or empty)
    if not good or not value.isprintable():
        raise ParameterError(f"{where} must be a line of at most {most} printable characters")
    return str(value)


def number(value: Any, where: str) -> float:
    """A finite number."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or abs(value) > 1e300:
        raise ParameterError(f"{where} must be a finite number or null, got {value!r:.80}")
    if not math.isfinite(value):
        raise ParameterError(f"{where} must be a finite number or null, got {value}")
    return float(value)


def integer(value: Any, where: str, least: int = 0) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value < 2**63:
        raise ParameterError(f"{where} must be a whole number >= {least}, got {value!r:.80}")
    return value


def instant(value: Any, where: str) -> datetime:
    """A time with its zone, ISO 8601."""
    try:
        moment = datetime.fromisoformat(value)
    except (TypeError, ValueError):
        moment = None
    if moment is None or moment.tzinfo is None:
        raise ParameterError(f"{where} must be a time such as 2026-01-31T12:00:00+00:00")
    return moment


def plain_data(value: Any, where: str, depth: int = _DEPTH) -> None:
    """Nested tables and lists of texts, finite numbers, truth values and null."""
    if depth == 0:
        raise ParameterError(f"{where} is nested too deeply")
    if isinstance(value, Mapping):
        for key, item in value.items():
            text(key, where)
            plain_data(item, f"{where}.{key}", depth - 1)
    elif isinstance(value, (list, tuple)):
        for item in value:
            plain_data(item, where, depth - 1)
    elif isinstance(value, str):
        text(value, where, empty=True, most=2000)
    elif isinstance(value, (int, float)) and not isinstance(value, bool):
        number(value, where)
    elif not (value is None or isinstance(value, bool)):
        raise ParameterError(f"{where} must be plain data, got {type(value).__name__}")
