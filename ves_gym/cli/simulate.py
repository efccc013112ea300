"""`ves-gym simulate`: one motion on one system, recorded as a run log."""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np

from ves_gym._util.optional import lacking
from ves_gym._util.params import Array, ParameterError
from ves_gym.cli.common import (
    Tell,
    add_format,
    add_system_arguments,
    log_files,
    log_path,
    progress,
    system_from,
    write_json,
)
from ves_gym.cli.motions import (
    GAINS,
    disturbance,
    motion_from,
    servo_from,
)
from ves_gym.mechanics.limits import check_reference, limits_of
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.servo import JointServo
from ves_gym.mechanics.vehicle import vehicle_name
from ves_gym.simulation.gravity_learning import learn_gravity
from ves_gym.simulation.playback import play_motions, weigh_poses
from ves_gym.simulation.recording import Recording
from ves_gym.system.energy import TAIL, Energies
from ves_gym.system.energy_balance import EnergyBalance
from ves_gym.system.runlog import RunLog
from ves_gym.system.system import System

SCHEMA = "ves-simulate/1"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    motion = parser.add_argument_group(
        "motion (default: in 2 s to 60,40,-30 deg; of other than three joints, within half of"
        " the arm's limits)"
    )
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
        help=f"{', '.join(GAINS)}, or kp/kd like 3000,2000,1000/50,40,30 (default own: the"
        " arm's)",
    )
    parser.add_argument(
        "--no-feedforward", action="store_true", help="no feed-forward joint torque"
    )
    parser.add_argument(
        "--record-dt",
        type=float,
        metavar="S",
        help="between records (default physics step; mode emulated: control period)",
    )
    for what, help_text in (
        ("grasp", "close the latch on the system's payload at this time; repeatable"),
        ("release", "open it"),
    ):
        parser.add_argument(
            f"--{what}", type=float, metavar="S", action="append", help=help_text
        )
    parser.add_argument(
        "--log",
        metavar="FILE",
        help="the run log, .csv or .parquet, from --out if given (out/simulate/run.csv)",
    )
    add_format(parser)
    add_system_arguments(parser)
    lab = parser.add_argument_group("experiments (mode emulated)")
    lab.add_argument(
        "--platform-motion",
        metavar="FILE",
        help="what the platform follows under --operation position: a motion of 6 columns",
    )
    lab.add_argument(
        "--learn", type=int, metavar="N", help="learn the weight in N slow repetitions"
    )
    lab.add_argument(
        "--poses", type=int, metavar="N", help="weigh the arm in N poses, for `calibrate`"
    )


def run(args: argparse.Namespace) -> int:
    """Play the motion; write log, system and picture; print the energies."""
    path, description = _places(args)
    system = system_from(args)
    _check_experiment(args, system)
    if args.poses is not None:
        return _weigh(args, system, path)
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
    limits = limits_of(system.arm, motor=system.drive == "motor")
    reference = check_reference(system.arm, motion, limits)
    with progress() as on_progress:
        recording = _play(args, system, motion, servo, on_progress)
        space = _in_space(system, motion, servo, args, recording)
    log = recording.log(0)
    stop = recording.events[0] if recording.events else None
    measured = None if stop else _energies(recording, args.settle)
    ideal = None if space is None else _energies(space, args.settle)
    residual = None
    if system.mode == "ideal":
        account = EnergyBalance.of(log)
        residual = account.relative if math.isfinite(account.relative) else None

    simulated = recording.limit_check(0)
    warnings = reference.sentences("reference") + simulated.sentences("simulated arm")
    for warning in warnings:
        print(f"ves-gym: warning: {warning}", file=sys.stderr)
    log.save(path)
    system.save(description)
    written = [*log_files(path), description]
    written += _picture(args, log, system, motion.duration, space, path)
    result = {
        "schema": SCHEMA,
        "log": str(path),
        "digest": log.digest,
        "system": system.hash,
        "mode": system.mode,
        "duration": motion.duration,
        "tail": min(TAIL, args.settle),
        "energies": None if measured is None else measured.to_dict(),
        "ledger_residual": residual,
        "propellant": None if log.propellant is None else float(log.propellant[-1, 0]),
        "limits": {"reference": reference.to_dict(), "simulated": simulated.to_dict()},
        "warnings": warnings,
        "files": [str(p) for p in written + ([Path(args.json)] if args.json else [])],
    }
    if system.mode == "emulated":
        result["energies_in_space"] = None if ideal is None else ideal.to_dict()
        result["base_error"] = None if space is None else _base_error(recording, space)
        result["stopped"] = None if stop is None else {"time": stop.time, "reason": stop.reason}
    if recording.captures:
        result["captures"] = log.meta["captures"]
        for event in recording.captures:
            lost = f", {event.lost:.4g} J lost" if event.kind == "grasp" else ""
            print(f"{event.kind} at {event.time:g} s{lost}")
    write_json(args.json, result)
    if measured is not None:
        _print_table(system, motion, measured, ideal, residual, log)
    print(f"{reference.brief('reference')}; {simulated.brief('simulated arm')}")
    if space is not None:
        error = _base_error(recording, space)
        print(f"base position off by {100 * error:.1f} % of its largest displacement in space")
    print("written: " + "  ".join(result["files"]))
    if stop is not None:
        print(f"ves-gym: {stop}; the log ends there", file=sys.stderr)
    return 0 if stop is None else 1


