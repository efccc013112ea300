"""What several commands share: systems, joint angles, progress, output."""

from __future__ import annotations

import argparse
import dataclasses
import json
import re
import sys
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ves_gym._util.optional import require
from ves_gym._util.params import ParameterError, Vector, to_plain, write_text
from ves_gym._util.suggest import did_you_mean
from ves_gym.hardware.leg_servo import LEG_SERVOS, LegServo, leg_clock
from ves_gym.hardware.platform import PoseServo
from ves_gym.mechanics.arm_library import arm_names, get_arm
from ves_gym.mechanics.vehicle import VEHICLES, get_vehicle
from ves_gym.report.figures import FORMATS
from ves_gym.simulation.gravity_calibration import read_calibration
from ves_gym.system.effect import EFFECTS, Effect
from ves_gym.system.emulator_settings import OPERATIONS, EmulatorSettings
from ves_gym.system.frequency_weight import FAST, FrequencyWeight
from ves_gym.system.system import DRIVES, INTEGRATORS, MODES, System
from ves_gym.system.system_library import SYSTEMS, get_system


def add_system_arguments(
    parser: argparse.ArgumentParser, *, vehicle: bool = True, angles: bool = True
) -> None:
    """--system, --arm, --vehicle, --mode, --drive, --integrator, --physics-dt, --control-dt."""
    group = parser.add_argument_group("system")
    group.add_argument(
        "--system", metavar="S", help=f"{', '.join(SYSTEMS)}, or a System in TOML or JSON"
    )
    add_arm_argument(group, "puma560")
    if vehicle:
        group.add_argument(
            "--vehicle", metavar="V", help=f"{', '.join(VEHICLES)}, or a file (default bent)"
        )
    group.add_argument("--mode", metavar="M", help=f"{', '.join(MODES)} (default ideal)")
    group.add_argument("--drive", metavar="D", help=f"{', '.join(DRIVES)} (default motor)")
    group.add_argument("--integrator", metavar="I", help=", ".join(INTEGRATORS))
    group.add_argument("--physics-dt", type=float, metavar="S", help="physics step [s]")
    group.add_argument("--control-dt", type=float, metavar="S", help="control period [s]")
    add_effect_argument(group)
    if angles:
        add_angle_unit(group)
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


def add_arm_argument(parser: argparse._ActionsContainer, default: str) -> None:
    """--arm, by name or file.

    Args:
        parser: or group of arguments.
        default: in words.
    """
    parser.add_argument(
        "--arm",
        metavar="A",
        help=f"{', '.join(arm_names())}, or a URDF, MJCF or TOML file; FILE#LINK names the tool"
        f" (default {default})",
    )


def system_from(args: argparse.Namespace) -> System:
    """The system the arguments describe: a file or the default, then single changes."""
    system = get_system(args.system) if args.system else System()
    changes: dict[str, Any] = {
        key: getattr(args, key)
        for key in ("mode", "drive", "integrator", "physics_dt", "control_dt")
        if getattr(args, key) is not None
    }
    if getattr(args, "vehicle", None) is not None:
        changes["vehicle"] = get_vehicle(args.vehicle)
    if args.arm is not None:
        changes["arm"] = get_arm(args.arm)
    if changes.get("mode") == "ideal" and system.mode != "ideal":
        system = system.ideal()
    system = system.replace(**changes) if changes else system
    return _laboratory_from(args, system)


def _laboratory_from(args: argparse.Namespace, system: System) -> System:
    """The system with the laboratory's own arguments applied."""
    options = ("operation", "platform", "no_compensation", "zero", "calibration", "effect")
    named = [k for k in options if getattr(args, k)]
    if not named:
        return system
    effects = system.effects + tuple(parse_effect(text) for text in args.effect)
    if named == ["effect"]:
        return system.replace(effects=effects)
    if system.mode != "emulated":
        raise ParameterError(f"--{named[0].replace('_', '-')} needs --mode emulated")
    lab, clock = system.emulator_settings, {}
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


def add_frequency_weight(parser: argparse._ActionsContainer) -> None:
    """--frequency-weight HZ:GAIN,..."""
    parser.add_argument(
        "--frequency-weight",
        metavar="HZ:GAIN,...",
        help=f"filter of E_weighted: gains at frequencies, like 0.5:0,2:1 (default {FAST})",
    )


