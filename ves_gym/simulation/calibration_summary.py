"""A calibration beside what was described, and how well it predicts a second log."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ves_gym._util.params import Array, ParameterError, to_plain
from ves_gym._util.tables import table
from ves_gym.mechanics.arm import Arm
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
_TOLD = ("arm", "names", "C", "offset", "poses", "iterations", "rms", "max", "rms_before",
         "max_before", "condition")  # fmt: skip


@dataclass(frozen=True, eq=False)
class CalibrationSummary:
    """Gravity parameters and sensor matrix from a log; `calibrated` makes it."""

    arm: Arm
    calibration: Calibration
    digest: str  # of the log
    check: Errors | None = None  # of a second log, predicted

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        plain, check = to_plain(self.calibration), self.check
        return {
            "schema": SCHEMA,
            "digest": self.digest,
            "M_total": self.calibration.model.mass,
            "P": list(self.calibration.model.P),
            **{key: plain[key] for key in _TOLD},
            "check": check and {k: v.tolist() for k, v in check._asdict().items()},
        }

    def __str__(self) -> str:
        c, arm = self.calibration, self.arm
        nominal, model = GravityModel.of(arm), minimal_model(arm)
        rows = [("M_total", nominal.mass, c.model.mass, "kg", "total mass")]
        for j, meaning in enumerate(model.descriptions):
            rows.append((f"P{j + 1}", nominal.P[j], c.model.P[j], "kg m", meaning))
        parameters = table(
            ("parameter", "nominal", "estimated", "unit", "meaning"),
            [(name, f"{a:.4f}", f"{b:.4f}", *rest) for name, a, b, *rest in rows],
            title=f"gravity model of {arm.name} from {c.poses} poses",
            left=(0, 3, 4),
        )
        columns = {"rms before": c.rms_before, "max before": c.max_before}
        columns |= {"rms": c.rms, "max": c.max}
        if self.check is not None:
            columns |= {f"check {k}": tuple(v) for k, v in self.check._asdict().items()}
        errors = table(
            ("axis", *columns, "unit"),
            [
                (axis, *(f"{k[i]:.3g}" for k in columns.values()), "N" if i < 3 else "N m")
                for i, axis in enumerate(AXES)
            ],
            title=f"estimated - measured; matrix estimated {c.iterations} times",
            left=(0, len(columns) + 1),
        )
        gap = np.abs(np.array(c.C) - np.eye(6)).max()
        last = f"largest entry of C - 1: {gap:.3g}; condition {max(c.condition):.3g}"
        return f"{parameters}\n{errors}\n{last}"


def calibrated(
    log: RunLog,
    arm: Arm | None,
    *,
    iterations: int | None,
    matrix: bool,
    zero: bool,
    check: RunLog | None,
    rezero: bool,
) -> CalibrationSummary:
    """Do what `ves_gym.calibrate` says."""
    if arm is None:
        if "system" not in log.meta:
            raise ParameterError("the log does not say its system: give --arm FILE")
        arm = System.from_dict(log.meta["system"], "log metadata: system").arm
    fitted = fit(
        arm,
        log.q,
        log.y,
        _readings(log),
        iterations=iterations,
        estimate_matrix=matrix,
        estimate_offset=zero,
    )
    errors = None
    if check is not None:
        errors = predict_errors(fitted, arm, check.q, check.y, _readings(check), rezero=rezero)
    return CalibrationSummary(arm, fitted, log.digest, errors)


def _readings(log: RunLog) -> Array:
    if log.w is None:
        raise ParameterError("the log has no force sensor readings, columns w_1 to w_6")
    return log.w
