"""`ves-gym plan`: one path by one planner, predicted and simulated."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ves_gym._util.params import ParameterError, Vector
from ves_gym.cli.common import (
    add_frequency_weight,
    add_system_arguments,
    degrees,
    frequency_weight_from,
    out_dir,
    system_from,
    write_json,
)
from ves_gym.cli.motions import duration_from, joint_angles
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.tool_pose import ToolPose
from ves_gym.mechanics.vehicle import vehicle_name
from ves_gym.planners.comparison import simulate_motions
from ves_gym.planners.objective import WEIGHTS, parse_weights
from ves_gym.planners.obstacles import read_surroundings
from ves_gym.planners.ompl_search import Ompl
from ves_gym.planners.ompl_worker import ALGORITHMS
from ves_gym.planners.predicted_disturbance import predict_disturbance
from ves_gym.planners.prediction import Prediction
from ves_gym.planners.query import Plan, Planner, Query, solve, speed_limits
from ves_gym.planners.registry import PLANNERS, get_planner, weighted
from ves_gym.planners.robust import Robust
from ves_gym.planners.tool_goal import solve_to_tool
from ves_gym.planners.uncertainty import read_uncertainty
from ves_gym.system.disturbance import UNITS, Disturbance
from ves_gym.system.energy import TAIL, Energies
from ves_gym.system.system import System

SCHEMA = "ves-plan/1"
_SAMPLES = 101  # of the path in the result


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("--start", metavar="A,B,C", help="joint angles [deg] (default 0,0,0)")
    goal = parser.add_mutually_exclusive_group(required=True)
    goal.add_argument("--goal", metavar="A,B,C", help="joint angles [deg]")
    goal.add_argument(
        "--tool",
        metavar="X,Y,Z[,A,B,C]",
        help="in place of --goal: position of the tool in the platform-top frame [m] and, if"
        " its turn matters, Z-Y-X fixed angles about x, y, z [deg]; the configuration that"
        " leaves the base least energy is chosen",
    )
    parser.add_argument("--duration", type=float, metavar="S", help="of the motion [s] (2)")
    parser.add_argument(
        "--planner",
        metavar="P",
        help=f"{', '.join(PLANNERS)} (direct; robust with --robust-from)",
    )
    parser.add_argument(
        "--v-max",
        metavar="A,B,C",
        help="joint speed limits [deg/s], or none (default: those of the arm)",
    )
    parser.add_argument(
        "--a-max", metavar="A,B,C", help="joint acceleration limits [deg/s^2] (none)"
    )
    parser.add_argument(
        "--obstacles",
        metavar="FILE",
        help="surroundings in TOML or JSON: clearance [m], obstacles (spheres, boxes); the"
        " arm's own links, platform and beam then count too",
    )
    parser.add_argument(
        "--weight",
        metavar="NAME=W",
        action="append",
        default=[],
        help="minimise a disturbance measure as well (direct, refined; repeatable), W times the"
        f" straight line's energy at the straight line's value: {', '.join(WEIGHTS)}",
    )
    add_frequency_weight(parser)
    parser.add_argument(
        "--robust-from",
        metavar="FILE",
        help="what is uncertain, for planners robust and robust-worst: diagnosis.json of"
        " `ves-gym diagnose` (the machine is then the diagnosed one), or ranges in TOML:"
        " [effect] parameter = [low, high]",
    )
    search = parser.add_argument_group("search (planners ompl-...)")
    search.add_argument("--algorithm", metavar="A", help=f"{', '.join(ALGORITHMS)} (bitstar)")
    search.add_argument("--evaluations", type=int, metavar="N", help="budget of edge costs")
    search.add_argument("--seconds", type=float, metavar="S", help="budget of time [s]")
    add_system_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Plan, simulate beside the straight line; exit 1 if the path breaks a limit."""
    planner, system = _robust_from(args) or (_planner_from(args), system_from(args))
    arm = system.arm
    pose = None if args.tool is None else _pose(args.tool, args.angle_unit)
    start = _angles(args, arm, "start")
    query = Query(
        system=system,
        start=start,
        goal=start if pose else _angles(args, arm, "goal"),
        duration=duration_from(args.duration),
        v_max=_v_max(args.v_max, arm),
        a_max=None if args.a_max is None else degrees(args.a_max, arm.n, "--a-max"),
        surroundings=None if args.obstacles is None else read_surroundings(args.obstacles),
        weight=frequency_weight_from(args),
    )
    if pose is None:
        plan = solve(planner, query, args.seed)
    else:
        plan = solve_to_tool(planner, query, pose, args.seed)
        query = plan.query
        print(f"goal: {_in_degrees(query.goal)} deg")
    if plan.motion is None or plan.predicted is None:
        return _without_motion(args, plan)
    reference = plan.reference
    assert reference is not None
    run = simulate_motions(query, [plan.motion])
    simulated, straight = run.energies()
    played = run.limit_check(0, v_max=query.v_max)
    predicted = predict_disturbance(query, plan.motion)
    moved = [run.disturbance(i, weight=query.weight) for i in range(2)]
    names = ("predicted", "simulated", "straight")
    disturbances = dict(zip(names, (predicted, *moved), strict=True))
    times = np.linspace(0, query.duration, _SAMPLES)
    result = {
        "schema": SCHEMA,
        "planner": plan.planner,
        "system": system.hash,
        "seed": args.seed,
        "duration": query.duration,
        "t": times.tolist(),
        "path": plan.motion.at(times).q.tolist(),
        "control": [list(row) for row in plan.motion.control],
        "predicted": plan.predicted.to_dict(),
        "simulated": simulated.to_dict(),
        "straight": straight.to_dict(),
        "disturbance": {name: one.to_dict() for name, one in disturbances.items()},
        "frequency_weight": str(query.weight),
        "plan_seconds": plan.seconds,
        "feasible": plan.feasible,
        "failure": plan.failure,
        "limits": {"reference": reference.to_dict(), "simulated": played.to_dict()},
        "info": plan.info,
    }
    file = out_dir(args, "out/plan") / "motion.json"
    plan.motion.save(file)
    write_json(args.json, result)
    _print_table(plan, plan.predicted, simulated, straight, disturbances)
    print(reference.verdict("reference"))
    print(played.verdict("simulated arm"))
    print(f"written: {file}   (play it: ves-gym simulate --motion {file})")
    return 0 if plan.feasible else 1