def frequency_weight_from(args: argparse.Namespace) -> FrequencyWeight:
    """The filter of `E_weighted` that is asked for."""
    text = args.frequency_weight
    return FAST if text is None else FrequencyWeight.parse(text)


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
    calibration = read_calibration(path)
    return replace(
        lab,
        gravity=calibration.model,
        sensor=lab.sensor.calibrated(calibration.C, calibration.offset),
    )


def add_effect_argument(parser: argparse._ActionsContainer) -> None:
    """--effect KIND:NAME=VALUE, repeatable."""
    parser.add_argument(
        "--effect",
        metavar="E",
        action="append",
        default=[],
        help="a deviation from the description, like joint/coulomb:torque=3,0,0 (a number per"
        " joint) or gravity/scale:error=0.01; several parameters as A=1,B=2,3; repeatable"
        " (`ves-gym list effects`)",
    )


_NEXT = re.compile(r",\s*(?=[A-Za-z_]\w*\s*=)")  # the comma before another NAME=


def parse_effect(text: str) -> Effect:
    """Return the effect that `kind:name=value,name=value` describes.

    A value is a number or several with commas between them, 3,0,0; square brackets are for
    matrices and may be written around the latter as well, [[1, 0], [0, 1]].

    Raises:
        ParameterError: unknown kind or parameter, or a value that it cannot have.
    """
    kind, _, assignments = text.partition(":")
    if kind not in EFFECTS:
        raise ParameterError(
            f"--effect must be one of {', '.join(sorted(EFFECTS))}, got {kind!r}"
            f"{did_you_mean(kind, EFFECTS)}"
        )
    fields = {f.name: f for f in dataclasses.fields(EFFECTS[kind])}  # type: ignore[arg-type]
    values: dict[str, Any] = {}
    for part in _NEXT.split(assignments) if assignments.strip() else ():
        name, equals, value = (k.strip() for k in part.partition("="))
        if not equals or not value:
            raise ParameterError(
                f"--effect must be like {_example(kind)}, got {text!r}: no value in {part!r}"
            )
        if name not in fields:
            raise ParameterError(
                f"--effect {kind}: unknown parameter {name!r}; known:"
                f" {', '.join(map(_described, fields.values()))}{did_you_mean(name, fields)}"
            )
        if name in values:
            raise ParameterError(f"--effect {kind}: {name} is given more than once")
        values[name] = _numbers(value, fields[name])
    missing = [f for k, f in fields.items() if k not in values and f.default is _MISSING]
    if missing:
        raise ParameterError(
            f"--effect {kind} needs {', '.join(map(_described, missing))}, like"
            f" {_example(kind)}; got {text!r}"
        )
    effect: Effect = EFFECTS[kind](**values)
    return effect


_MISSING = dataclasses.MISSING


def _numbers(text: str, field: dataclasses.Field[Any]) -> Any:
    """Return a parameter's value: a number, a list, or the text itself, to be refused."""
    try:
        if "[" in text:
            return tomllib.loads(f"_ = {text}")["_"]
        values = [float(k) for k in text.split(",")]
    except ValueError:  # of TOML, too
        return text
    return values[0] if len(values) == 1 and not field.metadata["shape"] else values


def _described(field: dataclasses.Field[Any]) -> str:
    """Return name, unit and bounds of an effect's parameter."""
    (low, high), symbol = field.metadata["bounds"], field.metadata["unit"]
    return f"{field.name}{'' if symbol == '1' else f' [{symbol}]'} in [{low:g}, {high:g}]"


def _example(kind: str) -> str:
    """Return how an effect of a kind is written: its first parameter, large enough to see."""
    field = dataclasses.fields(EFFECTS[kind])[0]  # type: ignore[arg-type]
    low, high = field.metadata["bounds"]
    shape = tuple(3 if k is None else k for k in field.metadata["shape"])
    value = f"{high / 10 if high > 0 else low / 10:.1g}"
    if len(shape) < 2:
        return f"{kind}:{field.name}={','.join([value, *['0'] * (sum(shape) - 1)])}"
    return f"{kind}:{field.name}={np.full(shape, float(value)).tolist()}".replace(" ", "")