def _check_experiment(args: argparse.Namespace, system: System) -> None:
    for option in ("platform_motion", "learn", "poses"):
        if getattr(args, option) is not None and system.mode != "emulated":
            raise ParameterError(f"--{option.replace('_', '-')} needs --mode emulated")
    for option in ("learn", "poses"):
        value = getattr(args, option)
        if value is not None and value < 1:
            raise ParameterError(f"--{option} must be >= 1, got {value}")
    if args.learn is not None and args.poses is not None:
        raise ParameterError("--learn and --poses are two experiments: give one of them")
    for option in ("disturb", "record_dt", "grasp", "release"):
        if args.learn is not None and getattr(args, option) is not None:
            raise ParameterError(
                f"--learn starts every repetition at home and records every control period:"
                f" leave out --{option.replace('_', '-')}"
            )
    if args.platform_motion and args.disturb is not None:
        raise ParameterError(
            "--platform-motion says where the platform starts: leave out --disturb"
        )
    if args.platform_motion and system.emulator_settings.operation != "position":
        raise ParameterError(
            "--platform-motion needs --operation position, got"
            f" {system.emulator_settings.operation}"
        )


def _play(
    args: argparse.Namespace,
    system: System,
    motion: Motion,
    servo: JointServo,
    on_progress: Tell,
) -> Recording:
    pose = disturbance(args.disturb)
    if args.learn is not None:
        learnt = learn_gravity(
            system,
            motion,
            iterations=args.learn,
            settle=args.settle,
            servo=servo,
            seed=args.seed,
            progress=lambda done: on_progress("learning", done),
        )
        for i, k in enumerate(learnt.iterations):
            move, turn = 1e3 * k.change[:3].max(), 1e3 * k.change[3:].max()
            print(f"repetition {i + 1}: base motion changed by {move:.3f} mm, {turn:.3f} mrad")
        if learnt.recording is None:
            raise ParameterError(f"the first repetition was aborted: {learnt.aborted}")
        if learnt.aborted is not None:
            print(f"ves-gym: aborted: {learnt.aborted}; the last whole run is kept")
        return learnt.recording
    default = system.physics_dt if system.mode == "ideal" else system.control_dt
    options: dict[str, Any] = {}
    if args.platform_motion:
        follow = Motion.load(args.platform_motion)
        if follow.n != 6:
            raise ParameterError(
                f"{args.platform_motion}: a platform has 6 coordinates, got {follow.n}"
            )

        def platform(t: Array) -> tuple[Array, Array]:
            sample = follow.at(t)
            return sample.q, sample.v

        options["platform"], pose = platform, follow.start
    return play_motions(
        system,
        [motion],
        servo=servo,
        settle=args.settle,
        record_dt=args.record_dt or default,
        latch=_latch(args),
        watch=True,
        y=pose,
        seed=args.seed,
        progress=lambda done: on_progress("simulating", done),
        **options,
    )


def _latch(args: argparse.Namespace) -> list[tuple[float, str]]:
    """Commands of the latch, and their instants."""
    parts = (("grasp", args.grasp), ("release", args.release))
    return [(time, what) for what, times in parts for time in times or ()]


