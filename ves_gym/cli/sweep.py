"""`ves-gym sweep`: every unit of a spec once, in processes of this machine."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from ves_gym._util.params import ParameterError
from ves_gym.cli.common import progress, write_json

SCHEMA = "ves-sweep/1"
if TYPE_CHECKING:
    from ves_gym.experiments.sweep import Report

_SHOWN = 10  # failures that are printed


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("spec", metavar="SPEC", help="a .toml file (docs/sweeps.md)")
    add_workers_argument(parser)
    parser.add_argument(
        "--again", action="store_true", help="do finished units again (default: skip them)"
    )
    parser.add_argument(
        "--part", metavar="K/N", default="1/1", help="every N-th unit from the K-th"
    )


def add_workers_argument(parser: argparse.ArgumentParser) -> None:
    """--workers."""
    parser.add_argument(
        "--workers", type=int, metavar="N", help="processes; default one per processor"
    )


def run(args: argparse.Namespace) -> int:
    """Sweep, merge, print what failed; exit status 1 if anything did."""
    from ves_gym.experiments.sweep import merge, sweep, write_rows

    folder = Path(args.out or f"out/sweep/{Path(args.spec).stem}")
    with progress() as on_progress:
        report = sweep(
            args.spec,
            folder,
            resume=not args.again,
            part=_part(args.part),
            progress=on_progress,
            workers=args.workers,
        )
    rows = merge([folder]) if report.done or report.skipped else []
    if rows:
        write_rows(folder / "rows.jsonl", rows)
    print_report(report)
    write_json(
        args.json,
        {"schema": SCHEMA, **report.to_dict(), "rows": len(rows)},
    )
    return 0 if report.complete else 1


def print_report(report: Report) -> None:
    """Print the counts of units, and why the first of those that failed did.

    Args:
        report: of a sweep, or of a matrix.
    """
    print(report.summary)
    for text in list(report.failed.values())[:_SHOWN]:
        print(f"failed: {text}", file=sys.stderr)


def _part(text: str) -> tuple[int, int]:
    try:
        k, n = (int(word) for word in text.split("/"))
    except ValueError:
        raise ParameterError(f"--part must be K/N, like 1/4, got {text!r}") from None
    return k, n
