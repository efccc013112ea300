"""What several commands share: systems, joint angles, progress, output."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ves_gym.core.params import ParameterError, Vector, write_text
from ves_gym.core.system import DRIVES, INTEGRATORS, MODES, System
from ves_gym.core.vehicle import VEHICLES, get_vehicle


def add_system_arguments(parser: argparse.ArgumentParser, *, vehicle: bool = True) -> None:
    """--system, --vehicle, --mode, --drive, --integrator, --physics-dt, --control-dt."""
    group = parser.add_argument_group("system")
    group.add_argument("--system", metavar="FILE", help="a System in TOML or JSON")
    if vehicle:
        group.add_argument(
            "--vehicle", metavar="V", help=f"{', '.join(VEHICLES)}, or a file (default bent)"
        )
    group.add_argument("--mode", metavar="M", help=f"{', '.join(MODES)} (default ideal)")
    group.add_argument("--drive", metavar="D", help=f"{', '.join(DRIVES)} (default motor)")
    group.add_argument("--integrator", metavar="I", help=", ".join(INTEGRATORS))
    group.add_argument("--physics-dt", type=float, metavar="S", help="physics step [s]")
    group.add_argument("--control-dt", type=float, metavar="S", help="control period [s]")


def system_from(args: argparse.Namespace) -> System:
    """The system the arguments describe: a file or the default, then single changes."""
    system = System.load(args.system) if args.system else System()
    changes: dict[str, Any] = {
        key: getattr(args, key)
        for key in ("mode", "drive", "integrator", "physics_dt", "control_dt")
        if getattr(args, key) is not None
    }
    if getattr(args, "vehicle", None) is not None:
        changes["vehicle"] = get_vehicle(args.vehicle)
    return system.replace(**changes) if changes else system


def degrees(text: str, n: int, name: str) -> Vector:
    """Comma-separated joint angles in degrees -> radians."""
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        raise ParameterError(
            f"{name} must be {n} angles in degrees, like 0,-45,90, got {text!r}"
        ) from None
    if len(values) != n:
        raise ParameterError(
            f"{name} must be {n} angles in degrees, got {len(values)}: {text!r}"
        )
    return tuple(np.deg2rad(values).tolist())


def write_json(path: str | None, result: dict[str, Any]) -> None:
    """Write a command's machine-readable result, completely or not at all."""
    if path is not None:
        write_text(path, json.dumps(result, indent=1, allow_nan=False) + "\n")


def out_dir(args: argparse.Namespace, default: str) -> Path:
    """The folder for a command's files, created."""
    path = Path(args.out or default)
    path.mkdir(parents=True, exist_ok=True)
    return path


class Tell(Protocol):
    """Reports a stage and the fraction of it that is done."""

    def __call__(self, stage: str, done: float) -> None: ...


@contextmanager
def progress() -> Iterator[Tell]:
    """A progress bar per stage on a terminal; silent in a pipe."""
    if not sys.stderr.isatty():
        yield lambda stage, done: None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bars:
        tasks: dict[str, Any] = {}

        def tell(stage: str, done: float) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=1.0)
            bars.update(tasks[stage], completed=done)

        yield tell
