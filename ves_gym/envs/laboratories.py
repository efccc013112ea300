"""Named laboratories of emulated tasks: which errors they have, and which are drawn anew.

docs/laboratory.md says where each number comes from. A laboratory is made for a system: the
calibration's errors are those of its arm.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym._util.suggest import did_you_mean
from ves_gym.envs.randomize import Range, ranges_of
from ves_gym.hardware.platform import PoseServo
from ves_gym.system.effect import Effect
from ves_gym.system.system import System

POSES = 47  # of the calibration, as the thesis took (3.4.6)
TILT = 5e-4  # rad, standard deviation: legs of 0.25 mm on joints 0.5 m apart (derived here)


class Laboratory(NamedTuple):
    """Errors of a laboratory: those it always has, and those drawn for every episode."""

    effects: tuple[Effect, ...]
    ranges: tuple[Range, ...]


def laboratory(name: str, system: System) -> Laboratory:
    """Return a laboratory's errors for an emulated system.

    Args:
        name: one of LABORATORIES.
        system: whose arm and machine it has.

    Raises:
        ParameterError: an unknown name, or a system that has no laboratory.
    """
    if name not in LABORATORIES:
        raise ParameterError(
            f"laboratory must be one of {', '.join(LABORATORIES)}, got {name!r}"
            f"{did_you_mean(name, LABORATORIES)}"
        )
    if system.mode != "emulated" or system.emulator_settings.operation != "microgravity":
        got = system.mode if system.mode != "emulated" else system.emulator_settings.operation
        raise ParameterError(
            f"laboratory {name!r} needs mode emulated, operation microgravity, got {got}"
        )
    from ves_gym.effects.sensor import LABORATORY_ERRORS  # the laboratory's modules

    return Laboratory(LABORATORY_ERRORS, ranges_of(LABORATORIES[name](system)))


Spec = dict[str, dict[str, Any]]


def _nominal(system: System) -> Spec:
    """Noise and drift of the nominal budget, and nothing drawn."""
    return {}


def _lab(system: System) -> Spec:
    """Errors left by a calibration: gravity model, matrix, tilt, zero, age of estimates."""
    return {**_calibration(system, 1.0), **_tilt_and_zero(1.0), **_late(1.0, system)}


def _hard(system: System) -> Spec:
    """Three times the noise in the calibration, and a platform that is not as stated.

    By 10 %, and by 5 % under a base with internal modes, which weighs less at high frequency:
    a platform 10 % slower and less damped than stated makes that loop unstable.
    """
    platform = 0.05 if system.base.m else 0.1
    out = {**_calibration(system, 3.0), **_tilt_and_zero(3.0), **_late(2.0, system)}
    if isinstance(system.emulator_settings.platform, PoseServo):
        out["platform/bandwidth"] = {"error": [-platform, platform]}
        out["platform/damping"] = {"error": [-platform, platform]}
    if system.emulator_settings.payload_compensation:
        out["payload/inertia"] = {"error": [-0.02, 0.02]}
    return out


def _held_out(system: System) -> Spec:
    """Kinds of error that neither `lab` nor `hard` has."""
    out: Spec = {
        "gravity/scale": {"error": [-0.005, 0.005]},
        "sensor/rotation": {"angles": {"normal": [[0.0] * 3, [2e-3] * 3]}},
        "sensor/lag": {"error": {"log_uniform": [0.02, 0.2]}},
    }
    if system.drive == "motor":
        n = system.arm.n
        out["joint/coulomb"] = {"torque": [[0.0] * n, [1.0] * n]}
        out["joint/velocity_lag"] = {"time_constant": [[0.0] * n, [2e-3] * n]}
    return out


LABORATORIES: dict[str, Callable[[System], Spec]] = {
    "nominal": _nominal,
    "lab": _lab,
    "hard": _hard,
    "held-out": _held_out,
}


def _calibration(system: System, times: float) -> Spec:
    """Gravity model and sensor matrix from one calibration under noise `times` the budget's.

    The sensor's zero is trusted: it is read without load.
    """
    from ves_gym.simulation.gravity_calibration import calibration_poses, left_by_noise

    q, y = calibration_poses(system.arm, POSES)
    remainder = left_by_noise(system.arm, q, y, times * _reading(), estimate_offset=False)
    # read by C w where `fit` would give w: of signals in the sensor's frame
    frame = system.emulator_settings.sensor.frame
    matrix = np.einsum("ab,bcm,cd->adm", frame, remainder.C, np.linalg.inv(frame))
    return {
        "gravity/mass": {"error": _jointly(0.0, remainder.model[:1])},
        "gravity/moment": {
            "error": _jointly([0.0] * (len(remainder.model) - 1), remainder.model[1:])
        },
        "sensor/calibration": {
            "error": _jointly(np.zeros((6, 6)).tolist(), matrix.reshape(36, -1))
        },
    }


def _jointly(mean: object, weights: Array) -> dict[str, Any]:
    return {"normal": [mean, weights.tolist()], "shared": "calibration"}


def _reading() -> Array:
    """(6,) standard deviation of one reading under the nominal budget [N, N m]."""
    noise, drift = _budget()
    return np.asarray(np.hypot(noise, drift), dtype=np.float64)


def _budget() -> tuple[Array, Array]:
    """(6,) noise and (6,) drift of the nominal budget [N, N m]."""
    from ves_gym.effects.sensor import LABORATORY_ERRORS

    noise, drift = (np.array([*e.force, *e.moment]) for e in LABORATORY_ERRORS)  # type: ignore[attr-defined]
    return noise, drift


def _tilt_and_zero(times: float) -> Spec:
    """Platform angles that the estimate is given; what one reading's noise leaves of a zero."""
    noise, _ = _budget()
    level = times * TILT
    return {
        "gravity/tilt": {"angles": {"normal": [[0.0] * 3, [level, level, 0.0]]}},
        "sensor/bias": {
            "force": {"normal": [[0.0] * 3, (times * noise[:3]).tolist()]},
            "moment": {"normal": [[0.0] * 3, (times * noise[3:]).tolist()]},
        },
    }


def _late(periods: float, system: System) -> Spec:
    """The estimate comes from another computer, which is not in step (thesis 2.4.1)."""
    return {"gravity/delay": {"delay": [0.0, periods * system.control_dt]}}
