"""`ves-gym search`: the settings of a sweep that do best, found with Optuna."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from ves_gym.cli.common import progress, write_json
from ves_gym.cli.sweep import add_workers_argument

SCHEMA = "ves-search/1"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "spec", metavar="SPEC", help="a .toml file with a table [search] (docs/sweeps.md)"
    )
    add_workers_argument(parser)


def run(args: argparse.Namespace) -> int:
    """Search, print the best trials; exit status 1 if every trial failed."""
    from ves_gym.experiments.search import read_search, search

    specification, _ = read_search(args.spec)
    folder = Path(args.out or f"out/search/{Path(args.spec).stem}")
    with progress() as on_progress:
        outcome = search(
            args.spec,
            folder,
            seed=args.seed,
            progress=on_progress,
            workers=args.workers,
        )
    _print(outcome.trials, specification.objective, specification.direction)
    write_json(
        args.json,
        {
            "schema": SCHEMA,
            "folder": str(folder),
            "objective": specification.objective,
            "direction": specification.direction,
            "best": outcome.best,
            "trials": outcome.trials,
        },
    )
    return 0 if outcome.best is not None else 1


def _print(trials: list[dict[str, Any]], objective: str, direction: str) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console(width=None if sys.stdout.isatty() else 110, markup=False)
    done = [t for t in trials if t["state"] == "complete"]
    done.sort(key=lambda t: t["value"] if direction == "minimize" else -t["value"])
    table = Table(title=f"{len(done)} of {len(trials)} trials complete, best first")
    table.add_column("trial", justify="right")
    table.add_column(objective, justify="right")
    table.add_column("settings")
    for trial in done[:10]:
        settings = ", ".join(
            f"{k.rpartition('.')[2]} {v:.4g}" if isinstance(v, float) else
            f"{k.rpartition('.')[2]} {v}"
            for k, v in trial["params"].items()
        )  # fmt: skip
        table.add_row(str(trial["number"]), f"{trial['value']:.5g}", settings)
    console.print(table)
    for trial in trials:
        if trial["state"] == "fail":
            print(f"trial {trial['number']} failed: {trial['why']}", file=sys.stderr)
