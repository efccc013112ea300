"""Options that say which machine: a case or a system, then single changes of it.

An effect is written KIND:NAME=VALUE,NAME=VALUE.
"""

from __future__ import annotations

import dataclasses
import math
import re
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ves_gym._util.params import ParameterError, require_one_of
from ves_gym._util.suggest import did_you_mean
from ves_gym.cli.flags import Flag, Place, grouped, number, read, say
from ves_gym.hardware.leg_servo import LEG_SERVOS, LegServo, leg_clock
from ves_gym.hardware.platform import PoseServo
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.arm_library import arm_names, get_arm
from ves_gym.mechanics.servo import OWN_SERVO
from ves_gym.mechanics.vehicle import VEHICLES, get_vehicle
from ves_gym.planners.case import Case, load_case
from ves_gym.simulation.gravity_calibration import read_calibration
from ves_gym.simulation.stable_step import with_stable_step
from ves_gym.system.effect import EFFECTS, Effect
from ves_gym.system.emulator_settings import OPERATIONS, EmulatorSettings
from ves_gym.system.system import DRIVES, INTEGRATORS, MODES, System
from ves_gym.system.system_library import SYSTEMS, get_system


def arm_option(text: str, place: Place) -> Arm:
    """Read an arm as the options beside it say, and say what came of it."""
    choice = dict(place.beside)
    for name in ("lock", "rotor"):
        pairs = choice.pop(name, ())
        choice |= {"locked" if name == "lock" else "rotors": dict(pairs)} if pairs else {}
    if len(tips := choice.pop("tip", ())):
        choice["tip"] = tips[0] if len(tips) == 1 else tuple(tips)
    for flag, parameter in (("no_collision", "collision"), ("no_check", "check")):
        choice |= {parameter: False} if choice.pop(flag, False) else {}
    arm = get_arm(text, **choice, **({"degrees": True} if "locked" in choice else {}))
    if choice or Path(text.partition("#")[0]).suffix.lower() in (".urdf", ".xml", ".mjcf"):
        say(arm.source, "note")  # of what the file does not say, too
    return arm


def _pair(text: str) -> tuple[str, float]:
    name, _, value = text.rpartition("=")
    if not name or not math.isfinite(number := float(value)):
        raise ValueError
    return name, number


def arm_flags(default: str) -> tuple[Flag, ...]:
    """Option --arm, by name or file, and how a file is read; its default in words."""
    help = f"{', '.join(arm_names())}, or a URDF, MJCF or TOML file; FILE#LINK names the tool"
    file = (
        Flag("--tip", "LINK", help="link, body or site that is the tool; repeatable, an arm to"
             " each on one base, the last one's tool the tool", many=True),
        Flag("--root", "LINK", help="link or body that stands on the platform"),
        Flag("--lock", "JOINT=ANGLE", read(_pair, "JOINT=ANGLE, like elbow=90"),
             "a joint that stands still [deg, m]; repeatable", many=True),
        Flag("--massless", "LINK", help="a link with a shape and no mass of its own weighs"
             " nothing; repeatable", many=True),
        Flag("--rotor", "JOINT=INERTIA", read(_pair, "JOINT=INERTIA, like wrist=0.01"),
             "inertia of a rotor about its joint [kg m^2]; repeatable", many=True),
        Flag("--repair", help="replace impossible inertias and ranges by the nearest possible,"
             " and list them"),
        Flag("--no-collision", help="leave the file's shapes out"),
        Flag("--no-check", help="take numbers that look like g, mm, kg mm^2 or degrees"),
        Flag("--allow-outside", help="read meshes outside the file's folder and package"),
    )  # fmt: skip
    beside = (
        replace(flag, of="--arm") for flag in grouped("arm from a URDF or MJCF file", *file)
    )
    return (Flag("--arm", "A", arm_option, f"{help} (default {default})"), *beside)


_NEXT = re.compile(r",\s*(?=[A-Za-z_]\w*\s*=)")  # the comma before another NAME=


def parse_effect(text: str) -> Effect:
    """Return the effect that `kind:name=value,name=value` describes.

    A value is a number or several with commas between them, 3,0,0; square brackets are for
    matrices and may be written around the latter as well, [[1, 0], [0, 1]].
    """
    kind, _, assignments = text.partition(":")
    require_one_of("--effect", kind, sorted(EFFECTS))
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


EFFECT = Flag(
    "--effect",
    "E",
    read(parse_effect),
    "a deviation from the description, like joint/coulomb:torque=3,0,0 (a number per joint) or"
    " gravity/scale:error=0.01; several parameters as A=1,B=2,3; repeatable (`ves-gym list"
    " effects`)",
    many=True,
)


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


