"""What an emulating controller took in and gave out, at the instants of its own clock."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from ves_gym._util.params import Array
from ves_gym._util.signals import differentiated
from ves_gym.diagnosis.data.measured_run import Run
from ves_gym.system.system import System

_SAME_CLOCK = 1e-3  # by which a log's step may differ from the control period, relative


@dataclass(frozen=True)
class ControllerSignals:
    """Inputs and outputs of the controller, N control periods, k copies."""

    force: Array  # (k, N, 6) reading less estimate, platform frame [N, N m]
    pose: Array  # (k, N, 6) commanded [m, rad]
    rate: Array  # (k, 6) its rate at the start
    q: Array  # (N, joints) angles; empty where they are not used


def on_its_clock(run: Run, system: System) -> bool:
    """Return True if a log has one row for each control period."""
    return abs(run.dt / system.control_dt - 1) < _SAME_CLOCK


def _on_control_clock(x: Array, run: Run, system: System) -> Array:
    """Signals (..., T, c) of a log at the controller's own instants."""
    if on_its_clock(run, system):
        return x
    smooth = differentiated(x, run.dt, run.band)[0]  # what lies between samples is in the band
    last = int((x.shape[-2] - 1) * run.dt / system.control_dt + 1e-9)
    return _resampled(smooth, run.dt, system.control_dt * np.arange(last + 1, dtype=float))


def on_log_clock(x: Array, run: Run, system: System) -> Array:
    """Return signals of the controller (..., N, c) at the instants of the log (..., T, c)."""
    if on_its_clock(run, system):
        return x
    return _resampled(x, system.control_dt, run.dt * np.arange(run.length, dtype=float))


def _resampled(x: Array, dt: float, instants: Array) -> Array:
    """Return signals of steps dt at other instants; what comes after them holds the last."""
    t = dt * np.arange(x.shape[-2])
    return scipy.interpolate.CubicSpline(t, x, axis=-2)(np.minimum(instants, t[-1]))


def taken_in(run: Run, system: System) -> ControllerSignals:
    """Return the controller's inputs and outputs of a log with w, weight, y_cmd (and q).

    Args:
        run: the log.
        system: as described.
    """
    force = np.reshape(run["w"] - run["weight"], (-1, run.length, 6))
    pose = np.reshape(run["y_cmd"], (-1, run.length, 6))
    if "yd" in run:
        rate = np.reshape(run["yd"], (-1, run.length, 6))[:, 0]
    else:
        rate = differentiated(pose[:, : 4 * run.window.skip], run.dt, run.band)[1][:, 0]
    q = np.empty(0)
    if system.emulator_settings.payload_compensation:
        angles = np.reshape(run["q"], (-1, run.length, system.arm.n))[0]
        q = _on_control_clock(angles, run, system)
    force, pose = (_on_control_clock(x, run, system) for x in (force, pose))
    return ControllerSignals(force, pose, rate, q)


def extended(gap: Array, length: int) -> Array:
    """Return residuals of the first periods (..., n, 6), the last one held up to a length."""
    tail = np.repeat(gap[..., -1:, :], length - gap.shape[-2], axis=-2)
    return np.concatenate([gap, tail], axis=-2)
