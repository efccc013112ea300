"""What several commands share: systems, joint angles, progress, output."""

from __future__ import annotations

import argparse
import json
import sys
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ves_gym._util.params import ParameterError, Vector, from_plain, write_text
from ves_gym._util.suggest import did_you_mean
from ves_gym.hardware.leg_servo import LEG_SERVOS, LegServo, leg_clock
from ves_gym.hardware.platform import PoseServo
from ves_gym.mechanics.vehicle import VEHICLES, get_vehicle
from ves_gym.simulation.gravity_calibration import read_calibration
from ves_gym.system.effect import Effect
from ves_gym.system.emulator_settings import OPERATIONS, EmulatorSettings
from ves_gym.system.system import DRIVES, INTEGRATORS, MODES, System


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
    group.add_argument(
        "--effect",
        metavar="E",
        action="append",
        help="an error, like gravity/scale:error=0.01; repeatable (`ves-gym list effects`)",
    )
    lab = parser.add_argument_group("laboratory (mode emulated)")
    lab.add_argument("--operation", metavar="O", help=f"{', '.join(OPERATIONS)}")
    lab.add_argument(
        "--platform",
        metavar="P",
        help=f"bandwidth of a pose-space servo [Hz], or legs: {', '.join(LEG_SERVOS)}",
    )
    lab.add_argument(
        "--no-compensation", action="store_true", help="the thesis's plain admittance loop"
    )
    lab.add_argument(
        "--zero", action="store_true", help="zero the sensor from the estimate at the start"
    )
    lab.add_argument(
        "--calibration", metavar="FILE", help="gravity and matrix from `ves-gym calibrate`"
    )


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
    if changes.get("mode") == "ideal" and system.mode != "ideal":
        system = system.ideal()
    system = system.replace(**changes) if changes else system
    return _laboratory_from(args, system)


def _laboratory_from(args: argparse.Namespace, system: System) -> System:
    """The system with the laboratory's own arguments applied."""
    options = ("operation", "platform", "no_compensation", "zero", "calibration", "effect")
    given = [k for k in options if getattr(args, k)]
    if not given:
        return system
    effects = system.effects + tuple(_effect(text) for text in args.effect or ())
    if given == ["effect"]:
        return system.replace(effects=effects)
    if system.mode != "emulated":
        raise ParameterError(f"--{given[0].replace('_', '-')} needs --mode emulated")
    lab, clock = system.laboratory, {}
    if args.operation:
        lab = replace(lab, operation=args.operation)
    if args.platform:
        lab = replace(lab, platform=_platform(args.platform))
        if isinstance(lab.platform, LegServo):
            control_dt, physics_dt = leg_clock(lab.platform)
            clock = {
                "control_dt": args.control_dt or control_dt,
                "physics_dt": args.physics_dt or physics_dt,
            }
    if args.no_compensation:
        lab = replace(lab, payload_compensation=False)
    if args.zero:
        lab = replace(lab, zero_at_start=True)
    if args.calibration:
        lab = _calibrated(lab, args.calibration)
    return system.replace(emulator=lab, effects=effects, **clock)


def _platform(text: str) -> PoseServo | LegServo:
    if text in LEG_SERVOS:
        return LEG_SERVOS[text]
    try:
        return PoseServo(bandwidth=float(text))
    except ValueError:
        raise ParameterError(
            f"--platform must be a bandwidth > 0 in Hz or one of {', '.join(LEG_SERVOS)},"
            f" got {text!r}{did_you_mean(text, LEG_SERVOS)}"
        ) from None


def _calibrated(lab: EmulatorSettings, path: str) -> EmulatorSettings:
    found = read_calibration(path)
    return replace(
        lab,
        gravity=found.model,
        sensor=lab.sensor.calibrated(found.C, found.offset),
    )


def _effect(text: str) -> Effect:
    """`kind:name=value,name=value`, values as in TOML: 0.01 or [1, 0, 0]."""
    kind, _, values = text.partition(":")
    try:
        plain = tomllib.loads(f"_ = {{{values}}}")["_"]
    except tomllib.TOMLDecodeError:
        raise ParameterError(
            f"--effect must be like gravity/scale:error=0.01, got {text!r}"
        ) from None
    effect: Effect = from_plain(Effect, {"kind": kind, **plain}, "--effect")
    return effect


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
