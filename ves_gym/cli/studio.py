"""`ves-gym studio`: one HTML page in which a path is drawn and the base's energy follows."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from ves_gym._util.params import ParameterError, write_text
from ves_gym.cli.common import add_system_arguments, system_from, write_json
from ves_gym.cli.motions import default_goal, duration_from, joint_angles
from ves_gym.mechanics.vehicle import VEHICLES
from ves_gym.planners.query import Query, solve
from ves_gym.planners.registry import PLANNERS, get_planner
from ves_gym.report.studio import playable, quiet_via, render_studio, studio_data
from ves_gym.report.studio_files import open_file

_GOAL = (60.0, 40.0, -30.0)  # deg, of three joints
_LONGEST = 8.0  # s, of the page's slider
_SHORTEST = 0.5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "machine",
        nargs="?",
        metavar="SYSTEM",
        help=f"a vehicle ({', '.join(VEHICLES)}), or what --system takes (default bent)",
    )
    parser.add_argument("--start", metavar="A,B,C", help="joint angles [deg] (default 0,0,0)")
    parser.add_argument("--goal", metavar="A,B,C", help="joint angles [deg] (60,40,-30)")
    parser.add_argument(
        "--via",
        metavar="A,B,C",
        action="append",
        help="way-point of the drawn path [deg], repeatable (default: one calm detour)",
    )
    parser.add_argument("--duration", type=float, metavar="S", help="of the motion [s] (2)")
    parser.add_argument(
        "--planner",
        default="direct",
        metavar="P",
        help=f"whose path is there to compare with: {', '.join(PLANNERS)}, or none (direct)",
    )
    parser.add_argument(
        "--open",
        metavar="FILE",
        action="append",
        default=[],
        help="show it in the page, repeatable: a run log or episode (.parquet, .csv), a motion,"
        " a plan, diagnosis.json",
    )
    add_system_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Write the page; --out is its folder, or its name if that ends in .html."""
    if args.machine in VEHICLES and args.vehicle is None:
        args.vehicle = args.machine
    elif args.machine is not None:
        if args.system is not None:
            raise ParameterError(
                f"SYSTEM {args.machine!r} and --system say the same: leave one"
            )
        args.system = args.machine
    system = system_from(args)
    space = playable(system)
    arm = system.arm
    start = joint_angles(args.start, arm, "--start", args.angle_unit)
    duration = duration_from(args.duration)
    if not _SHORTEST <= duration <= _LONGEST:
        raise ParameterError(
            f"--duration must be from {_SHORTEST:g} to {_LONGEST:g} s, got {duration:g} s"
        )
    if args.goal is None and arm.n != len(_GOAL):
        goal = default_goal(arm, start, duration)
    else:
        goal = joint_angles(args.goal, arm, "--goal", args.angle_unit, _GOAL)
    query = Query(
        system=system,
        start=tuple(start.tolist()),
        goal=tuple(goal.tolist()),
        duration=duration,
    )
    opened = [open_file(path, system) for path in args.open]
    if args.via is None:
        via = quiet_via(query)
    else:
        via = [joint_angles(text, arm, "--via", args.angle_unit) for text in args.via]
    plans = []
    if args.planner != "none":
        asked = replace(query, system=space)
        plans = [solve(get_planner(args.planner), asked, args.seed)]
    data = studio_data(query, via, opened, plans)
    path = Path(args.out or "out/studio")
    if path.suffix != ".html":
        path = path / "studio.html"
    path.parent.mkdir(parents=True, exist_ok=True)
    page = render_studio(data)
    write_text(path, page)
    write_json(args.json, data)
    print(f"written: {path} ({len(page.encode()) / 1e6:.2f} MB; open it in any browser)")
    return 0
