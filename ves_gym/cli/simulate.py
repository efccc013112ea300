"""`ves-gym simulate`: one motion on one system, recorded as a run log."""

from __future__ import annotations

import argparse
import dataclasses
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np

from ves_gym.cli.common import (
    add_system_arguments,
    degrees,
    out_dir,
    progress,
    system_from,
    write_json,
)
from ves_gym.core.arm import Arm
from ves_gym.core.energy import TAIL, Energies, base_energy, energies, ledger
from ves_gym.core.motion import LimitError, Motion, require_limits
from ves_gym.core.params import (
    Array,
    ParameterError,
    from_plain,
    read_table,
    to_plain,
    write_bytes,
)
from ves_gym.core.runlog import RunLog
from ves_gym.core.servo import FREE, HIGH_GAINS, PPED_GAINS, JointServo
from ves_gym.core.system import System

SCHEMA = "ves-simulate/1"
MOTION_FORMAT = "ves-motion/1"
GAINS = {"high": HIGH_GAINS, "pped": PPED_GAINS, "free": FREE}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    motion = parser.add_argument_group("motion (default: 60,40,-30 deg in 2 s)")
    motion.add_argument("--start", metavar="A,B,C", help="joint angles [deg] (default 0,0,0)")
    motion.add_argument("--goal", metavar="A,B,C", help="joint angles [deg]")
    motion.add_argument("--via", metavar="A,B,C", action="append", help="way-point; repeatable")
    motion.add_argument("--duration", type=float, metavar="S", help="of the motion [s]")
    motion.add_argument(
        "--motion", metavar="FILE", help="a motion, as `ves-gym plan` writes it"
    )
    parser.add_argument(
        "--settle", type=float, default=TAIL, metavar="S", help="joints held after it (10)"
    )
    parser.add_argument(
        "--disturb", metavar="X,Y,Z,A,B,C", help="base pose at the start [m, deg]"
    )
    parser.add_argument(
        "--gains",
        metavar="G",
        help=f"{', '.join(GAINS)}, or kp/kd like 3000,2000,1000/50,40,30 (default high)",
    )
    parser.add_argument(
        "--no-feedforward", action="store_true", help="no feed-forward joint torque"
    )
    parser.add_argument(
        "--record-dt", type=float, metavar="S", help="between records (default physics step)"
    )
    parser.add_argument(
        "--log", default="run.csv", metavar="NAME", help=".csv or .parquet (run.csv)"
    )
    add_system_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Play the motion; write log, system and picture; print the energies."""
    from ves_gym.core.playback import play_motions

    name = _log_name(args)
    system = system_from(args)
    motion = motion_from(args, system.arm)
    servo = servo_from(args, system)
    for option, value, least in (
        ("--settle", args.settle, 0.0),
        ("--record-dt", args.record_dt, None),
    ):
        if value is not None and not (math.isfinite(value) and (value > 0 or value == least)):
            raise ParameterError(
                f"{option} must be {'>= 0' if least == 0 else '> 0'} s, got {value}"
            )
    pose = _disturbance(args.disturb)
    warnings = limit_warnings(system.arm, motion)
    with progress() as tell:
        recording = play_motions(
            system,
            [motion],
            servo=servo,
            settle=args.settle,
            record_dt=args.record_dt or system.physics_dt,
            y=pose,
            progress=lambda done: tell("simulating", done),
        )
    log = recording.log(0)
    # a recording interval that does not divide the run ends it up to one record later
    tail = min(TAIL, args.settle)
    measured = energies(
        system,
        log.t,
        recording.q,
        recording.y,
        recording.yd,
        duration=motion.duration,
        tail=tail,
    )[0]
    account = ledger(log)
    residual = account.relative if math.isfinite(account.relative) else None

    for warning in warnings:
        print(f"ves-gym: warning: {warning}", file=sys.stderr)
    folder = out_dir(args, "out/simulate")
    path = folder / name
    log.save(path)
    system.save(folder / "system.toml")
    written = [path, folder / "system.toml"]
    picture = _picture(log, system, motion.duration, path.with_suffix(".png"))
    written += [picture] if picture else []
    result = {
        "schema": SCHEMA,
        "log": str(path),
        "digest": log.digest,
        "system": system.hash,
        "duration": motion.duration,
        "tail": tail,
        "energies": measured.to_dict(),
        "ledger_residual": residual,
        "warnings": warnings,
        "files": [str(p) for p in written],
    }
    write_json(args.json, result)
    _print_table(
        system, motion, measured, residual, tail, recording_dt=float(log.t[1] - log.t[0])
    )
    print("written: " + "  ".join(str(p) for p in written))
    return 0


def _log_name(args: argparse.Namespace) -> str:
    name = str(args.log)
    if Path(name).suffix not in (".csv", ".parquet") or Path(name).name != name:
        raise ParameterError(
            f"--log must be a file name ending in .csv or .parquet, got {name!r}"
        )
    beside = (Path(args.out or "out/simulate") / name).with_suffix(".json")
    if args.json is not None and name.endswith(".csv") and _same(beside, Path(args.json)):
        raise ParameterError(
            f"--json {args.json} is where the log's metadata goes; give another name"
        )
    return name


def _same(a: Path, b: Path) -> bool:
    return a.resolve() == b.resolve()


# ---------------------------------------------------------------- motion, servo, limits


def motion_from(args: argparse.Namespace, arm: Arm) -> Motion:
    """The motion the arguments describe, inside the joint limits."""
    if args.motion is not None:
        for option in ("start", "goal", "via", "duration"):
            if getattr(args, option) is not None:
                raise ParameterError(f"--motion FILE already says it: leave out --{option}")
        motion = read_motion(args.motion)
        if motion.n != arm.n:
            raise ParameterError(
                f"{args.motion}: {arm.name} has {arm.n} joints, got {motion.n}"
            )
    else:
        motion = _motion_through(args, arm)
    require_limits(arm, motion, ("position",))
    return motion


def _motion_through(args: argparse.Namespace, arm: Arm) -> Motion:
    start = joint_angles(args.start, arm, "--start")
    if args.goal is None and args.via:
        raise ParameterError("--via needs --goal: way-points lie between start and goal")
    goal = joint_angles(args.goal, arm, "--goal", default=(60.0, 40.0, -30.0))
    duration = duration_from(args.duration)
    vias = [joint_angles(via, arm, "--via") for via in args.via or ()]
    if not vias:
        return Motion.straight(start, goal, duration)
    return Motion.through(np.stack([start, *vias, goal]), duration)


def joint_angles(
    text: str | None, arm: Arm, name: str, default: tuple[float, ...] | None = None
) -> Array:
    """Joint angles [rad] from degrees, inside the limits; zeros if neither is given."""
    if text is None:
        given = np.deg2rad(default) if default and len(default) == arm.n else np.zeros(arm.n)
    else:
        given = np.array(degrees(text, arm.n, name))
    return arm.require_within_limits(given, name)


def duration_from(value: float | None, default: float = 2.0) -> float:
    """A duration [s] > 0."""
    if value is not None and not (math.isfinite(value) and value > 0):
        raise ParameterError(f"--duration must be > 0 s, got {value}")
    return default if value is None else value


def read_motion(path: str) -> Motion:
    """A motion from JSON or TOML: {"format", "duration" [s], "control" [rad]}."""
    table = read_table(path)
    if table.get("format") != MOTION_FORMAT:
        raise ParameterError(
            f"{path}: format must be {MOTION_FORMAT!r}, got {table.get('format')!r}"
        )
    plain = {k: v for k, v in table.items() if k != "format"}
    rows = plain.get("control")
    if isinstance(rows, list):
        widths = {len(row) if isinstance(row, list) else 0 for row in rows}
        if len(widths) != 1 or 0 in widths:
            raise ParameterError(f"{path}: control must be rows of equal length, one per point")
    try:
        motion: Motion = from_plain(Motion, plain, "motion")
    except ParameterError as error:
        raise ParameterError(f"{path}: {error}") from None
    return motion


def motion_table(motion: Motion) -> dict[str, Any]:
    """A motion as plain data, as `read_motion` reads it."""
    return {"format": MOTION_FORMAT, **to_plain(motion)}


def servo_from(args: argparse.Namespace, system: System) -> JointServo:
    """The joint servo the arguments describe."""
    if system.drive != "motor" and (args.gains is not None or args.no_feedforward):
        raise ParameterError(
            "a prescribed drive has no servo: leave out --gains, --no-feedforward"
        )
    text = args.gains or "high"
    servo = GAINS.get(text) or _numbers(text, system.arm.n)
    if args.no_feedforward:
        servo = dataclasses.replace(servo, feedforward=False)
    if system.drive == "motor" and len(servo.kp) != system.arm.n:
        raise ParameterError(
            f"gains {text!r} are for {len(servo.kp)} joints,"
            f" {system.arm.name} has {system.arm.n}"
        )
    return servo


def _numbers(text: str, n: int) -> JointServo:
    expected = f"{', '.join(GAINS)}, or kp/kd with 1 or {n} numbers each, like 100/10"
    try:
        kp, kd = ([float(k) for k in part.split(",")] for part in text.split("/"))
    except ValueError:
        raise ParameterError(f"--gains must be {expected}, got {text!r}") from None
    if {len(kp), len(kd)} - {1, n}:
        raise ParameterError(f"--gains must be {expected}, got {text!r}")
    return JointServo(kp=tuple(kp * (n // len(kp))), kd=tuple(kd * (n // len(kd))))


def limit_warnings(arm: Arm, motion: Motion) -> list[str]:
    """One line per kind of limit, other than position, that a motion breaks."""
    out = []
    for kind in ("velocity", "torque"):
        try:
            require_limits(arm, motion, (kind,))
        except LimitError as error:
            out.append(str(error))
    return out


def _disturbance(text: str | None) -> Array:
    if text is None:
        return np.zeros(6)
    try:
        values = np.array([float(k) for k in text.split(",")])
    except ValueError:
        values = np.full(6, np.nan)
    if values.shape != (6,) or not np.isfinite(values).all():
        raise ParameterError(
            f"--disturb must be six numbers x,y,z [m] and angles [deg], got {text!r}"
        )
    values[3:] = np.deg2rad(values[3:])
    return values


# ------------------------------------------------------------------------------ output

_MEANING = {
    "E_mean": "mean of the base energy over the motion and {tail:g} s after it (the score)",
    "E_res": "at the end of the motion",
    "E_peak": "largest",
    "E_strain_peak": "largest strain energy",
    "E_int": "time integral of the strain energy",
    "W_port": "work through the base port",
    "t_5": "until it stays below 5 % of its peak",
}


def _print_table(
    system: System,
    motion: Motion,
    measured: Energies,
    residual: float | None,
    tail: float,
    recording_dt: float,
) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(title=f"{system.arm.name} on {system.vehicle.source}, {motion.duration:g} s")
    table.add_column("measure")
    table.add_column("value", justify="right")
    table.add_column("unit")
    table.add_column("meaning")
    for name, value in measured.to_dict().items():
        symbol = {"E_int": "J s", "t_5": "s"}.get(name, "J")
        shown = "-" if value is None else f"{value:.5g}"
        table.add_row(name, shown, symbol, _MEANING[name].format(tail=tail))
    table.add_section()
    shown = "-" if residual is None else f"{residual:.1e}"
    what = f"relative residual of the energy account, records every {1e3 * recording_dt:g} ms"
    table.add_row("ledger", shown, "1", what)
    Console(width=None if sys.stdout.isatty() else 120, markup=False).print(table)


def _picture(log: RunLog, system: System, duration: float, path: Path) -> Path | None:
    """Base pose, joint tracking and energy against time; None without matplotlib."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        print("no picture: matplotlib is missing (pip install 'ves-gym[report]')")
        return None
    import io

    assert log.yd is not None  # a recording has it
    E = base_energy(system, log.q, log.y, log.yd)
    figure = Figure(figsize=(8, 9), layout="constrained")
    FigureCanvasAgg(figure)
    place, turn, joint, error, energy = figure.subplots(5, 1, sharex=True)
    for k, name in enumerate("xyz"):
        place.plot(log.t, 1e3 * log.y[:, k], label=name, lw=1)
        turn.plot(log.t, np.rad2deg(log.y[:, 3 + k]), label=f"$\\phi_{name}$", lw=1)
    for k in range(log.n_joints):
        (line,) = joint.plot(log.t, np.rad2deg(log.q[:, k]), label=f"$q_{k + 1}$", lw=1)
        joint.plot(log.t, np.rad2deg(log.q_cmd[:, k]), "--", color=line.get_color(), lw=1)
        error.plot(log.t, np.rad2deg(log.q_cmd - log.q)[:, k], label=f"$q_{k + 1}$", lw=1)
    energy.plot(log.t, E.total, label="total", lw=1.2)
    energy.plot(log.t, E.strain, label="strain", lw=0.8)
    labels = ("base [mm]", "base [deg]", "joints [deg]", "joint error [deg]", "base energy [J]")
    for axes, label in zip((place, turn, joint, error, energy), labels, strict=True):
        axes.set_ylabel(label)
        axes.legend(loc="upper right", ncols=3, fontsize="small")
        axes.grid(alpha=0.3)
        axes.axvline(duration, color="0.5", lw=0.8, ls=":")
    energy.set_xlabel("time [s]; dotted: end of the motion, dashed: commanded")
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    write_bytes(path, buffer.getvalue())
    return path
