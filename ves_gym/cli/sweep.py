"""`ves-gym sweep`: every unit of a spec once, on this machine or a cluster."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ves_gym._util.params import ParameterError
from ves_gym.cli.common import progress, write_json

SCHEMA = "ves-sweep/1"
if TYPE_CHECKING:
    from ves_gym.experiments.sweep import Report

_SHOWN = 10  # failures that are printed


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("spec", metavar="SPEC", help="a .toml file (docs/sweeps.md)")
    add_executor_arguments(parser)
    parser.add_argument(
        "--again", action="store_true", help="do finished units again (default: skip them)"
    )
    parser.add_argument(
        "--part", metavar="K/N", default="1/1", help="every N-th unit from the K-th"
    )


def add_executor_arguments(parser: argparse.ArgumentParser) -> None:
    """--executor, --workers, --address, --slurm."""
    parser.add_argument(
        "--executor",
        metavar="E",
        default="local",
        help="local, slurm, submitit-local, dask or ray (default local)",
    )
    parser.add_argument(
        "--workers", type=int, metavar="N", help="at once; default one per processor"
    )
    parser.add_argument(
        "--address", metavar="URL", help="of a Dask scheduler (tcp://...) or a Ray cluster"
    )
    parser.add_argument(
        "--slurm",
        metavar="NAME=VALUE",
        action="append",
        default=[],
        help="parameter of submitit, such as slurm_partition=long; repeatable",
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
            **executor_options(args),
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


def executor_options(args: argparse.Namespace) -> dict[str, Any]:
    """Options of `sweep` and `search` that say where units run."""
    if args.workers is not None and args.workers < 1:
        raise ParameterError(f"--workers must be >= 1, got {args.workers}")
    return {
        "executor": args.executor,
        "workers": args.workers,
        "address": args.address,
        "slurm": _slurm(args.slurm),
    }


def _slurm(words: list[str]) -> dict[str, Any]:
    labels: dict[str, Any] = {}
    for word in words:
        name, equal, value = word.partition("=")
        if not name or not equal:
            raise ParameterError(f"--slurm must be NAME=VALUE, got {word!r}")
        labels[name] = int(value) if value.isdigit() else value
    return labels


def _part(text: str) -> tuple[int, int]:
    try:
        k, n = (int(word) for word in text.split("/"))
    except ValueError:
        raise ParameterError(f"--part must be K/N, like 1/4, got {text!r}") from None
    return k, n
