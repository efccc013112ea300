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
    floats,
    grouped,
    integer,
    number,
    per_joint,
    read,
    text,
)
from ves_gym.cli.machine import MACHINE
from ves_gym.cli.simulate import DURATION, GOAL, START
from ves_gym.mechanics.kinematics import ToolPose
from ves_gym.planners.case import Case
from ves_gym.planners.comparison import report_plan
from ves_gym.planners.objective import WEIGHTS, parse_weights
from ves_gym.planners.obstacles import read_surroundings
from ves_gym.planners.ompl_search import ALGORITHMS, Ompl
from ves_gym.planners.query import Planner
from ves_gym.planners.registry import PLANNERS, get_planner
from ves_gym.planners.robust import Robust, Uncertainty, read_uncertainty
from ves_gym.system.frequency_weight import FAST, FrequencyWeight


def _pose(value: str, place: Place) -> ToolPose:
    """Read the tool pose that `--tool` describes."""
    x, y, z, *angles = read(_lengths_and_angles, _TOOL)(value, place)
    factor = 1.0 if place.angles == "radians" else UNITS["deg"]
    return ToolPose(position=(x, y, z), angles=tuple(k * factor for k in angles) or None)


def _lengths_and_angles(value: str) -> list[float]:
    numbers = floats(value)
    if len(numbers) not in (3, 6):
        raise ValueError
    return numbers


_TOOL = (
    "three lengths in m, or these and three angles in degrees, like 0.6,0.2,1.1 or"
    " 0.6,0.2,1.1,0,90,0"
)


def _v_max(value: str, place: Place) -> Any:
    return value if value == "none" else per_joint("deg/s")(value, place)


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
    Flag("--v-max", "A,B,C", _v_max,
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
        Flag("--evaluations", "N", integer(1), "budget of edge costs"),
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
    **how: Any,
) -> Answer:
    """Plan, simulate beside the straight line; negative if the path breaks a limit."""
    lines = []
    method: Planner
    if robust_from is not None:
        file, uncertain = robust_from
        method = _robust(planner or "robust", uncertain)
        lines.append("uncertain: " + "; ".join(uncertain.lines))
        if uncertain.estimate is not None:
            for option in machine:
                raise ParameterError(
                    f"--robust-from {file} says what the machine is: leave out --{option}"
                )
            case = Case(system=uncertain.estimate, seed=case.seed)
    else:
        method = get_planner(planner or "direct")
    budget = {"algorithm": algorithm, "evaluations": evaluations, "seconds": seconds}
    budget = {name: value for name, value in budget.items() if value is not None}
    for option in budget if not isinstance(method, Ompl) else ():
        raise ParameterError(f"--{option} is for planners ompl-..., got {method.name}")
    if budget:
        method = replace(method, **budget)  # type: ignore[type-var]
    plan = vg.plan(
        case=case,
        goal=goal if tool is None else tool,
        planner=method,
        weights=parse_weights("+".join(weights)) if weights else None,
        **how,
    )
    if tool is not None:
        at = ", ".join(f"{k + 0.0:.2f}" for k in np.rad2deg(plan.query.goal))
        lines.append(f"goal: {at} deg")
    report = report_plan(plan)
    text = "\n".join([*lines, str(report)])
    answer = Answer(text=text, plain=report.to_dict(), negative=not plan.feasible)
    if plan.motion is None:
        return answer
    path = (out or Path("out/plan")) / "case.toml"
    replace(plan.case, log=str(path.with_name("run.csv"))).save(path)
    return replace(answer, files=[path], then=[["simulate", "--case", path]])


def _robust(name: str, uncertain: Uncertainty) -> Robust:
    method = get_planner(name)
    if not isinstance(method, Robust):
        raise ParameterError(
            f"--robust-from is for planners robust and robust-worst, got {method.name}"
        )
    return Robust(
        uncertain.ranges, objective=method.objective, name=method.name, around=uncertain.around
    )
