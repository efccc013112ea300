"""Stability of an emulation at the ends of what is drawn, judged once per task."""

from __future__ import annotations

import itertools
import warnings

import numpy as np

from ves_gym.envs.randomize import Range, effect_at
from ves_gym.mechanics.servo import JointServo
from ves_gym.simulation.loop_linearisation import EmulationWarning, judged_radius, unstable
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.effect import EFFECTS, BaseEffect, DelayEffect, Effect, LaboratoryEffect
from ves_gym.system.system import System

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
