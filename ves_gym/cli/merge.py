"""`ves-gym merge`: one table of the results of one sweep or of several machines' folders."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from ves_gym._util.optional import require
from ves_gym.cli.flags import Answer, Flag
from ves_gym.experiments.sweep import merge, write_rows

SCHEMA = "ves-merge/1"
FLAGS = (
    Flag("FOLDER", help="that `ves-gym sweep` made", many=True),
    Flag("--parquet", help="write rows.parquet instead of rows.jsonl"),
)


def run(folder: tuple[str, ...], *, parquet: bool = False, out: Path | None = None) -> Answer:
    """Merge and write the rows, sorted: the same results give the same file."""
    if parquet:
        require("Parquet", "pyarrow")
    rows = merge(folder)
    path = (out or Path("out/merge")) / ("rows.parquet" if parquet else "rows.jsonl")
    write_rows(path, rows)
    units = {row["unit"] for row in rows}
    kinds = dict(Counter(row["kind"] for row in rows))
    return Answer(
        text=f"{len(rows)} rows of {len(units)} units: {path}",
        plain={"schema": SCHEMA, "path": str(path), "units": len(units), "rows": kinds},
    )
