"""`ves-gym teleop`: drive the arm from the keyboard while its base reacts."""

from __future__ import annotations

import argparse
import math
import sys
from contextlib import suppress
from pathlib import Path

from ves_gym._util.params import ParameterError
from ves_gym.cli.common import (
    add_system_arguments,
    log_files,
    log_path,
    system_from,
    write_json,
)
from ves_gym.cli.motions import joint_angles
from ves_gym.envs.teleop import Press, Teleop, load_script, read_script
from ves_gym.system.runlog_files import load_pyarrow

SCHEMA = "ves-teleop/1"
_AFTER = 2.0  # s that a script goes on after its last key
_EVERY = 1.0  # s between the readings that are printed
_STRIP = 10.0  # s of the energy strip
_LINES = 4  # of readings, a safety stop included


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "--keys",
        metavar="FILE",
        help="no window: keys from FILE (- is stdin), lines TIME KEY [SECONDS held]",
    )
    parser.add_argument(
        "--duration", type=float, metavar="S", help="of --keys (2 s after the last key)"
    )
    parser.add_argument("--start", metavar="A,B,C", help="joint angles [deg] (default 0,0,0)")
    parser.add_argument("--log", metavar="NAME", help="record a run log, .csv or .parquet")
    add_system_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Drive; write the log."""
    path = _log_path(args)
    system = system_from(args)
    teleop = Teleop(
        system,
        start=joint_angles(args.start, system.arm, "--start", args.angle_unit),
        seed=args.seed,
        record=path is not None,
    )
    if args.keys is None:
        if args.duration is not None:
            raise ParameterError("--duration is that of a script: give --keys FILE")
        _window(teleop)
    else:
        _script(teleop, args)
    scene, sim = teleop.batch.scene, teleop.batch.sim
    result = {
        "schema": SCHEMA,
        "system": system.hash,
        "mode": system.mode,
        "seconds": float(scene.time[0]),
        "E_peak": float(teleop.batch.episodes.peaks[0, 0]),
        "events": [{"time": e.time, "reason": e.reason} for e in sim.events],
        "diverged": teleop.diverged,
        "log": None,
    }
    for event in sim.events:
        print(f"ves-gym: {event}", file=sys.stderr)
    if path is not None:
        log = teleop.log()
        log.save(path)
        result |= {"log": str(path), "digest": log.digest}
        files = "  ".join(map(str, log_files(path)))
        print(f"written: {files}   (watch it: ves-gym view {path})")
    write_json(args.json, result)
    if teleop.diverged:
        print(f"ves-gym: {sim.describe_divergence(0)}", file=sys.stderr)
    return int(teleop.diverged)


def _log_path(args: argparse.Namespace) -> Path | None:
    """Return the path of the log; faults are found before anyone drives."""
    if args.log is None:
        return None
    path = log_path(args)
    if path.suffix == ".parquet":
        load_pyarrow(path)
    return path


def _window(teleop: Teleop) -> None:
    from ves_gym.envs.rendering import Renderer
    from ves_gym.rendering.opengl import RenderError

    try:
        renderer = Renderer(
            teleop.task, "human", rolling=_STRIP, lines=_LINES, title="ves-gym teleop"
        )
    except RenderError as error:
        raise RenderError(f"{error}; or script the keys: --keys FILE") from None
    _print_keys(teleop)
    try:
        with suppress(KeyboardInterrupt):  # a way to quit, too
            teleop.drive(renderer)
    finally:
        renderer.close()


def _print_keys(teleop: Teleop) -> None:
    print("keys (in the window; hold those of a joint):")
    for key, what in teleop.keys().items():
        print(f"  {key:7} {what}")


def _script(teleop: Teleop, args: argparse.Namespace) -> None:
    keys = teleop.keys()
    if args.keys == "-":
        script = read_script(sys.stdin, keys, "stdin")
    else:
        script = load_script(args.keys, keys)
    seconds = _duration(args.duration, script)
    reported = 0.0

    def on_progress(time: float) -> None:
        nonlocal reported
        if time >= reported + _EVERY - 1e-9:
            reported = time
            print(f"{time:6.2f} s  " + "  ".join(teleop.readings()))

    teleop.play(script, seconds, on_progress)


def _duration(seconds: float | None, script: list[Press]) -> float:
    if seconds is None:
        return max((k.time + k.hold for k in script), default=0.0) + _AFTER
    if not (seconds > 0 and math.isfinite(seconds)):
        raise ParameterError(f"--duration must be > 0 s, got {seconds}")
    return seconds
