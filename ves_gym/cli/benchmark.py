"""`ves-gym benchmark`: the main job."""

from __future__ import annotations

import argparse
import shlex
import sys
from pathlib import Path
from typing import Any

from ves_gym.cli.common import add_system_arguments, out_dir, progress, system_from, write_json
from ves_gym.core.params import ParameterError
from ves_gym.planners.benchmark import run_benchmark
from ves_gym.planners.registry import PLANNERS, get_planner
from ves_gym.planners.suites import SUITES, get_suite


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("--suite", default="reach100", help=f"{', '.join(SUITES)}")
    parser.add_argument(
        "--planners", metavar="A,B", help=f"of {', '.join(PLANNERS)}; default the suite's own"
    )
    parser.add_argument("--quick", action="store_true", help="ten queries per duration")
    parser.add_argument("--workers", type=int, metavar="N", help="planning processes")
    parser.add_argument("--no-figures", action="store_true", help="skip figures and report")
    add_system_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Plan, simulate, print the table, write JSON, figures and the HTML report."""
    if args.workers is not None and args.workers < 1:
        raise ParameterError(f"--workers must be >= 1, got {args.workers}")
    names = None
    if args.planners is not None:
        names = [get_planner(name.strip()).name for name in args.planners.split(",")]
    base = argparse.Namespace(**{**vars(args), "vehicle": None})
    suite = get_suite(
        args.suite, system=system_from(base), vehicle=args.vehicle, quick=args.quick
    )
    with progress() as tell:
        result = run_benchmark(
            suite,
            planners=names,
            seed=args.seed,
            workers=args.workers,
            command=shlex.join(["ves-gym", *sys.argv[1:]]),
            progress=tell,
        )
    result["quick"] = bool(args.quick)
    _print_table(result)
    folder = out_dir(args, f"out/{suite.name}")
    write_json(str(folder / "benchmark.json"), _compact(result))
    write_json(args.json, _compact(result))
    written: list[Path] = [folder / "benchmark.json"]
    if not args.no_figures:
        written += _pictures(result, folder)
    print(f"\n{len(result['rows'])} runs in {result['seconds']:.0f} s; written:")
    for path in written:
        print(f"  {path}")
    return 0


def _compact(result: dict[str, Any]) -> dict[str, Any]:
    """The result without what only the page draws."""
    return {k: v for k, v in result.items() if k not in ("traces", "maps", "scenes")}


def _pictures(result: dict[str, Any], folder: Path) -> list[Path]:
    from ves_gym.report.figures import write_figures
    from ves_gym.report.page import write_page

    page = folder / "report.html"
    write_page(result, page)
    return [page, *write_figures(result, folder)]


def _print_table(result: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(
        title=f"Energy transferred to the base, suite {result['suite']}: medians over queries",
        caption="ratio: E_mean over the straight line's on the same query, 95 % interval",
    )
    for name in ("vehicle", "T [s]", "planner", "E_mean [J]", "ratio", "interval"):
        table.add_column(name, justify="left" if name in ("vehicle", "planner") else "right")
    for name in ("E_res ratio", "E_peak ratio", "predicted", "success", "plan [s]"):
        table.add_column(name, justify="right")
    previous = None
    for row in result["summary"]:
        group = row["vehicle"], row["duration"]
        if previous not in (None, group):
            table.add_section()
        previous = group
        error = row["prediction_error_median"]
        table.add_row(
            row["vehicle"],
            f"{row['duration']:g}",
            row["planner"],
            f"{row['E_mean_median']:.4g}",
            f"{row['ratio_median']:.3f}",
            f"{row['ratio_low']:.3f}-{row['ratio_high']:.3f}",
            f"{row['E_res_ratio_median']:.3f}",
            f"{row['E_peak_ratio_median']:.3f}",
            "-" if error is None else f"{100 * error:.2f} %",
            f"{100 * row['success_rate']:.0f} %",
            f"{row['plan_seconds_median']:.2f}",
        )
    Console(width=None if sys.stdout.isatty() else 120).print(table)
