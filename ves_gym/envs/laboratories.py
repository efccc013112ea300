"""Named laboratories of emulated tasks: which errors they have, and which are drawn anew.

docs/laboratory.md says where each number comes from. A laboratory is made for a system: the
calibration's errors are those of its arm.
"""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ves_gym._util.params import Array, ParameterError, require_one_of
from ves_gym.envs.randomize import Range, effect_at, ranges_of
from ves_gym.hardware.platform import PoseServo
from ves_gym.mechanics.servo import JointServo
from ves_gym.simulation.loop_linearisation import EmulationWarning, judged_radius, unstable
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.effect import EFFECTS, BaseEffect, DelayEffect, Effect, LaboratoryEffect
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
    require_one_of("laboratory", name, LABORATORIES)
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
    remainder = left_by_noise(system.arm, q, y, times * _reading())
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


# --------------------------------------------------------------- ends of what is drawn

# What they add to the wrench depends on the pose, and hardly on the motion about it.
_STATIC = {
    "gravity/mass", "gravity/moment", "gravity/scale", "gravity/tilt",
    "sensor/bias", "sensor/drift", "sensor/noise",
}  # fmt: skip
_KINDS = (LaboratoryEffect, DelayEffect, BaseEffect)  # friction has no linear loop at rest


def warn_of_unstable_corners(
    system: System, ranges: tuple[Range, ...], servo: JointServo | None
) -> None:
    """Issue an `EmulationWarning` where an end of the ranges makes the loop unstable at q = 0.

    Each parameter is tried at either end alone, then all together at their worse ends: of k
    parameters 2 k + 1 loops, not 2^k. Errors that stem from a shared source are left out.

    Args:
        system: without the randomised effects.
        ranges: what is drawn.
        servo: joint servo, None for bare torques.
    """
    if system.mode != "emulated" or system.emulator_settings.operation == "position":
        return
    worse: list[Effect] = []
    moving = [
        r
        for r in ranges
        if r.effect not in _STATIC
        and r.shared is None
        and issubclass(EFFECTS[r.effect], _KINDS)
    ]
    for kind, group in itertools.groupby(moving, key=lambda r: r.effect):
        parts = tuple(group)
        ends = [effect_at(parts, end) for end in (0, 1)]
        radii = [_radius(system, (effect,), servo) for effect in ends]
        worse.append(ends[int(np.argmax(radii))])
        for effect, radius in zip(ends, radii, strict=True):
            if unstable(radius):
                _warn(f"{effect} of the drawn {kind}", radius)
                return
    if len(worse) > 1 and unstable(radius := _radius(system, tuple(worse), servo)):
        _warn(f"the drawn {', '.join(map(str, worse))} together", radius)


def _radius(system: System, effects: tuple[Effect, ...], servo: JointServo | None) -> float:
    added = tuple(e for e in effects if not e.is_null)
    if not added:
        return 0.0
    return judged_radius(
        Simulator, system.replace(effects=(*system.effects, *added)), 0.0, servo
    )


def _warn(what: str, radius: float) -> None:
    warnings.warn(
        f"unstable emulation in a part of the ranges: with {what}, each control period"
        f" multiplies its least stable mode by {radius:.6g}. Draw less of it, or see"
        " `ves-gym emulation-check`",
        EmulationWarning,
        stacklevel=4,
    )
