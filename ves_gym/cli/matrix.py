"""`ves-gym matrix`: methods x machines x tasks x seeds, one page with intervals."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

from ves_gym._util.optional import installed
from ves_gym._util.params import write_text
from ves_gym.cli.common import add_format, progress, write_json
from ves_gym.cli.sweep import add_workers_argument, print_report

SCHEMA = "ves-matrix/1"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("matrix", metavar="FILE", help="a .toml file (docs/sweeps.md)")
    parser.add_argument("--episodes", type=int, metavar="N", help="instead of the file's")
    parser.add_argument("--seeds", type=int, metavar="N", help="only the first N of the file's")
    parser.add_argument(
        "--steps", type=int, metavar="N", help="of every training, instead of its own"
    )
    parser.add_argument(
        "--partial", action="store_true",
        help="run nothing: page and picture of the cells that have all their results",
    )  # fmt: skip
    add_format(parser)
    add_workers_argument(parser)


def run(args: argparse.Namespace) -> int:
    """Do what has no result yet; write page, picture and figures of what is complete."""
    from ves_gym.experiments.matrix import entries, read_matrix, run_matrix, shortened
    from ves_gym.experiments.sweep import Report
    from ves_gym.report.matrix_page import crossover_figure, matrix_page

    stated = read_matrix(args.matrix)
    matrix = dataclasses.replace(
        stated,
        episodes=stated.episodes if args.episodes is None else args.episodes,
        seeds=stated.seeds if args.seeds is None else stated.seeds[: args.seeds],
        tasks=stated.tasks if args.steps is None else shortened(stated, args.steps),
    )
    folder = Path(args.out or f"out/matrix/{Path(args.matrix).stem}")
    if args.partial:
        report = Report(folder)
    else:
        with progress() as on_progress:
            report = run_matrix(matrix, folder, progress=on_progress, workers=args.workers)
        print_report(report)
    results = []
    if report.complete:
        results = entries(matrix, folder)
        title = "Methods on machines that are not as described"
        write_text(folder / "matrix.md", matrix_page(matrix, results, title))
        if installed("matplotlib"):
            from ves_gym.report.figures import write_figure

            picture = folder / f"crossover.{args.format}"
            write_figure(crossover_figure(matrix, results), picture)
        print(folder / "matrix.md")
    write_json(
        args.json,
        {
            "schema": SCHEMA,
            **report.to_dict(),
            "entries": [_plain(entry) for entry in results],
        },
    )
    return 0 if report.complete else 1


def _plain(entry: object) -> dict[str, object]:
    """Figures as plain data; what is infinite becomes null."""
    out: dict[str, object] = {}
    for field in dataclasses.fields(entry):  # type: ignore[arg-type]
        value = getattr(entry, field.name)
        if isinstance(value, tuple):
            value = [x if abs(x) < float("inf") else None for x in value]
        out[field.name] = value
    return out
