"""Frequency response of a leg servo: loops, poles, step, bandwidth and margins."""

from __future__ import annotations

import math
from collections.abc import Callable

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


def open_loop(servo: LegServo, f: npt.ArrayLike, extension: float = 0.5) -> Complex:
    """Return the loop gain of one leg.

    Args:
        servo: the leg servo.
        f: frequencies below half the sample rate [Hz].
        extension: of the leg, 0 to 1 of its stroke.
    """
    leg, z = Leg(servo, extension), on_circle(servo, f)
    C = leg.sensed(np.eye(PLANT))
    plant = response(leg.A, leg.B, C, z)
    late, damping = z ** -round(servo.delay * servo.rate), servo.K2 * (1 - 1 / z)
    filtered: Complex = np.polyval(leg.b, z) / np.polyval(leg.a, z)
    if servo.filter is not None and servo.filter.place == "feedback":
        damping = damping * filtered
    loop: Complex = servo.scale * (servo.K1 * filtered + damping) * late * plant
    return loop


def leg_poles(servo: LegServo, extension: float = 0.5) -> Complex:
    """Return the poles of one leg's closed loop in the z-plane; stable inside the unit circle.

    Args:
        servo, extension: see `open_loop`.
    """
    poles: Complex = np.linalg.eigvals(Leg(servo, extension).closed[0]).astype(complex)
    return poles


def step_response(servo: LegServo, t: npt.ArrayLike, extension: float = 0.5) -> Array:
    """Return the length after a unit step of the command, held between leg samples.

    Args:
        servo, extension: see `open_loop`.
        t: times [s].
    """
    A, B, C = Leg(servo, extension).closed
    k = np.floor(np.asarray(t, float) * servo.rate * (1 + WHOLE)).astype(int)
    x, out = np.zeros(len(A)), np.empty(int(k.max(initial=0)) + 1)
    for i in range(len(out)):
        out[i] = C @ x
        x = A @ x + B
    at_times: Array = out[k]
    return at_times


def bandwidth(servo: LegServo, extension: float = 0.5) -> float:
    """Return the lowest frequency at which the closed loop falls by 3 dB [Hz].

    Args:
        servo, extension: see `open_loop`.
    """
    return _falls_to(lambda f: np.abs(closed_loop(servo, f, extension)), 10**-0.15, servo)


def gain_margin(servo: LegServo, extension: float = 0.5) -> float:
    """Return the factor on both gains up to which the leg is stable; below 1 it is not as is.

    From the poles, so that several phase crossings need no rule. Searched from 0.01 to
    100; infinite beyond.

    Args:
        servo, extension: see `open_loop`.
    """

    leg = Leg(servo, extension)

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


def payload_ratio_limit(
    servo: LegServo, extra_delay: float = 0.0, extension: float = 0.5
) -> float:
    """Return the largest payload over model mass with a stable emulation (thesis 5.4).

    One degree of freedom far above the model's own frequency: the payload's inertia is
    fed back through the sensor and the model, 1 + ratio G(s) exp(-s extra_delay) = 0,
    with G the leg's closed loop. Zero if the leg itself is unstable.

    Args:
        servo, extension: see `open_loop`.
        extra_delay: of the emulation loop [s].
    """
    if np.abs(leg_poles(servo, extension)).max() >= 1:
        return 0.0

    def G(f: npt.ArrayLike) -> Complex:
        f = np.asarray(f, float)
        loop: Complex = closed_loop(servo, f, extension) * np.exp(-2j * np.pi * f * extra_delay)
        return loop

    f = _grid(servo)
    g = G(f)
    i = np.flatnonzero(np.diff(np.sign(g.imag)))  # where G is real, about linear between
    real = g.real[i] - g.imag[i] * (g.real[i + 1] - g.real[i]) / (g.imag[i + 1] - g.imag[i])
    if not (real < 0).any():
        return math.inf
    k = i[np.argmin(real)]
    at = scipy.optimize.brentq(lambda v: float(G(v).imag), f[k], f[k + 1])
    return -1 / float(G(at).real)


def _grid(servo: LegServo) -> Array:
    """Frequencies from 0.01 Hz to just below half the sample rate, 2000 per decade."""
    top = math.log10(0.4999 * servo.rate)
    return np.logspace(-2, top, int(2000 * (top + 2)))


def _falls_to(gain: Callable[[Array], Array], level: float, servo: LegServo) -> float:
    f = _grid(servo)
    below = gain(f) < level
    if below[0] or not below.any():
        return math.nan
    i = int(np.argmax(below))
    return float(
        scipy.optimize.brentq(lambda v: float(gain(np.array(v))) - level, f[i - 1], f[i])
    )
