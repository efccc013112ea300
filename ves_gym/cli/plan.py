"""`ves-gym plan`: one path by one planner, predicted and simulated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import ves_gym.api as vg
from ves_gym._util.params import ParameterError
from ves_gym.cli.flags import (
    UNITS,
    Answer,
    Flag,
    Place,
    grouped,
    number,
    per_joint,
    text,
    whole,
)
from ves_gym.cli.machine import MACHINE, read
from ves_gym.cli.simulate import DURATION, GOAL, START
from ves_gym.mechanics.tool_pose import ToolPose
from ves_gym.planners.case import Case
from ves_gym.planners.objective import WEIGHTS, parse_weights
from ves_gym.planners.obstacles import read_surroundings
from ves_gym.planners.ompl_search import Ompl
from ves_gym.planners.ompl_worker import ALGORITHMS
from ves_gym.planners.plan_report import report_plan
from ves_gym.planners.query import Planner
from ves_gym.planners.registry import PLANNERS, get_planner
from ves_gym.planners.robust import Robust
from ves_gym.planners.uncertainty import Uncertainty, read_uncertainty
from ves_gym.system.frequency_weight import FAST, FrequencyWeight


def _pose(value: str, place: Place) -> ToolPose:
    """Read the tool pose that `--tool` describes."""
    try:
        values = [float(part) for part in value.split(",")]
    except ValueError:
        values = []
    if len(values) not in (3, 6):
        raise ParameterError(
            "--tool must be three lengths in m, or these and three angles in degrees, like"
            f" 0.6,0.2,1.1 or 0.6,0.2,1.1,0,90,0, got {value!r}"
        )
    factor = 1.0 if place.angles == "radians" else UNITS["deg"]
    turn = tuple(k * factor for k in values[3:])
    return ToolPose(position=tuple(values[:3]), angles=turn or None)


WEIGHT = Flag(
    "--frequency-weight",
    "HZ:GAIN,...",
    read(FrequencyWeight.parse),
    f"filter of E_weighted: gains at frequencies, like 0.5:0,2:1 (default {FAST})",
    to="weight",
)
FLAGS = (
    START,
    replace(GOAL, against="goal"),
    Flag("--tool", "X,Y,Z[,A,B,C]", _pose,
         "in place of --goal: position of the tool in the platform-top frame [m] and, if its"
         " turn matters, Z-Y-X fixed angles about x, y, z [deg]; the configuration that leaves"
         " the base least energy is chosen", against="goal"),
    DURATION,
    Flag("--planner", "P", text, f"{', '.join(PLANNERS)} (direct; robust with --robust-from)"),
    Flag("--v-max", "A,B,C", per_joint("deg/s", none=True),
         "joint speed limits [deg/s], or none (default: those of the arm)"),
    Flag("--a-max", "A,B,C", per_joint("deg/s^2"),
         "joint acceleration limits [deg/s^2] (none)"),
    Flag("--obstacles", "FILE", read(read_surroundings),
         "surroundings in TOML or JSON: clearance [m], obstacles (spheres, boxes); the arm's"
         " own links, platform and beam then count too", to="surroundings"),
    Flag("--weight", "NAME=W", text,
         "minimise a disturbance measure as well (direct, refined; repeatable), W times the"
         f" straight line's energy at the straight line's value: {', '.join(WEIGHTS)}",
         to="weights", many=True),
    WEIGHT,
    Flag("--robust-from", "FILE", read(lambda file: (file, read_uncertainty(file))),
         "what is uncertain, for planners robust and robust-worst: diagnosis.json of `ves-gym"
         " diagnose` (the machine is then the diagnosed one), or ranges in TOML: [effect]"
         " parameter = [low, high]"),
    *grouped(
        "search (planners ompl-...)",
        Flag("--algorithm", "A", text, f"{', '.join(ALGORITHMS)} (bitstar)"),
        Flag("--evaluations", "N", whole(1), "budget of edge costs"),
        Flag("--seconds", "S", number("s", above=0), "budget of time [s]"),
    ),
    *MACHINE,
)  # fmt: skip


def run(
    case: Case,
    *,
    machine: dict[str, Any],
    goal: Any = None,
    tool: ToolPose | None = None,
    planner: str | None = None,
    weights: Sequence[str] = (),
    robust_from: tuple[str, Uncertainty] | None = None,
    algorithm: str | None = None,
    evaluations: int | None = None,
    seconds: float | None = None,
    out: Path | None = None,
    **asked: Any,
) -> Answer:
    """Plan, simulate beside the straight line; negative if the path breaks a limit."""
    said = []
    if robust_from is not None:
        file, uncertain = robust_from
        method: Planner = _robust(planner or "robust", uncertain)
        said.append("uncertain: " + "; ".join(uncertain.lines))
        if uncertain.estimate is not None:
            if machine:
                raise ParameterError(
                    f"--robust-from {file} says what the machine is: leave out"
                    f" --{next(iter(machine))}"
                )
            case = Case(system=uncertain.estimate, seed=case.seed)
    else:
        method = get_planner(planner or "direct")
    budget = {"algorithm": algorithm, "evaluations": evaluations, "seconds": seconds}
    budget = {name: value for name, value in budget.items() if value is not None}
    if budget:
        if not isinstance(method, Ompl):
            raise ParameterError(
                f"--{next(iter(budget))} is for planners ompl-..., got {method.name}"
            )
        method = replace(method, **budget)  # type: ignore[arg-type]
    plan = vg.plan(
        case=case,
        goal=goal if tool is None else tool,
        planner=method,
        weights=parse_weights("+".join(weights)) if weights else None,
        **asked,
    )
    if tool is not None:
        at = ", ".join(f"{k + 0.0:.2f}" for k in np.rad2deg(plan.query.goal))
        said.append(f"goal: {at} deg")
    report = report_plan(plan)
    answer = Answer(
        text="\n".join([*said, str(report)]),
        plain=report.to_dict(),
        negative=not plan.feasible,
    )
    if plan.motion is None:
        return answer
    path = (out or Path("out/plan")) / "case.toml"
    replace(plan.case, log=str(path.with_name("run.csv"))).save(path)
    return replace(answer, files=[path], next=[["simulate", "--case", path]])


def _robust(name: str, uncertain: Uncertainty) -> Robust:
    named = get_planner(name)
    if not isinstance(named, Robust):
        raise ParameterError(
            f"--robust-from is for planners robust and robust-worst, got {named.name}"
        )
    return Robust(
        uncertain.ranges, objective=named.objective, name=named.name, around=uncertain.around
    )
