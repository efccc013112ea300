"""The journal as tables: SQLite and Parquet, derived and written anew each time.

`entries`: one row each, with the statistics of the board; `episodes`: every row of every
entry; `anytime`: the curves of searches. `entry` is the id in the name of the entry's file.
"""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from ves_gym._util.params import ParameterError, canonical_json, write_bytes
from ves_gym.leaderboard import statistics
from ves_gym.leaderboard.board import ENERGIES, History, divided, summary
from ves_gym.leaderboard.evaluators import history_reason
from ves_gym.leaderboard.journal import Journal
from ves_gym.leaderboard.record import Record
from ves_gym.system.runlog_files import load_pyarrow

Row = dict[str, Any]
Columns = Mapping[str, type]

_OF_ENTRY: Columns = {
    "entry": str,
    "entered": str,
    "hash": str,
    "current": bool,
    "track": str,
    "protocol": int,
    "problem": str,
    "seeds": str,
    "name": str,
    "author": str,
    "kind": str,
    "level": str,
    "bundle": str,
    "score_name": str,
    "score_unit": str,
    **dict.fromkeys(("score", "score_low", "score_high"), float),
    **dict.fromkeys(("success", "success_low", "success_high"), float),
    "episodes": int,
    "training_seeds": int,
    "failed": int,
    **dict.fromkeys((*ENERGIES, "seconds", "evaluations"), float),
    "about": str,
}
_EPISODE: Columns = {"entry": str, "id": str, "seed": int, "training_seed": int}
_OF_EPISODE: Columns = {
    **_EPISODE,
    "score": float,
    "success": bool,
    "failed": bool,
    **dict.fromkeys((*ENERGIES, "seconds", "evaluations"), float),
}
_OF_ANYTIME: Columns = {**_EPISODE, "seconds": float, "cost": float}
TABLES: Mapping[str, Columns] = {
    "entries": _OF_ENTRY,
    "episodes": _OF_EPISODE,
    "anytime": _OF_ANYTIME,
}


def make_tables(journal: Journal, history: History = history_reason) -> dict[str, list[Row]]:
    """Return rows of every table; null where there is no number, also for what is infinite.

    Args:
        journal: what is on the board.
        history: why an entry is not of today's version, None where it is.
    """
    counts = {r.hash for r in divided(journal.records, history)[0]}
    return {
        "entries": [_entry(r, r.hash in counts) for r in journal.records],
        "episodes": [row for r in journal.records for row in _episodes(r)],
        "anytime": [row for r in journal.records for row in _anytime(r)],
    }


def _entry(record: Record, counts: bool) -> Row:
    e = record.entry
    out: Row = dict.fromkeys(_OF_ENTRY)
    out |= {"entry": record.id, "entered": record.entered}
    out |= {"hash": record.hash, "current": counts}
    out |= {key: e[key] for key in _OF_ENTRY if key in e and key != "score"}
    out |= {"score_name": e["score"]["name"], "score_unit": e["score"]["unit"]}
    out["about"] = canonical_json(e["about"])
    try:
        summarised = summary([e])
        score = statistics.score([e])
    except ParameterError:  # rows that make no whole: no statistics
        return out
    for key in ("score", "success"):
        three = [k if abs(k) < float("inf") else None for k in score]
        three = three if key == "score" else summarised[key]
        out |= dict(zip((key, f"{key}_low", f"{key}_high"), three, strict=True))
    return out | {
        key: summarised[key] for key in summarised if key in _OF_ENTRY and key != "success"
    }


def _episodes(record: Record) -> Iterator[Row]:
    for row in record.entry["rows"]:
        values = {key: row.get(key) for key in _OF_EPISODE}
        yield values | {"entry": record.id, "training_seed": row["group"]}


def _anytime(record: Record) -> Iterator[Row]:
    for row in record.entry["rows"]:
        of = {"id": row["id"], "seed": row["seed"], "training_seed": row["group"]}
        for seconds, cost in row.get("anytime") or ():
            yield {"entry": record.id, **of, "seconds": seconds, "cost": cost}


# ---------------------------------------------------------------------------- files


def write_sqlite(journal: Journal, path: str | os.PathLike[str]) -> None:
    """Write the tables as an SQLite database, completely or not at all.

    The table `journal` holds the hash and the number of the entries it was made from.
    """
    kinds = {int: "INTEGER", bool: "INTEGER", float: "REAL", str: "TEXT"}
    base = sqlite3.connect(":memory:")
    try:
        base.execute("CREATE TABLE journal (head TEXT, entries INTEGER)")
        base.execute("INSERT INTO journal VALUES (?, ?)", (journal.head, len(journal.records)))
        for name, rows in make_tables(journal).items():
            columns = TABLES[name]
            described = ", ".join(f"{c} {kinds[kind]}" for c, kind in columns.items())
            base.execute(f"CREATE TABLE {name} ({described})")
            marks = ", ".join("?" * len(columns))
            base.executemany(
                f"INSERT INTO {name} VALUES ({marks})", ([r[c] for c in columns] for r in rows)
            )
        base.commit()
        write_bytes(path, base.serialize())
    finally:
        base.close()


def write_parquet(journal: Journal, folder: str | os.PathLike[str]) -> list[Path]:
    """Write `entries.parquet`, `episodes.parquet` and `anytime.parquet`.

    The schema's metadata holds the hash of all entries.

    Raises:
        ValueError: pyarrow is not installed.
    """
    pa, pq = load_pyarrow(Path(folder))
    kinds = {int: pa.int64(), bool: pa.bool_(), float: pa.float64(), str: pa.string()}
    out = []
    for name, rows in make_tables(journal).items():
        fields = [pa.field(c, kinds[kind]) for c, kind in TABLES[name].items()]
        schema = pa.schema(fields, metadata={"journal": journal.head})
        table = pa.Table.from_pylist(_as_float(rows, TABLES[name]), schema=schema)
        sink = pa.BufferOutputStream()
        pq.write_table(table, sink)
        out.append(Path(folder) / f"{name}.parquet")
        write_bytes(out[-1], sink.getvalue().to_pybytes())
    return out


def _as_float(rows: Sequence[Row], columns: Columns) -> list[Row]:
    """Whole numbers where the column is one of floats, as JSON has them, become floats."""
    real = [c for c, kind in columns.items() if kind is float]
    return [row | {c: None if row[c] is None else float(row[c]) for c in real} for row in rows]