MACHINE = (
    *grouped(
        "system",
        Flag("--case", "FILE", read(load_case), "a case that another command wrote: its system"
             " and what else the command uses"),
        Flag("--system", "S", read(get_system),
             f"{', '.join(SYSTEMS)}, or a System in TOML or JSON"),
        *arm_flags("puma560"),
        Flag("--vehicle", "V", read(get_vehicle),
             f"{', '.join(VEHICLES)}, or a file (default bent)"),
        Flag("--mode", "M", help=f"{', '.join(MODES)} (default ideal)"),
        Flag("--drive", "D", help=f"{', '.join(DRIVES)} (default motor)"),
        Flag("--integrator", "I", help=", ".join(INTEGRATORS)),
        Flag("--physics-dt", "S", number("s"), "physics step [s]"),
        Flag("--control-dt", "S", number("s"), "control period [s]"),
        EFFECT,
        Flag("--degrees", help="joint angles are in degrees, however small (no question)"),
        Flag("--radians", help="joint angles are given in radians"),
    ),
    *grouped(
        "laboratory (mode emulated)",
        Flag("--operation", "O", help=", ".join(OPERATIONS)),
        Flag("--platform", "P", read(_platform),
             f"bandwidth of a pose-space servo [Hz], or legs: {', '.join(LEG_SERVOS)}"),
        Flag("--no-compensation", help="the thesis's plain admittance loop"),
        Flag("--zero", help="zero the sensor from the estimate at the start"),
        Flag("--calibration", "FILE", read(read_calibration),
             "gravity and matrix from `ves-gym calibrate`"),
    ),
)  # fmt: skip
_FIELDS = ("arm", "vehicle", "mode", "drive", "integrator", "physics_dt", "control_dt")
_LABORATORY = ("operation", "platform", "no_compensation", "zero", "calibration")


def case_from(options: Mapping[str, Any], mode: str, seed: int | None) -> Case:
    """Return the case that options of `MACHINE` describe: a file's or the default, single
    changes of it.

    Where nothing says it, the mode is this one, and the seed, if None, the case's. A note says
    where a case's motion is then played on another machine.
    """
    case = options.get("case", Case())
    if "case" in options and "system" in options:
        raise ParameterError("--case and --system both say what the machine is: leave one")
    system = _changed(options.get("system", case.system), options, mode)
    if {"arm", "vehicle"} & set(options) and not {"physics_dt", "platform"} & set(options):
        original, system = system, with_stable_step(system)
        if system != original:
            step = f"physics step {1e3 * system.physics_dt:.4g} ms"
            say(f"{step}: what {original.arm.name} on its base needs", "note")
    if case.query is not None or case.motion is not None:
        if system == case.system:
            return case if seed is None else replace(case, seed=seed)
        say(f"the case is of {case.system!r}, this machine is {system!r}", "note")
    servo = case.servo if "case" in options and system.arm == case.system.arm else OWN_SERVO
    query = case.query
    if query is not None:
        query = replace(query, system=system, servo=servo)
    seed = case.seed if seed is None else seed
    return replace(case, system=system, query=query, servo=servo, seed=seed)


def _changed(system: System, options: Mapping[str, Any], mode: str) -> System:
    """The system with single changes."""
    changes = {key: options[key] for key in _FIELDS if key in options}
    if "case" not in options and "system" not in options:
        changes.setdefault("mode", mode)  # a file says its own
    if changes.get("mode") == "ideal" and system.mode != "ideal":
        system = system.ideal()
    effects = {}
    if "effect" in options:
        effects["effects"] = system.effects + options["effect"]
    named = [key for key in _LABORATORY if key in options]
    if not named:
        return system.replace(**changes, **effects) if changes or effects else system
    system = system.replace(**changes) if changes else system
    if system.mode != "emulated":
        raise ParameterError(f"--{named[0].replace('_', '-')} needs --mode emulated")
    lab = _laboratory(system.emulator_settings, options)
    changes = {"emulator": lab, **effects}
    if "platform" in options and isinstance(lab.platform, LegServo):
        steps = zip(("control_dt", "physics_dt"), leg_clock(lab.platform), strict=True)
        changes |= {key: options.get(key, step) for key, step in steps}
    return system.replace(**changes)


def _laboratory(lab: EmulatorSettings, options: Mapping[str, Any]) -> EmulatorSettings:
    """The emulator with the laboratory's own options applied."""
    changes: dict[str, Any] = {k: options[k] for k in ("operation", "platform") if k in options}
    if "no_compensation" in options:
        changes["payload_compensation"] = False
    if "zero" in options:
        changes["zero_at_start"] = True
    if calibration := options.get("calibration"):
        changes["gravity"] = calibration.model
        changes["sensor"] = lab.sensor.calibrated(calibration.C, calibration.offset)
    return dataclasses.replace(lab, **changes)
