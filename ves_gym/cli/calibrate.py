"""`ves-gym calibrate`: what a log of static poses says about arm and force sensor."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import ves_gym.api as vg
from ves_gym._util.params import ParameterError, write_table
from ves_gym.cli.files import log_file
from ves_gym.cli.flags import Answer, Flag, integer, read, word_or
from ves_gym.mechanics.arm import read_arm
from ves_gym.system.runlog import RunLog

FLAGS = (
    Flag("POSES", read=log_file, help="run log of static poses with q, y, w"),
    Flag("--arm", "FILE", read(read_arm), "an Arm (default: that of the log)"),
    Flag("--iterations", "N", word_or("limit", integer(1), "a number >= 1, or limit"),
         "turns, or `limit` of many (default 2)"),
    Flag("--keep-matrix", help="trust the sensor's calibration matrix"),
    Flag("--keep-zero", help="trust the sensor's zero in POSES"),
    Flag("--check", "LOG", log_file, "a second log, to predict"),
    Flag("--rezero", help="the sensor was zeroed anew for --check"),
)  # fmt: skip


def run(
    poses: Path,
    *,
    keep_matrix: bool = False,
    keep_zero: bool = False,
    check: Path | None = None,
    out: Path | None = None,
    **how: Any,
) -> Answer:
    """Fit, check and write the calibration."""
    if check is not None:
        how["check"] = RunLog.load(check)
    elif "rezero" in how:
        raise ParameterError("--rezero is about a second log: give --check LOG")
    matrix, zero = not keep_matrix, not keep_zero
    result = vg.calibrate(RunLog.load(poses), matrix=matrix, zero=zero, **how)
    path = (out or Path("out/calibrate")) / "calibration.toml"
    write_table(path, result.calibration)
    return Answer(text=result, plain={**result.to_dict(), "log": str(poses)}, files=[path])
