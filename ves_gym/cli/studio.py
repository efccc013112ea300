"""`ves-gym studio`: one HTML page in which a path is drawn and the base's energy follows."""

from __future__ import annotations

import argparse
from pathlib import Path

from ves_gym._util.params import Array, ParameterError
from ves_gym.cli.common import add_system_arguments, system_from, write_json
from ves_gym.cli.motions import duration_from, joint_angles
from ves_gym.mechanics.vehicle import VEHICLES
from ves_gym.planners.registry import PLANNERS
from ves_gym.report.notebook import Studio


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
    arm, unit, via = system.arm, args.angle_unit, args.via

    def angles(name: str, text: str | None) -> Array | None:
        return None if text is None else joint_angles(text, arm, name, unit)

    studio = Studio(
        system,
        start=angles("--start", args.start),
        goal=angles("--goal", args.goal),
        via=None if via is None else [joint_angles(k, arm, "--via", unit) for k in via],
        duration=duration_from(args.duration),
        planner=None if args.planner == "none" else args.planner,
        show=args.open,
        seed=args.seed,
    )
    path = Path(args.out or "out/studio")
    if path.suffix != ".html":
        path = path / "studio.html"
    path.parent.mkdir(parents=True, exist_ok=True)
    studio.save(path)
    write_json(args.json, studio.data)
    size = len(studio.page.encode()) / 1e6
    print(f"written: {path} ({size:.2f} MB; open it in any browser)")
    return 0
