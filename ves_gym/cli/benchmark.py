"""`ves-gym benchmark`: the main job."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

from ves_gym._util.optional import lacking
from ves_gym._util.params import ParameterError
from ves_gym.cli.common import (
    add_format,
    add_frequency_weight,
    add_system_arguments,
    frequency_weight_from,
    out_dir,
    progress,
    system_from,
    write_json,
)
from ves_gym.planners.benchmark import run_benchmark
from ves_gym.planners.benchmark_summary import merge_best
from ves_gym.planners.objective import parse_weights
from ves_gym.planners.registry import PLANNERS, get_planner, weighted
from ves_gym.planners.suites import OBSTACLES, SUITES, Suite, get_suite
from ves_gym.report.figures import write_figures
from ves_gym.system.disturbance import MEASURES

_NAME = 24  # characters of a planner's name in a line: its weights may take more
_STOPS = 10  # stopped runs named on the terminal


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("--suite", default="reach100", help=f"{', '.join(SUITES)}")
    parser.add_argument(
        "--planners",
        metavar="A,B",
        help=f"all, or of {', '.join(PLANNERS)}; default the suite's own",
    )
    parser.add_argument(
        "--obstacles",
        default="off",
        metavar="O",
        help=f"{', '.join(OBSTACLES)} (reach100; off)",
    )
    parser.add_argument(
        "--durations", metavar="S,S", help="only queries of these durations [s]; default all"
    )
    parser.add_argument("--first", type=int, metavar="N", help="only N queries per duration")
    parser.add_argument("--skip", type=int, metavar="N", help="leave out N of each first (0)")
    parser.add_argument("--quick", action="store_true", help="ten queries per duration")
    parser.add_argument(
        "--weights",
        metavar="NAME=W,W,...",
        help="also `refined` with each of these weights of a disturbance measure (pareto.png):"
        f" {', '.join(MEASURES)}",
    )
    add_frequency_weight(parser)
    parser.add_argument("--workers", type=int, metavar="N", help="planning processes")
    parser.add_argument(
        "--keep-best", metavar="FILE", help="merge the least energies into FILE (best known)"
    )
    parser.add_argument("--no-figures", action="store_true", help="skip figures and report")
    add_format(parser)
    add_system_arguments(parser, angles=False)


def run(args: argparse.Namespace) -> int:
    """Plan, simulate, print the table, write JSON, figures and the HTML report."""
    if args.workers is not None and args.workers < 1:
        raise ParameterError(f"--workers must be >= 1, got {args.workers}")
    names = None
    if args.planners == "all":
        names = list(PLANNERS)
    elif args.planners is not None:
        names = [get_planner(name.strip()).name for name in args.planners.split(",")]
    if args.weights is not None:
        names = list(dict.fromkeys([*(names or ()), *_weighted_names(args.weights)]))
    base = argparse.Namespace(**{**vars(args), "vehicle": None})
    suite = _part_of(
        get_suite(
            args.suite,
            system=system_from(base),
            vehicle=args.vehicle,
            quick=args.quick,
            obstacles=args.obstacles,
        ),
        args,
    )
    if args.weights is not None and args.planners is None:
        names = list(dict.fromkeys([*suite.planners, *(names or ())]))
    weight = frequency_weight_from(args)
    queries = tuple((v, replace(q, weight=weight)) for v, q in suite.queries)
    suite = replace(suite, queries=queries)
    with progress() as on_progress:
        result = run_benchmark(
            suite,
            planners=names,
            seed=args.seed,
            workers=args.workers,
            command=shlex.join(["ves-gym", *sys.argv[1:]]),
            progress=on_progress,
        )
    result["quick"] = bool(args.quick)
    _print_tables(result)
    folder = out_dir(args, f"out/{suite.name}")
    write_json(str(folder / "benchmark.json"), _compact(result))
    write_json(args.json, _compact(result))
    written: list[Path] = [folder / "benchmark.json"]
    if args.keep_best is not None:
        print(f"best known: {merge_best(args.keep_best, result)} new or lower")
        written.append(Path(args.keep_best))
    if not args.no_figures:
        written += _pictures(result, folder, args.format)
    print(f"\n{len(result['rows'])} runs in {result['seconds']:.0f} s; written:")
    for path in written:
        print(f"  {path}")
    return 0


def _weighted_names(text: str) -> list[str]:
    """Names of `refined` without weights and with each that --weights asks for."""
    name, equals, values = text.partition("=")
    if not equals:
        raise ParameterError(
            f"--weights must be like acceleration_peak=0.003,0.03,0.3, got {text!r}"
        )
    weights = [parse_weights(f"{name}={value}") for value in values.split(",")]
    return ["refined", *(weighted(get_planner("refined"), w).name for w in weights)]


def _part_of(suite: Suite, args: argparse.Namespace) -> Suite:
    """The suite with the durations and the number of queries that are asked for."""
    queries = list(suite.queries)
    if args.durations is not None:
        try:
            durations = {float(part) for part in args.durations.split(",")}
        except ValueError:
            raise ParameterError(
                f"--durations must be numbers like 1,2,4 [s], got {args.durations!r}"
            ) from None
        available = sorted({q.duration for _, q in queries})
        if not durations <= set(available):
            raise ParameterError(
                f"--durations must be of {', '.join(f'{k:g}' for k in available)} s, got"
                f" {args.durations}"
            )
        queries = [(v, q) for v, q in queries if q.duration in durations]
    skip = 0 if args.skip is None else args.skip
    if skip < 0:
        raise ParameterError(f"--skip must be >= 0, got {skip}")
    if args.first is not None and args.first < 1:
        raise ParameterError(f"--first must be >= 1, got {args.first}")
    counted: Counter[tuple[str, float]] = Counter()
    chosen = []
    for vehicle, query in queries:
        counted[vehicle, query.duration] += 1
        if skip < counted[vehicle, query.duration] <= skip + (args.first or len(queries)):
            chosen.append((vehicle, query))
    if not chosen:
        raise ParameterError(f"--skip {skip} leaves none of {max(counted.values())} queries")
    return replace(suite, queries=tuple(chosen))


def _compact(result: dict[str, Any]) -> dict[str, Any]:
    """The result without what only the page draws."""
    return {k: v for k, v in result.items() if k not in ("traces", "maps", "scenes")}


def _pictures(result: dict[str, Any], folder: Path, form: str) -> list[Path]:
    from ves_gym.report.page import write_page

    page = folder / "report.html"
    write_page(result, page)
    if sentence := lacking("drawing", "matplotlib"):
        print(f"no pictures: {sentence}")
        return [page]
    return [page, *write_figures(result, folder, form)]


def _print_tables(result: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    emulated = result["mode"] == "emulated"
    scores = any(row["score_median"] is not None for row in result["summary"])
    width = 164 if emulated else 136
    console = Console(width=None if sys.stdout.isatty() else width, markup=False)
    for vehicle in result["systems"]:
        table = Table(title=f"Energy in the base: suite {result['suite']}, {vehicle}")
        table.add_column("T [s]", no_wrap=True)
        table.add_column("planner", overflow="fold", max_width=_NAME)
        for name in (
            "E_mean [J]",
            "ratio",
            *(("score",) if scores else ()),
            "E_res",
            "E_peak",
            "acc.\npeak",
            *(("emulation\nerror", "base\nerror") if emulated else ()),
            "off",
            "success",
            "plan [s]\nmost",
        ):
            table.add_column(name, justify="right", no_wrap=True)
        previous = None
        for row in (r for r in result["summary"] if r["vehicle"] == vehicle):
            if previous not in (None, row["duration"]):
                table.add_section()
            previous = row["duration"]
            table.add_row(
                f"{row['duration']:g}",
                row["planner"],
                _number(row["E_mean_median"], ".4g"),
                _number(row["ratio_median"], ".3f") + _interval(row),
                *((_number(row["score_median"], ".3f"),) if scores else ()),
                _number(row["E_res_ratio_median"], ".3f"),
                _number(row["E_peak_ratio_median"], ".3f"),
                _number(row["acceleration_peak_ratio_median"], ".2f"),
                *_errors(row),
                _number(row["prediction_error_median"], ".2%"),
                f"{100 * row['success_rate']:.0f} %",
                f"{row['plan_seconds_median']:.2f} {row['plan_seconds_max']:6.2f}",
            )
        console.print(table)
    console.print(
        "Medians over queries. ratio: E_mean over the straight line's on the same query, with\n"
        "the 95 % interval of the median; E_res, E_peak and the base's largest acceleration:\n"
        "likewise; score: 0 the straight line, 1 the best known; off: predicted E_mean\n"
        "against the simulated one; success: of all queries; plan: median and longest\n"
        "planning time.",
        style="dim",
    )
    _print_disturbances(result, console)
    _print_failures(result, console)
    _print_limits(result, console)
    if emulated:
        console.print(
            "Energies are those of the emulated base. emulation error: its E_mean over that of"
            " the same motion\nin space, less 1; base error: largest distance between the two"
            " base positions over the largest\ndisplacement in space; off: against E_mean in"
            " space.",
            style="dim",
        )
        _print_machine(result, console)


_SHOWN = {  # measure -> heading
    "acceleration": "acc.\nm/s^2",
    "acceleration_peak": "peak\nm/s^2",
    "angular_peak": "angular\nrad/s^2",
    "tip_peak": "tip\nm",
    "tip_end": "at end\nm",
    "displacement_peak": "moved\nm",
    "attitude_end": "turned\nrad",
    "E_weighted": "weighted\nJ",
}


def _print_disturbances(result: dict[str, Any], console: Any) -> None:
    """Print what base and tool do, medians."""
    from rich.table import Table

    for vehicle in result["systems"]:
        table = Table(title=f"Motion of base and tool: suite {result['suite']}, {vehicle}")
        table.add_column("T [s]", no_wrap=True)
        table.add_column("planner", overflow="fold", max_width=_NAME)
        for name in _SHOWN.values():
            table.add_column(name, justify="right", no_wrap=True)
        for row in (r for r in result["summary"] if r["vehicle"] == vehicle):
            cells = (_number(row[f"{name}_median"], ".3g") for name in _SHOWN)
            table.add_row(f"{row['duration']:g}", row["planner"], *cells)
        console.print(table)
    console.print(
        "Medians. acc., angular: acceleration of the arm's mount (root mean square over the\n"
        "motion and 10 s after it, and peak) and of the base's rotation (peak); tip: largest\n"
        "error of the tool, and at the end; moved: the mount at most; turned: the base at the\n"
        "end; "
        f"weighted: mean energy after a filter of gain {result['frequency_weight']}.",
        style="dim",
    )


def _print_failures(result: dict[str, Any], console: Any) -> None:
    """Print the reasons why planners had no answer, most frequent first."""
    failures = Counter((r["planner"], r["failure"]) for r in result["rows"] if r["failure"])
    for (planner, why), count in failures.most_common(_STOPS):
        console.print(f"failed {count} x: {planner}: {why}", soft_wrap=True)
    if len(failures) > _STOPS:
        console.print(f"... and {len(failures) - _STOPS} more reasons, see benchmark.json")
    among = [s for s in result["summary"] if s["solvable"] < s["n"]]
    if among:
        rates = {s["planner"]: [0, 0] for s in among}
        for s in among:
            rates[s["planner"]][0] += round((s["solvable_rate"] or 0.0) * s["solvable"])
            rates[s["planner"]][1] += s["solvable"]
        text = ", ".join(f"{name} {a}/{b}" for name, (a, b) in rates.items())
        console.print(f"of the solvable queries: {text}", soft_wrap=True)


def _print_limits(result: dict[str, Any], console: Any) -> None:
    """Say which successes leave the limits: as commanded, and as the arm moved."""
    for of, key in (("reference", "reference_breaks"), ("simulated arm", "arm_breaks")):
        counts: Counter[str] = Counter()
        for row in result["rows"]:
            counts[row["planner"]] += bool(row["success"] and row[key])
        if not (some := +counts):
            console.print(f"{of} inside the limits on every success")
            continue
        text = ", ".join(f"{name} {count}" for name, count in some.items())
        console.print(f"{of} NOT inside the limits, of the successes: {text}", soft_wrap=True)
        first = next(r for r in result["rows"] if r["success"] and r[key])
        console.print(
            f"  such as {first['planner']}, {first['query']}: {first[key]}", soft_wrap=True
        )


def _print_machine(result: dict[str, Any], console: Any) -> None:
    """Print the emulator's settings and the runs that it had to stop."""
    machine = "; ".join(f"{k}: {v}" for k, v in result["machine"].items())
    console.print(f"\n{machine}", soft_wrap=True)
    for entry in result["rank_correlation"]:
        console.print(
            f"planners rank as in space: {entry['vehicle']}, T = {entry['duration']:g} s:"
            f" rho = {_number(entry['rho_median'], '.2f')} (median of {entry['n']})",
            soft_wrap=True,
        )
    stopped = [row for row in result["rows"] if row["stopped"]]
    for row in stopped[:_STOPS]:
        console.print(
            f"stopped: {row['vehicle']}, {row['query']}, {row['planner']}: {row['stopped']}",
            soft_wrap=True,
        )
    if len(stopped) > _STOPS:
        console.print(f"... and {len(stopped) - _STOPS} more stopped, see benchmark.json")


def _errors(row: dict[str, Any]) -> list[str]:
    """Cells that only a summary of mode emulated has."""
    if "stopped" not in row:
        return []
    error, base = row["emulation_error_median"], row["base_error_median"]
    if row["stopped"] == row["n"]:
        return ["stopped", "-"]
    return [_number(error, "+.2%"), _number(base, ".2%")]


def _interval(row: dict[str, Any]) -> str:
    if row["n"] == 1 or row["ratio_low"] is None:
        return ""
    return f" ({row['ratio_low']:.2f}-{row['ratio_high']:.2f})"


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)
