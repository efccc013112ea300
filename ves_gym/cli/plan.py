"""`ves-gym plan`: one path by one planner, predicted and simulated."""

from __future__ import annotations

import argparse
import json
import sys
from typing import Any

import numpy as np

from ves_gym.cli.common import add_system_arguments, degrees, out_dir, system_from, write_json
from ves_gym.cli.motions import duration_from, joint_angles, motion_table
from ves_gym.core.energy import TAIL, Energies, energies
from ves_gym.core.params import write_text
from ves_gym.planners.query import Plan, Query, solve
from ves_gym.planners.registry import PLANNERS, get_planner

SCHEMA = "ves-plan/1"
_SAMPLES = 101  # of the path in the result
_RECORD = 12.5e-3  # s between records of the check


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("--start", metavar="A,B,C", help="joint angles [deg] (default 0,0,0)")
    parser.add_argument("--goal", metavar="A,B,C", required=True, help="joint angles [deg]")
    parser.add_argument("--duration", type=float, metavar="S", help="of the motion [s] (2)")
    parser.add_argument(
        "--planner", default="direct", metavar="P", help=f"{', '.join(PLANNERS)} (direct)"
    )
    parser.add_argument("--v-max", metavar="A,B,C", help="joint speed limits [deg/s] (none)")
    add_system_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Plan, simulate beside the straight line; exit 1 if the path breaks a limit."""
    planner = get_planner(args.planner)
    system = system_from(args)
    arm = system.arm
    query = Query(
        system=system,
        start=tuple(joint_angles(args.start, arm, "--start").tolist()),
        goal=tuple(joint_angles(args.goal, arm, "--goal").tolist()),
        duration=duration_from(args.duration),
        v_max=None if args.v_max is None else degrees(args.v_max, arm.n, "--v-max"),
    )
    plan = solve(planner, query, args.seed)
    simulated, straight = _simulated(plan)
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
        "plan_seconds": plan.seconds,
        "feasible": plan.feasible,
        "info": plan.info,
    }
    file = out_dir(args, "out/plan") / "motion.json"
    write_text(file, json.dumps(motion_table(plan.motion), indent=1, allow_nan=False) + "\n")
    write_json(args.json, result)
    _print_table(plan, simulated, straight)
    print(f"written: {file}   (play it: ves-gym simulate --motion {file})")
    return 0 if plan.feasible else 1


def _simulated(plan: Plan) -> tuple[Energies, Energies]:
    """Energies of the plan and of the straight line, on the full nonlinear system."""
    from ves_gym.core.playback import play_motions

    query = plan.query
    dt = query.system.physics_dt
    record = max(1, round(_RECORD / dt)) * dt
    run = play_motions(
        query.system,
        [plan.motion, query.straight],
        servo=query.servo,
        settle=TAIL,
        record_dt=record,
    )
    first, second = energies(query.system, run.t, run.q, run.y, run.yd, duration=query.duration)
    return first, second


def _print_table(plan: Plan, simulated: Energies, straight: Energies) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(
        title=f"{plan.planner}: {plan.query.duration:g} s on {plan.query.system.vehicle.source}"
    )
    for name in ("measure", "predicted", "simulated", "straight line", "ratio"):
        table.add_column(name, justify="left" if name == "measure" else "right")
    predicted: dict[str, Any] = plan.predicted.to_dict()
    for name in predicted:
        here, there = getattr(simulated, name), getattr(straight, name)
        ratio = f"{here / there:.3f}" if there > 0 else "-"
        table.add_row(
            f"{name} [J]", f"{predicted[name]:.4g}", f"{here:.4g}", f"{there:.4g}", ratio
        )
    Console(width=None if sys.stdout.isatty() else 120, markup=False).print(table)
    verdict = "inside the limits" if plan.feasible else "NOT feasible: it breaks a limit"
    print(f"planned in {plan.seconds:.2f} s; {verdict}")
