"""`ves-gym merge`: one table of the results of one sweep or of several machines' folders."""

from __future__ import annotations

import argparse
from collections import Counter
from pathlib import Path

from ves_gym._util.optional import require
from ves_gym.cli.common import write_json

SCHEMA = "ves-merge/1"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "folders", metavar="FOLDER", nargs="+", help="that `ves-gym sweep` made"
    )
    parser.add_argument(
        "--parquet", action="store_true", help="write rows.parquet instead of rows.jsonl"
    )


def run(args: argparse.Namespace) -> int:
    """Merge and write the rows, sorted: the same results give the same file."""
    from ves_gym.experiments.sweep import merge, write_rows

    if args.parquet:
        require("Parquet", "pyarrow")
    rows = merge(args.folders)
    path = Path(args.out or "out/merge") / ("rows.parquet" if args.parquet else "rows.jsonl")
    write_rows(path, rows)
    units = {row["unit"] for row in rows}
    print(f"{len(rows)} rows of {len(units)} units: {path}")
    kinds = dict(Counter(row["kind"] for row in rows))
    write_json(
        args.json,
        {"schema": SCHEMA, "path": str(path), "units": len(units), "rows": kinds},
    )
    return 0
