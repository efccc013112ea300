"""`ves-gym calibrate`: what a log of static poses says about arm and force sensor."""

from __future__ import annotations

from pathlib import Path

import ves_gym.api as vg
from ves_gym._util.params import ParameterError, write_table
from ves_gym.cli.files import log_file
from ves_gym.cli.flags import Answer, Flag, Place
from ves_gym.cli.machine import read
from ves_gym.mechanics.arm import Arm, read_arm
from ves_gym.system.runlog import RunLog


def _iterations(value: str, place: Place) -> int | None:
    if value != "limit" and (not value.isdecimal() or int(value) < 1):
        raise ParameterError(f"{place.name} must be a number >= 1, or limit, got {value!r}")
    return None if value == "limit" else int(value)


FLAGS = (
    Flag("POSES", read=log_file, help="run log of static poses with q, y, w"),
    Flag("--arm", "FILE", read(read_arm), "an Arm (default: that of the log)"),
    Flag("--iterations", "N", _iterations, "turns, or `limit` of many (default 2)"),
    Flag("--keep-matrix", help="trust the sensor's calibration matrix"),
    Flag("--keep-zero", help="trust the sensor's zero in POSES"),
    Flag("--check", "LOG", log_file, "a second log, to predict"),
    Flag("--rezero", help="the sensor was zeroed anew for --check"),
)


def run(
    poses: Path,
    *,
    arm: Arm | None = None,
    iterations: int | None = 2,
    keep_matrix: bool = False,
    keep_zero: bool = False,
    check: Path | None = None,
    rezero: bool = False,
    out: Path | None = None,
) -> Answer:
    """Fit, check and write the calibration."""
    if rezero and check is None:
        raise ParameterError("--rezero is about a second log: give --check LOG")
    result = vg.calibrate(
        RunLog.load(poses),
        arm,
        iterations=iterations,
        matrix=not keep_matrix,
        zero=not keep_zero,
        check=None if check is None else RunLog.load(check),
        rezero=rezero,
    )
    path = (out or Path("out/calibrate")) / "calibration.toml"
    write_table(path, result.calibration)
    return Answer(text=result, plain={**result.to_dict(), "log": str(poses)}, files=[path])
