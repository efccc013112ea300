"""`ves-gym emulation-check`: is an emulation stable, and how true is it, before it runs."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from ves_gym._util.optional import lacking
from ves_gym._util.params import ParameterError
from ves_gym.cli.common import (
    add_format,
    add_system_arguments,
    out_dir,
    progress,
    system_from,
    write_json,
)
from ves_gym.cli.motions import GAINS, joint_angles
from ves_gym.hardware.platform import PoseServo
from ves_gym.mechanics.vehicle import vehicle_name
from ves_gym.simulation.stability import EmulationCheck, check_emulation
from ves_gym.system.system import System

SCHEMA = "ves-emulation-check/1"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("--at", metavar="A,B,C", help="joint angles [deg] (default 0,0,0)")
    parser.add_argument(
        "--gains", choices=tuple(GAINS), default="own", help="of the joint servo"
    )
    parser.add_argument(
        "--no-search", action="store_true", help="do not look for the largest bandwidth"
    )
    parser.add_argument("--no-figures", action="store_true", help="no pictures")
    add_format(parser)
    add_system_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Judge the emulation; exit status 1 if it is unstable."""
    if args.mode not in (None, "emulated"):
        raise ParameterError(f"emulation-check is about --mode emulated, got {args.mode}")
    if args.system is None:  # a file says its own mode
        args.mode = "emulated"
    system = system_from(args)
    at = joint_angles(args.at, system.arm, "--at", args.angle_unit)
    with progress() as on_progress:
        on_progress("linearising the loop", 0.0)
        check = check_emulation(system, at, servo=GAINS[args.gains], search=not args.no_search)
    _print(system, check, searched=not args.no_search)
    files: list[Path] = []
    if not args.no_figures:
        files = _figures(args, system, at)
    write_json(
        args.json,
        {
            "schema": SCHEMA,
            "at": at.tolist(),
            "system": system.to_dict(),
            "system_hash": system.hash,
            **check.to_dict(),
            "files": [str(f) for f in files],
        },
    )
    for path in files:
        print(f"  {path}")
    return 0 if check.stable else 1


def _print(system: System, check: EmulationCheck, searched: bool) -> None:
    from rich.console import Console
    from rich.table import Table

    lab = system.emulator_settings
    console = Console(width=None if sys.stdout.isatty() else 100, markup=False)
    verdict = "stable" if check.stable else "UNSTABLE"
    console.print(
        f"{verdict}: {system.arm.name} on {vehicle_name(system.vehicle)}, emulated at"
        f" {1 / system.control_dt:.4g} Hz"
    )
    rows = [
        ("spectral radius", f"{check.spectral_radius:.6f}", "of one control period, <= 1"),
        ("growth", f"{check.growth:+.3f} 1/s", "of the least stable mode"),
        ("payload ratio", f"{check.payload_ratio:.3g}", "arm over vehicle, worst direction"),
        (
            "compensation",
            "on" if lab.payload_compensation else "off",
            "of the arm's inertia; off is the thesis's loop",
        ),
        ("lag", f"{1e3 * check.lag:.1f} ms", "from wrench to motion, slow motion"),
    ]
    if searched and isinstance(lab.platform, PoseServo):
        limit = check.max_bandwidth
        text = "none up to 200 Hz" if limit is None else f"{limit:.2f} Hz"
        rows.append(("largest bandwidth", text, f"this one has {lab.platform.bandwidth:g} Hz"))
    elif searched:
        gain = check.max_gain
        text = "none up to 16" if gain is None else f"{gain:.2f}"
        rows.append(("largest gain factor", text, "on K1 and K2 of the legs"))
    table = Table(show_header=False)
    for row in rows:
        table.add_row(*row)
    console.print(table)
    modes = Table(title="modes of arm and base: in space, and as the laboratory shows them")
    for name in ("f [Hz]", "emulated", "damping [%]", "emulated", "added [%]"):
        modes.add_column(name, justify="right")
    for mode in check.modes:
        modes.add_row(
            f"{mode.frequency:.3f}",
            f"{mode.emulated_frequency:.3f}",
            f"{100 * mode.damping:.2f}",
            f"{100 * mode.emulated_damping:.2f}",
            f"{100 * (mode.emulated_damping - mode.damping):+.2f}",
        )
    console.print(modes)


def _figures(args: argparse.Namespace, system: System, at: Any) -> list[Path]:
    """Poles of the complete loop, and the leg loop's plots for leg servos."""
    from ves_gym.hardware.leg_servo import LEG_SERVOS, LegServo

    if sentence := lacking("drawing", "matplotlib"):
        print(f"no pictures: {sentence}")
        return []
    from ves_gym.report.legs import write_leg_figures
    from ves_gym.report.loop import write_loop_figures

    folder = out_dir(args, "out/emulation-check")
    files = write_loop_figures(folder, system, at, GAINS[args.gains], args.format)
    platform = system.emulator_settings.platform
    if isinstance(platform, LegServo):
        servos = dict(LEG_SERVOS)
        if platform not in servos.values():
            servos["this one"] = platform
        files += write_leg_figures(folder, servos, args.format)
    return files
