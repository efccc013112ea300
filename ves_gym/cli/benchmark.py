"""`ves-gym benchmark`: the main job."""

from __future__ import annotations

import shlex
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from ves_gym._util.params import ParameterError, write_result
from ves_gym.cli.files import FORMAT
from ves_gym.cli.flags import Answer, Flag, Place, floats, integer, names, path, read, text
from ves_gym.cli.machine import MACHINE
from ves_gym.cli.plan import WEIGHT
from ves_gym.planners.benchmark import merge_best, run_benchmark
from ves_gym.planners.case import Case
from ves_gym.planners.objective import parse_weights
from ves_gym.planners.registry import PLANNERS, get_planner, weighted
from ves_gym.planners.suites import OBSTACLES, SUITES, get_suite, part_of
from ves_gym.system.disturbance import MEASURES
from ves_gym.system.frequency_weight import FAST, FrequencyWeight


def _planners(value: str, place: Place) -> list[str]:
    if value == "all":
        return list(PLANNERS)
    return [get_planner(name).name for name in names(value, place)]


def _weights(value: str, place: Place) -> list[str]:
    """Names of `refined` without weights and with each of these."""
    name, equals, values = value.partition("=")
    if not equals:
        raise ParameterError(
            f"{place.name} must be like acceleration_peak=0.003,0.03,0.3, got {value!r}"
        )
    weights = [parse_weights(f"{name}={part}") for part in values.split(",")]
    return ["refined", *(weighted(get_planner("refined"), w).name for w in weights)]


FLAGS = (
    Flag("--suite", "S", text, f"{', '.join(SUITES)} (reach100)"),
    Flag("--planners", "A,B", _planners,
         f"all, or of {', '.join(PLANNERS)}; default the suite's own"),
    Flag("--obstacles", "O", text, f"{', '.join(OBSTACLES)} (reach100; off)"),
    Flag("--durations", "S,S", read(floats, "numbers like 1,2,4 [s]"),
         "only queries of these durations [s]; default all"),
    Flag("--first", "N", integer(1), "only N queries per duration"),
    Flag("--skip", "N", integer(), "leave out N of each first (0)"),
    Flag("--quick", help="ten queries per duration"),
    Flag("--weights", "NAME=W,W,...", _weights,
         "also `refined` with each of these weights of a disturbance measure (pareto.png):"
         f" {', '.join(MEASURES)}"),
    WEIGHT,
    Flag("--workers", "N", integer(1), "planning processes"),
    Flag("--keep-best", "FILE", path, "merge the least energies into FILE (best known)"),
    Flag("--no-figures", help="skip figures and report"),
    FORMAT,
    # suites name what they ask of: the vehicle stays a name
    *(replace(flag, read=text) if flag.name == "--vehicle" else flag for flag in MACHINE),
)  # fmt: skip


def run(
    case: Case,
    *,
    suite: str = "reach100",
    vehicle: str | None = None,
    planners: list[str] | None = None,
    weights: list[str] | None = None,
    weight: FrequencyWeight = FAST,
    obstacles: str = "off",
    quick: bool = False,
    durations: list[float] | None = None,
    first: int | None = None,
    skip: int = 0,
    keep_best: Path | None = None,
    no_figures: bool = False,
    out: Path | None = None,
    progress: Any = None,
    **how: Any,
) -> Answer:
    """Plan, simulate; the table, JSON, figures and the HTML report."""
    from ves_gym.report.benchmark import benchmark_text, write_page
    from ves_gym.report.figures import benchmark_figures

    chosen = get_suite(
        suite, system=case.system, vehicle=vehicle, quick=quick, obstacles=obstacles
    )
    chosen = part_of(chosen, durations, first=first, skip=skip)
    queries = tuple((name, replace(q, weight=weight)) for name, q in chosen.queries)
    if weights is not None:
        planners = list(dict.fromkeys([*(planners or chosen.planners), *weights]))
    command = shlex.join(["ves-gym", *sys.argv[1:]])
    result = run_benchmark(
        replace(chosen, queries=queries), planners=planners, seed=case.seed, command=command,
        progress=progress, **how,
    )  # fmt: skip
    result["quick"] = quick
    folder = out or Path(f"out/{chosen.name}")
    drawn = ("traces", "maps", "scenes")  # only the page has them
    plain = {key: value for key, value in result.items() if key not in drawn}
    files = [folder / "benchmark.json"]
    write_result(files[0], plain)
    lines = [benchmark_text(result)]
    if keep_best is not None:
        lines.append(f"best known: {merge_best(keep_best, result)} new or lower")
        files.append(keep_best)
    if not no_figures:
        files.append(folder / "report.html")
        write_page(result, files[-1])
    lines.append(f"{len(result['rows'])} runs in {result['seconds']:.0f} s")
    return Answer(
        text="\n".join(lines),
        plain=plain,
        files=files,
        figures=lambda: {folder / k: figure for k, figure in benchmark_figures(result).items()},
    )