def with_effects(
    id: str, settings: Mapping[str, Any], texts: Sequence[str], arm: str | None = None
) -> dict[str, Any]:
    """Return an environment's settings with `--arm`, and `--effect` beside the effects it has.

    Args:
        id: registered id of the environment.
        settings: that it is made with.
        texts: values of `--effect`, see `parse_effect`.
        arm: value of `--arm`: name or file; None: the environment's.
    """
    if arm is not None:
        given = get_arm(arm)  # refused here, not in a worker
        if "control" in settings:  # numbers per joint that are the environment's arm's
            from ves_gym.baselines.evaluate import spec_of
            from ves_gym.envs.build import build_task
            from ves_gym.envs.control import for_arm

            control = build_task(**{**spec_of(id).kwargs, **settings}).control
            settings = {**settings, "control": to_plain(for_arm(control, given))}
        settings = {**settings, "arm": arm}
    if not texts:
        return dict(settings)
    added = [to_plain(parse_effect(text)) for text in texts]
    from ves_gym.baselines.evaluate import spec_of
    from ves_gym.envs.build import build_task

    task = build_task(**{**spec_of(id).kwargs, **settings})
    return {**settings, "effects": [*(to_plain(e) for e in task.system.effects), *added]}


def add_angle_unit(parser: argparse._ActionsContainer) -> None:
    """--degrees or --radians, for joint angles."""
    parser.set_defaults(angle_unit=None)
    for unit, text in (
        ("degrees", "joint angles are meant in degrees, however small (ask nothing)"),
        ("radians", "joint angles are given in radians"),
    ):
        parser.add_argument(
            f"--{unit}", dest="angle_unit", action="store_const", const=unit, help=text
        )


def numbers(text: str, n: int, name: str, what: str, like: str) -> list[float]:
    """Return n numbers with commas between them.

    Args:
        text: what was given.
        n: how many it must be.
        name: of the option.
        what: they are, in the plural, for the error.
        like: an example.
    """
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        raise ParameterError(f"{name} must be {n} {what}, like {like}, got {text!r}") from None
    if len(values) != n:
        raise ParameterError(f"{name} must be {n} {what}, got {len(values)}: {text!r}")
    return values


def degrees(text: str, n: int, name: str) -> Vector:
    """Return speeds or accelerations, given in degrees with commas between them, in radians."""
    return tuple(np.deg2rad(numbers(text, n, name, "angles in degrees", "0,-45,90")).tolist())


def add_format(parser: argparse._ActionsContainer) -> None:
    """--format, of the pictures that a command writes."""
    parser.add_argument(
        "--format", choices=FORMATS, default="png", help="of the pictures (default png)"
    )


def write_json(path: str | None, result: dict[str, Any]) -> None:
    """Write a command's machine-readable result, completely or not at all."""
    if path is not None:
        write_text(path, json.dumps(result, indent=1, allow_nan=False) + "\n")


def out_dir(args: argparse.Namespace, default: str) -> Path:
    """The folder for a command's files, created."""
    path = Path(args.out or default)
    path.mkdir(parents=True, exist_ok=True)
    return path


def log_path(args: argparse.Namespace) -> Path:
    """Return where `--log` says that the run log goes: from `--out`, where that is given."""
    path = Path(args.out or "", args.log)
    if path.suffix not in (".csv", ".parquet"):
        raise ParameterError(f"--log must end in .csv or .parquet, got {args.log!r}")
    if path.is_dir():
        raise ParameterError(f"--log must be a file to write, got the folder {args.log!r}")
    if path.suffix == ".parquet":
        require("Parquet", "pyarrow")
    beside = path.with_suffix(".json")
    if args.json is not None and path.suffix == ".csv" and _same(beside, Path(args.json)):
        raise ParameterError(
            f"--json {args.json} is where the log's metadata goes; give another name"
        )
    return path


def log_files(path: Path) -> list[Path]:
    """Return the files that a run log consists of: a CSV file has its metadata beside it."""
    return [path, path.with_suffix(".json")] if path.suffix == ".csv" else [path]


def _same(a: Path, b: Path) -> bool:
    return a.resolve() == b.resolve()


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

        def on_progress(stage: str, done: float) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=1.0)
            bars.update(tasks[stage], completed=done)

        yield on_progress
