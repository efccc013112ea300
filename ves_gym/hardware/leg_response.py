"""Frequency response of a leg servo: loops, poles, step, bandwidth and margins."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import scipy

from ves_gym._util.params import Array
from ves_gym.hardware.leg_servo import (
    PLANT,
    WHOLE,
    Complex,
    Leg,
    LegServo,
    closed_loop,
    on_circle,
    response,
)

_3_DB = 10**-0.15


def open_loop(servo: LegServo, f: npt.ArrayLike) -> Complex:
    """Return the loop gain of one leg.

    Args:
        servo: the leg servo.
        f: frequencies below half the sample rate [Hz].
    """
    leg, z = Leg(servo), on_circle(servo, f)
    C = leg.sensed(np.eye(PLANT))
    plant = response(leg.A, leg.B, C, z)
    late, damping = z ** -round(servo.delay * servo.rate), servo.K2 * (1 - 1 / z)
    filtered: Complex = np.polyval(leg.b, z) / np.polyval(leg.a, z)
    if servo.filter is not None and servo.filter.place == "feedback":
        damping = damping * filtered
    return servo.scale * (servo.K1 * filtered + damping) * late * plant


def leg_poles(servo: LegServo, extension: float = 0.5) -> Complex:
    """Return the poles of one leg's closed loop in the z-plane; stable inside the unit circle.

    Args:
        servo: the leg servo.
        extension: of the leg, 0 shortest, 1 longest; home is 0.5.
    """
    return np.linalg.eigvals(Leg(servo, extension).closed[0]).astype(complex)


def step_response(servo: LegServo, t: npt.ArrayLike) -> Array:
    """Return the length after a unit step of the command, held between leg samples.

    Args:
        servo: the leg servo.
        t: times [s].
    """
    A, B, C = Leg(servo).closed
    k = np.floor(np.asarray(t, float) * servo.rate * (1 + WHOLE)).astype(int)
    x, out = np.zeros(len(A)), np.empty(int(k.max(initial=0)) + 1)
    for i in range(len(out)):
        out[i] = C @ x
        x = A @ x + B
    at_times: Array = out[k]
    return at_times


def bandwidth(servo: LegServo) -> float:
    """Return the lowest frequency at which the closed loop falls by 3 dB [Hz]."""
    f = _grid(servo)
    below = np.abs(closed_loop(servo, f)) < _3_DB
    if below[0] or not below.any():
        return math.nan
    i = int(np.argmax(below))
    return float(
        scipy.optimize.brentq(
            lambda v: float(np.abs(closed_loop(servo, v))) - _3_DB, f[i - 1], f[i]
        )
    )


def gain_margin(servo: LegServo) -> float:
    """Return the factor on both gains up to which the leg is stable; below 1 it is not as is.

    From the poles, so that several phase crossings need no rule. Searched from 0.01 to
    100; infinite beyond.
    """
    leg = Leg(servo)

    def excess(decades: float) -> float:
        poles = np.linalg.eigvals(leg.closed_with(10**decades)[0])
        return float(np.abs(poles).max()) - 1

    grid = np.linspace(-2, 2, 201)
    unstable = [excess(g) >= 0 for g in grid]
    if not any(unstable):
        return math.inf
    first = unstable.index(True)
    if first == 0:
        return 0.0
    return float(10 ** scipy.optimize.brentq(excess, grid[first - 1], grid[first]))


def _grid(servo: LegServo) -> Array:
    """Frequencies from 0.01 Hz to just below half the sample rate, 2000 per decade."""
    top = math.log10(0.4999 * servo.rate)
    return np.logspace(-2, top, int(2000 * (top + 2)))
