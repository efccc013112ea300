"""`ves-gym calibrate`: what a log of static poses says about arm and force sensor."""

from __future__ import annotations

import argparse
import sys

import numpy as np

from ves_gym._util.params import Array, ParameterError, to_plain, write_table
from ves_gym.cli.common import out_dir, write_json
from ves_gym.mechanics.arm import Arm, read_arm
from ves_gym.mechanics.gravity import GravityModel, minimal_model
from ves_gym.simulation.gravity_calibration import (
    AXES,
    Calibration,
    Errors,
    fit,
    predict_errors,
)
from ves_gym.system.runlog import RunLog
from ves_gym.system.system import System

SCHEMA = "ves-calibrate/1"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("poses", metavar="POSES", help="run log of static poses with q, y, w")
    parser.add_argument("--arm", metavar="FILE", help="an Arm (default: that of the log)")
    parser.add_argument(
        "--iterations", default="2", metavar="N", help="turns, or `limit` of many (default 2)"
    )
    parser.add_argument(
        "--keep-matrix", action="store_true", help="trust the sensor's calibration matrix"
    )
    parser.add_argument(
        "--keep-zero", action="store_true", help="trust the sensor's zero in POSES"
    )
    parser.add_argument("--check", metavar="LOG", help="a second log, to predict")
    parser.add_argument(
        "--rezero", action="store_true", help="the sensor was zeroed anew for --check"
    )


def run(args: argparse.Namespace) -> int:
    """Fit, check, print and write the calibration."""
    if args.rezero and args.check is None:
        raise ParameterError("--rezero is about a second log: give --check LOG")
    log = RunLog.load(args.poses)
    arm = read_arm(args.arm) if args.arm else _arm_of(log, args.poses)
    calibration = fit(
        arm,
        log.q,
        log.y,
        _readings(log, args.poses),
        iterations=_iterations(args.iterations),
        estimate_matrix=not args.keep_matrix,
        estimate_offset=not args.keep_zero,
    )
    check = None
    if args.check:
        other = RunLog.load(args.check)
        w = _readings(other, args.check)
        check = predict_errors(calibration, arm, other.q, other.y, w, rezero=args.rezero)

    path = out_dir(args, "out/calibrate") / "calibration.toml"
    write_table(path, calibration)
    plain = to_plain(calibration)
    result = {
        "schema": SCHEMA,
        "log": args.poses,
        "digest": log.digest,
        "M_total": calibration.model.mass,
        "P": list(calibration.model.P),
        **{key: plain[key] for key in ("arm", "names", "C", "offset", "poses", "iterations")},
        **{key: plain[key] for key in ("rms", "max", "rms_before", "max_before", "condition")},
        "check": None if check is None else {k: v.tolist() for k, v in check._asdict().items()},
        "files": [str(path)],
    }
    write_json(args.json, result)
    _print_tables(arm, calibration, check)
    print(f"written: {path}")
    return 0


def _arm_of(log: RunLog, path: str) -> Arm:
    if "system" not in log.meta:
        raise ParameterError(f"{path}: the log does not say its system: give --arm FILE")
    return System.from_dict(log.meta["system"], "log metadata: system").arm


def _readings(log: RunLog, path: str) -> Array:
    if log.w is None:
        raise ParameterError(f"{path}: has no force sensor readings, columns w_1 to w_6")
    return log.w


def _iterations(text: str) -> int | None:
    if text == "limit":
        return None
    if not text.isdecimal() or int(text) < 1:
        raise ParameterError(f"--iterations must be a number >= 1, or limit, got {text!r}")
    return int(text)


def _print_tables(arm: Arm, calibration: Calibration, check: Errors | None) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console(width=None if sys.stdout.isatty() else 120, markup=False)
    nominal, model = GravityModel.of(arm), minimal_model(arm)
    table = Table(title=f"gravity model of {arm.name} from {calibration.poses} poses")
    for name in ("parameter", "nominal", "estimated", "unit", "meaning"):
        numeric = name in ("nominal", "estimated")
        table.add_column(name, justify="right" if numeric else "left")
    rows = [("M_total", nominal.mass, calibration.model.mass, "kg", "total mass")]
    for j, meaning in enumerate(model.descriptions):
        rows.append((f"P{j + 1}", nominal.P[j], calibration.model.P[j], "kg m", meaning))
    for name, before, after, symbol, meaning in rows:
        table.add_row(name, f"{before:.4f}", f"{after:.4f}", symbol, meaning)
    console.print(table)

    columns = {
        "rms before": calibration.rms_before,
        "max before": calibration.max_before,
        "rms": calibration.rms,
        "max": calibration.max,
    }
    if check is not None:
        columns |= {"check rms": tuple(check.rms), "check max": tuple(check.max)}
    table = Table(
        title=f"estimated - measured; matrix estimated {calibration.iterations} times"
    )
    table.add_column("axis")
    for name in columns:
        table.add_column(name, justify="right")
    table.add_column("unit")
    for i, axis in enumerate(AXES):
        values = (f"{column[i]:.3g}" for column in columns.values())
        table.add_row(axis, *values, "N" if i < 3 else "N m")
    console.print(table)
    gap = np.abs(np.array(calibration.C) - np.eye(6)).max()
    print(f"largest entry of C - 1: {gap:.3g}; condition {max(calibration.condition):.3g}")