def _planner_from(args: argparse.Namespace) -> Planner:
    """The planner by name, a search with the budget that is asked for."""
    planner = get_planner(args.planner or "direct")
    if args.weight:
        planner = weighted(planner, parse_weights("+".join(args.weight)))
    names = ("algorithm", "evaluations", "seconds")
    options = {k: getattr(args, k) for k in names if getattr(args, k) is not None}
    if not options:
        return planner
    if not isinstance(planner, Ompl):
        raise ParameterError(
            f"--{next(iter(options))} is for planners ompl-..., got {planner.name}"
        )
    return replace(planner, **options)


def _robust_from(args: argparse.Namespace) -> tuple[Planner, System] | None:
    """The robust planner for what a file says is uncertain, and the machine."""
    if args.robust_from is None:
        return None
    named = get_planner(args.planner or "robust")
    if not isinstance(named, Robust):
        raise ParameterError(
            f"--robust-from is for planners robust and robust-worst, got {named.name}"
        )
    uncertain = read_uncertainty(args.robust_from)
    if uncertain.estimate is None:
        system = system_from(args)
    else:
        given = [k for k in ("system", "vehicle", "arm", "mode", "effect") if getattr(args, k)]
        if given:
            raise ParameterError(
                f"--robust-from {args.robust_from} says what the machine is: leave out"
                f" --{given[0]}"
            )
        system = uncertain.estimate
    print("uncertain: " + "; ".join(uncertain.lines))
    planner = Robust(
        uncertain.ranges,
        objective=named.objective,
        name=named.name,
        around=uncertain.around,
    )
    return planner, system


def _without_motion(args: argparse.Namespace, plan: Plan) -> int:
    """Say why there is no motion."""
    result = {
        "schema": SCHEMA,
        "planner": plan.planner,
        "system": plan.query.system.hash,
        "seed": args.seed,
        "duration": plan.query.duration,
        "plan_seconds": plan.seconds,
        "feasible": False,
        "failure": plan.failure,
        "info": plan.info,
    }
    write_json(args.json, result)
    print(f"{plan.planner}: {plan.failure} ({plan.seconds:.2f} s)")
    return 1


def _angles(args: argparse.Namespace, arm: Arm, name: str) -> Vector:
    """Return --start or --goal [rad]."""
    angles = joint_angles(getattr(args, name), arm, f"--{name}", args.angle_unit)
    return tuple(angles.tolist())


def _pose(text: str, unit: str | None) -> ToolPose:
    """Return the tool pose that `--tool` describes."""
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) not in (3, 6):
        raise ParameterError(
            "--tool must be three lengths in m, or these and three angles in degrees, like"
            f" 0.6,0.2,1.1 or 0.6,0.2,1.1,0,90,0, got {text!r}"
        )
    turn = values[3:] if unit == "radians" else np.deg2rad(values[3:]).tolist()
    return ToolPose(position=tuple(values[:3]), angles=tuple(turn) or None)


def _in_degrees(angles: Vector) -> str:
    return ", ".join(f"{k + 0.0:.2f}" for k in np.rad2deg(angles))


def _v_max(text: str | None, arm: Arm) -> Vector | None:
    """Return the speed limits [rad/s] that are asked for, None for none."""
    value = text if text in (None, "none") else degrees(str(text), arm.n, "--v-max")
    return speed_limits(arm, value)


def _print_table(
    plan: Plan,
    prediction: Prediction,
    simulated: Energies,
    straight: Energies,
    disturbances: Mapping[str, Disturbance],
) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(
        title=f"{plan.planner}: {plan.query.duration:g} s on"
        f" {vehicle_name(plan.query.system.vehicle)}"
    )
    for name in ("measure", "predicted", "simulated", "straight line", "ratio"):
        table.add_column(name, justify="left" if name == "measure" else "right")
    rows: list[tuple[str, list[float]]] = []
    for name, value in prediction.to_dict().items():
        rows.append((f"{name} [J]", [value, getattr(simulated, name), getattr(straight, name)]))
    for name, unit in UNITS.items():
        values = [getattr(one, name) for one in disturbances.values()]
        rows.append((f"{name} [{unit}]", values))
    for name, (predicted, planned, reference) in rows:
        ratio = f"{planned / reference:.3f}" if reference > 0 else "-"
        cells = (f"{value:.4g}" for value in (predicted, planned, reference))
        table.add_row(name, *cells, ratio)
    Console(width=None if sys.stdout.isatty() else 120, markup=False).print(table)
    verdict = "feasible" if plan.feasible else f"NOT feasible: {plan.failure}"
    print(
        f"E_weighted: gain {plan.query.weight}; means over the motion and {TAIL:g} s after it"
    )
    print(f"planned in {plan.seconds:.2f} s; {verdict}")