def _in_space(
    system: System,
    motion: Motion,
    servo: JointServo,
    args: argparse.Namespace,
    recording: Recording,
) -> Recording | None:
    """The same run in space, beside an emulation of it."""
    if system.mode == "ideal" or system.emulator_settings.operation == "position":
        return None
    return play_motions(
        system.ideal(),
        [motion],
        servo=servo,
        settle=args.settle,
        record_dt=float(recording.t[1] - recording.t[0]),
        y=recording.y[0, 0],
        latch=_latch(args),
    )


def _energies(recording: Recording, settle: float) -> Energies:
    # a recording interval that does not divide the run ends it up to a record later
    return recording.energies(tail=min(TAIL, settle))[0]


def _base_error(recording: Recording, space: Recording) -> float:
    """Largest distance of the base from where it is in space, over its largest there."""
    n = recording.records(0)
    gap = np.linalg.norm((recording.y[0, :n] - space.y[0, :n])[:, :3], axis=1).max()
    size = np.linalg.norm(space.y[0, :, :3], axis=1).max()
    return float(gap / size) if size > 0 else 0.0


def _weigh(args: argparse.Namespace, system: System, path: Path) -> int:
    """Record static poses for the Model Method."""
    from ves_gym.simulation.gravity_calibration import calibration_poses

    q, y = calibration_poses(system.arm, args.poses, seed=args.seed)
    log = weigh_poses(system, q, y, seed=args.seed)
    log.save(path)
    files = [str(p) for p in log_files(path)]
    write_json(
        args.json,
        {
            "schema": SCHEMA,
            "log": str(path),
            "digest": log.digest,
            "poses": args.poses,
            "files": files,
        },
    )
    print(f"weighed {args.poses} poses; written: {'  '.join(files)}")
    print(f"next: ves-gym calibrate {path}")
    return 0


def _places(args: argparse.Namespace) -> tuple[Path, Path]:
    """Return where run log and system go.

    Without --log and --out both are in out/simulate. A log that --log puts elsewhere has the
    system beside it under its own name, so that no system.toml there is written over.
    """
    if args.log is None:
        folder = Path(args.out or "out/simulate")
        args.log = str("run.csv" if args.out else folder / "run.csv")
        return log_path(args), folder / "system.toml"
    path = log_path(args)
    own = path.with_name(f"{path.stem}.system.toml")
    return path, Path(args.out, "system.toml") if args.out else own


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
    ideal: Energies | None,
    residual: float | None,
    log: RunLog,
) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(
        title=f"{system.arm.name} on {vehicle_name(system.vehicle)}, {motion.duration:g} s"
    )
    table.add_column("measure")
    table.add_column("value" if ideal is None else "laboratory", justify="right")
    if ideal is not None:
        table.add_column("in space", justify="right")
    table.add_column("unit")
    table.add_column("meaning")
    space = {} if ideal is None else ideal.to_dict()
    tail = min(TAIL, float(log.t[-1] - log.t[0]) - motion.duration)
    for name, value in measured.to_dict().items():
        symbol = {"E_int": "J s", "t_5": "s"}.get(name, "J")
        cells = [_text(value)] + ([_text(space[name])] if space else [])
        table.add_row(name, *cells, symbol, _MEANING[name].format(tail=round(tail, 6)))
    if system.mode == "ideal":
        table.add_section()
        cells = ["-" if residual is None else f"{residual:.1e}"]
        every = 1e3 * float(log.t[1] - log.t[0])
        what = f"relative residual of the energy account, records every {every:g} ms"
        table.add_row("ledger", *cells, "1", what)
    if log.propellant is not None:
        used = _text(float(log.propellant[-1, 0]))
        table.add_row("propellant", used, "kg", "that the satellite's jets have used")
    Console(width=None if sys.stdout.isatty() else 120, markup=False).print(table)


def _text(value: float | None) -> str:
    return "-" if value is None else f"{value:.5g}"


def _picture(
    args: argparse.Namespace,
    log: RunLog,
    system: System,
    duration: float,
    space: Recording | None,
    path: Path,
) -> list[Path]:
    if sentence := lacking("drawing", "matplotlib"):
        print(f"no picture: {sentence}")
        return []
    from ves_gym.report.figures import write_figure
    from ves_gym.report.run import run_figure

    picture = path.with_suffix(f".{args.format}")
    write_figure(run_figure(log, system, duration, space), picture)
    return [picture]
