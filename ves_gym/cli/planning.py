"""`ves-gym plan`, `studio`, `benchmark`: paths, found, drawn and compared."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import ves_gym.api as vg
from ves_gym._util.params import ParameterError, write_result
from ves_gym.cli.flags import (
    DURATION,
    FORMAT,
    GOAL,
    START,
    UNITS,
    WORKERS,
    Answer,
    Context,
    Flag,
    Place,
    floats,
    grouped,
    integer,
    joints,
    names,
    number,
    per_joint,
    read,
    text,
)
from ves_gym.cli.machine import MACHINE
from ves_gym.mechanics.kinematics import ToolPose
from ves_gym.planners.benchmark import run_benchmark
from ves_gym.planners.bounds import USUAL, parse_bounds
from ves_gym.planners.case import Case
from ves_gym.planners.comparison import report_plan
from ves_gym.planners.obstacles import read_surroundings
from ves_gym.planners.ompl_search import ALGORITHMS, Ompl
from ves_gym.planners.query import Planner
from ves_gym.planners.registry import DEFAULT, PLANNERS, bounded, get_planner, own_planner
from ves_gym.planners.robust import Robust, Uncertainty, read_uncertainty
from ves_gym.planners.suites import OBSTACLES, SUITES, get_suite, part_of
from ves_gym.report.benchmark import benchmark_text, write_page
from ves_gym.report.figures import benchmark_figures
from ves_gym.report.notebook import Studio
from ves_gym.system.disturbance import MEASURES
from ves_gym.system.frequency_weight import FAST, FrequencyWeight

# ------------------------------------------------------------------------------ one path


def _lengths_and_angles(value: str) -> list[float]:
    numbers = floats(value)
    if len(numbers) not in (3, 6):
        raise ValueError
    return numbers


def _tool(value: str, place: Place) -> ToolPose:
    numbers = read(
        _lengths_and_angles,
        "three lengths in m, or these and three angles in degrees, like 0.6,0.2,1.1 or"
        " 0.6,0.2,1.1,0,90,0",
    )
    x, y, z, *angles = numbers(value, place)
    factor = 1.0 if place.angles == "radians" else UNITS["deg"]
    return ToolPose(position=(x, y, z), angles=tuple(k * factor for k in angles) or None)


def _v_max(value: str, place: Place) -> Any:
    return value if value == "none" else per_joint("deg/s")(value, place)


def plan(
    at: Context,
    *,
    goal: Any = None,
    tool: ToolPose | None = None,
    planner: Planner | None = None,
    bounds: Sequence[str] = (),
    robust_from: tuple[str, Uncertainty] | None = None,
    algorithm: str | None = None,
    evaluations: int | None = None,
    seconds: float | None = None,
    **how: Any,
) -> Answer:
    """Plan, simulate beside the straight line; negative if the arm that plays it fails."""
    case, lines, folder = at.case, [], at.folder("out/plan")
    method = planner or get_planner("robust" if robust_from else DEFAULT)
    if robust_from is not None:
        file, uncertain = robust_from
        method = _robust(method, uncertain)
        lines.append("uncertain: " + "; ".join(uncertain.lines))
        if uncertain.estimate is not None:
            for option in at.machine:
                raise ParameterError(
                    f"--robust-from {file} says what the machine is: leave out --{option}"
                )
            case = Case(system=uncertain.estimate, seed=case.seed)
    budget = {"algorithm": algorithm, "evaluations": evaluations, "seconds": seconds}
    budget = {name: value for name, value in budget.items() if value is not None}
    for option in budget if not isinstance(method, Ompl) else ():
        raise ParameterError(f"--{option} is for planners ompl-..., got {method.name}")
    if budget:
        method = replace(method, **budget)  # type: ignore[type-var]
    if goal is None and tool is None and case.query is None:
        raise ParameterError(
            "plan needs --goal A,B,C, --tool X,Y,Z, or the --case FILE of another plan"
        )
    planned = vg.plan(
        case=case,
        goal=goal if tool is None else tool,
        planner=method,
        bounds=parse_bounds("+".join(bounds)) if bounds else None,
        **how,
    )
    if tool is not None:
        degrees = ", ".join(f"{k + 0.0:.2f}" for k in np.rad2deg(planned.query.goal))
        lines.append(f"goal: {degrees} deg")
    report = report_plan(planned)
    text = "\n".join([*lines, str(report)])
    answer = Answer(text=text, plain=report.to_dict(), negative=report.failure is not None)
    if planned.found is None:
        return answer
    path = folder / "case.toml"
    replace(planned.case, log=str(path.with_name("run.csv"))).save(path)
    return replace(answer, files=[path], then=[["simulate", "--case", path]])


def _robust(method: Planner, uncertain: Uncertainty) -> Robust:
    if not isinstance(method, Robust):
        raise ParameterError(
            f"--robust-from is for planners robust and robust-worst, got {method.name}"
        )
    return Robust(
        uncertain.ranges, objective=method.objective, name=method.name, around=uncertain.around
    )


def studio(at: Context, **how: Any) -> Answer:
    """Write the page; --out is its folder, or its name if that ends in .html."""
    query, path = at.case.query, at.folder("out/studio")
    if query is not None:
        how = {name: getattr(query, name) for name in ("start", "goal", "duration")} | how
    page = Studio(at.case.system, seed=at.case.seed, **how)
    path = path if path.suffix == ".html" else path / "studio.html"
    page.save(path)
    size = len(page.page.encode()) / 1e6
    return Answer(text=f"{size:.2f} MB; open it in any browser", plain=page.data, files=[path])


# ----------------------------------------------------------------------------- benchmark


def _planners(value: str, place: Place) -> list[str]:
    if value == "all":
        return list(PLANNERS)
    return [own_planner(name).name for name in names(value, place)]


def _bounds(value: str, place: Place) -> list[str]:
    """Names of `refined`, and of `calm` as it is and with each of these bounds."""
    name, equals, values = value.partition("=")
    if not equals:
        raise ParameterError(
            f"{place.name} must be like acceleration_peak=0.3,1,3, got {value!r}"
        )
    bounds = [parse_bounds(f"{name}={part}") for part in values.split(",")]
    return ["refined", *(bounded(get_planner("calm"), bound).name for bound in bounds)]


_QUICK = 5


def benchmark(
    at: Context,
    *,
    suite: str = "reach100",
    vehicle: str | None = None,
    planners: list[str] | None = None,
    bounds: list[str] | None = None,
    weight: FrequencyWeight = FAST,
    obstacles: str = "off",
    quick: bool = False,
    durations: list[float] | None = None,
    first: int | None = None,
    skip: int = 0,
    **how: Any,
) -> Answer:
    """Plan, simulate; the table, JSON, figures and the HTML report."""
    chosen = get_suite(suite, system=at.case.system, vehicle=vehicle, obstacles=obstacles)
    if quick:
        every = sorted({q.duration for _, q in chosen.queries})
        first, durations = first or _QUICK, durations or [every[len(every) // 2]]
    chosen = part_of(chosen, durations, first=first, skip=skip)
    folder = at.folder(Path("out", chosen.name))
    queries = tuple((name, replace(q, weight=weight)) for name, q in chosen.queries)
    if bounds is not None:
        planners = list(dict.fromkeys([*(planners or chosen.planners), *bounds]))
    result = run_benchmark(
        replace(chosen, queries=queries),
        planners=planners,
        seed=at.case.seed,
        command=shlex.join(["ves-gym", *sys.argv[1:]]),
        progress=at.progress,
        **how,
    )
    result["quick"] = quick
    drawn = ("traces", "maps", "scenes")  # only the page has them
    plain = {key: value for key, value in result.items() if key not in drawn}
    files = [folder / "benchmark.json"]
    write_result(files[0], plain)
    lines = [benchmark_text(result)]
    if at.pictures:
        files.append(folder / "report.html")
        write_page(result, files[-1])
    lines.append(f"{len(result['rows'])} runs in {result['seconds']:.0f} s")
    return Answer(
        text="\n".join(lines),
        plain=plain,
        files=files,
        figures=lambda: benchmark_figures(result),
        folder=folder,
    )


# -------------------------------------------------------------------------------- tables

WEIGHT = Flag(
    "--frequency-weight",
    "HZ:GAIN,...",
    read(FrequencyWeight.parse),
    f"filter of E_weighted: gains at frequencies, like 0.5:0,2:1 (default {FAST})",
    to="weight",
)
TABLE = {
    "plan": (plan, (
        START,
        replace(GOAL, against="goal"),
        Flag("--tool", "X,Y,Z[,A,B,C]", _tool,
             "in place of --goal: position of the tool in the platform-top frame [m] and, if"
             " its turn matters, Z-Y-X fixed angles about x, y, z [deg]; the configuration that"
             " leaves the base least energy is chosen", against="goal"),
        DURATION,
        Flag("--planner", "P", read(own_planner),
             f"{', '.join(PLANNERS)}, or one's own as module:Class ({DEFAULT}; robust with"
             " --robust-from)"),
        Flag("--v-max", "A,B,C", _v_max,
             "joint speed limits [deg/s], or none (default: those of the arm)"),
        Flag("--a-max", "A,B,C", per_joint("deg/s^2"),
             "joint acceleration limits [deg/s^2] (none)"),
        Flag("--obstacles", "FILE", read(read_surroundings),
             "surroundings in TOML or JSON: clearance [m], obstacles (spheres, boxes); the"
             " arm's own links, platform and beam then count too", to="surroundings"),
        Flag("--bound", "NAME=SHARE", text,
             "at most this share of the straight line's measure (calm; repeatable; inf: no"
             f" bound; usual: 1 for {', '.join(USUAL)}): {', '.join(MEASURES)}",
             to="bounds", many=True),
        WEIGHT,
        Flag("--robust-from", "FILE", read(lambda file: (file, read_uncertainty(file))),
             "what is uncertain, for planners robust and robust-worst: diagnosis.json of"
             " `ves-gym diagnose` (the machine is then the diagnosed one), or ranges in TOML:"
             " [effect] parameter = [low, high]"),
        *grouped(
            "search (planners ompl-...)",
            Flag("--algorithm", "A", text, f"{', '.join(ALGORITHMS)} (bitstar)"),
            Flag("--evaluations", "N", integer(1), "budget of edge costs"),
            Flag("--seconds", "S", number("s", above=0), "budget of time [s]"),
        ),
        *MACHINE,
    )),
    "studio": (studio, (
        START,
        GOAL,
        Flag("--via", "A,B,C", joints,
             "way-point of the drawn path [deg], repeatable (default: two that make it calm)",
             many=True),
        replace(DURATION, help="of the motion [s] (3)"),
        Flag("--planner", "P", read(lambda k: None if k == "none" else own_planner(k)),
             f"whose path is shown for comparison: {', '.join(PLANNERS)}, one's own as"
             " module:Class, or none (direct)"),
        Flag("--open", "FILE", text,
             "show it in the page, repeatable: a run log or episode (.parquet, .csv), a case,"
             " diagnosis.json", to="show", many=True),
        *MACHINE,
    )),
    "benchmark": (benchmark, (
        Flag("--suite", "S", text, f"{', '.join(SUITES)} (reach100)"),
        Flag("--planners", "A,B", _planners,
             f"all, or of {', '.join(PLANNERS)}, or one's own as module:Class; default the"
             " suite's own"),
        Flag("--obstacles", "O", text, f"{', '.join(OBSTACLES)} (reach100; off)"),
        Flag("--durations", "S,S", read(floats, "numbers like 1,2,4 [s]"),
             "only queries of these durations [s]; default all"),
        Flag("--first", "N", integer(1), "only N queries per duration"),
        Flag("--skip", "N", integer(), "leave out N of each first (0)"),
        Flag("--quick", help=f"{_QUICK} queries of the middle duration: half a minute"),
        Flag("--bounds", "NAME=SHARE,SHARE,...", _bounds,
             "also `refined` and `calm` with each of these bounds on a disturbance measure"
             f" (pareto.png): {', '.join(MEASURES)}"),
        WEIGHT,
        replace(WORKERS, help="planning processes"),
        Flag("--no-figures", help="skip figures and report"),
        FORMAT,
        # suites name what they ask of: the vehicle stays a name
        *(replace(flag, read=text) if flag.name == "--vehicle" else flag for flag in MACHINE),
    )),
}  # fmt: skip
