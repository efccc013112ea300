"""The leg servos of the Stewart platform, with the digital filter of thesis chapter 5.

One leg: the servo samples the measured length l at `rate`, takes its error e against the
commanded length, and after `delay` gives u = scale (K1 e_k - K2 (l_k - l_k-1)) to the
valve. The rod's speed follows u through two equal lags (pilot stage and spool), its length
is the integral. The rod's acceleration shakes the leg's first transverse mode, whose
displacement adds to the measured length: enough gain makes it grow (5.2). The platform
stands on the rods: bending changes what is measured, not where it is.

Fig. 5-4 is lost. Read here: K1 acts on the error (filtered, if the filter is there), K2 on
the last change of the length, so that K2 = 1.5 K1 of section 5.6 lowers the overshoot and
hardly changes the bandwidth, as the thesis says of K2. Taken on the error instead, K2
kicks at every new command, 80 times a second, and the force sensor, read in step with
that, returns negative damping (docs/physics.md). Gains, sample rates, mode frequencies and
Table 5-1 are the thesis's; all else is nominal, this project:

- `participation`: without the filter, gains for the thesis's 2 Hz leave a gain margin of
  12 dB (LOW_GAINS);
- `scale`: with the filter on the feedback, K1 = 20000 leaves the same 12 dB
  (FILTERED_FEEDBACK; on the error it is some dB more).

The equal margins give the ratio of the two velocity gains; that they are 12 dB is a
choice, made knowing that slow errors then fall by about 40 %, as measured in 5.5.

Linear throughout: no end stops, no speed limit (`Stewart.beyond`, `Stewart.too_fast`).
"""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
import numpy.typing as npt
import scipy

from ves_gym._util.params import Array, ParameterError, require_choice, require_positive, unit
from ves_gym.hardware.stewart import Stewart

Complex = npt.NDArray[np.complex128]

SCALE = 1.05e-3  # [1/s] velocity gain per unit of K1 and K2
WHOLE = 1e-9  # relative slack when a ratio of times must be a whole number
# States of a leg; the controller's follow.
SPEED, ACCELERATION, ROD, BEND, BEND_RATE = range(5)
PLANT = 5


def whole_steps(name: str, value: float, period: float, *, divides: bool = False) -> int:
    """Return the number of leg periods that make `value` exactly.

    Args:
        name: of the value, for the message.
        value: [s].
        period: of the leg controller [s].
        divides: how many of `value` make a leg period, instead.

    Raises:
        ParameterError: no whole number >= 1; the message says the nearest.
    """
    ratio = 0.0
    if value > 0 and math.isfinite(value):
        ratio = period / value if divides else value / period
    count = max(round(ratio), 1)
    if abs(ratio - count) <= WHOLE * count:
        return count
    relation = "divide the leg period" if divides else "be a whole number of leg periods of"
    good = period / count if divides else period * count
    raise ParameterError(
        f"{name} must {relation} {period:.9g} s, got {value!r} s; the nearest is"
        f" {period:.9g} s {'/' if divides else '*'} {count} = {good:.12g} s"
    )


@dataclass(frozen=True, kw_only=True)
class Filter:
    """Chebyshev type 2 low-pass in the leg servo, on the error or on the measured length.

    The defaults give Table 5-1 at 587 Hz: b = 0.6040, -1.1969, 0.6040;
    a = 1, -1.9002, 0.9113; its notch lies at 12.7 Hz.
    """

    order: int = 2
    stop_db: float = unit("dB", default=4.0)  # attenuation beyond the corner
    corner: float = unit("Hz", default=9.0)  # where that attenuation is first reached
    place: str = "error"

    def __post_init__(self) -> None:
        require_positive(self, "order", "stop_db", "corner")
        require_choice(self, "place", ("error", "feedback"))
        if self.order != int(self.order):
            raise ParameterError(f"Filter.order must be a whole number, got {self.order!r}")

    def coefficients(self, rate: float) -> tuple[Array, Array]:
        """b and a of thesis eq. 5.1 (order + 1,) at a sample rate [Hz]."""
        b, a = scipy.signal.cheby2(self.order, self.stop_db, self.corner, fs=rate)
        return b, a


@dataclass(frozen=True, kw_only=True)
class LegServo:
    """Servo, valve and first transverse mode of a leg; see the module for the equations.

    Raises:
        ParameterError: a number out of range, a delay that is no whole number of samples,
            or a filter corner at or above half the sample rate.
    """

    kind: ClassVar[str] = "legs"
    rate: float = unit("Hz")  # of the leg controller
    K1: float = unit("1")  # thesis 5.6, times `scale`: velocity gain
    K2: float = unit("1", default=0.0)  # on the difference of two samples
    scale: float = unit("1/s", default=SCALE)
    filter: Filter | None = None
    valve_lag: float = unit("s", default=3e-3)
    delay: float = unit("s", default=0.0)  # from measurement to valve, whole samples
    resolution: float = unit("m", default=0.0)  # of the length transducer; 0 is exact
    mode_short: float = unit("Hz", default=13.0)  # thesis 5.2, at the shortest leg
    mode_long: float = unit("Hz", default=10.0)  # and the longest; linear in between
    mode_damping: float = unit("1", default=0.03)
    participation: float = unit("1", default=0.103)  # of the mode in the measured length
    source: str = "user"

    def __post_init__(self) -> None:
        require_positive(self, "rate", "K1", "scale", "valve_lag", "mode_short", "mode_long")
        require_positive(
            self, "K2", "delay", "resolution", "mode_damping", "participation", zero=True
        )
        if self.delay:
            whole_steps("LegServo.delay", self.delay, 1 / self.rate)
        if self.filter is not None and 2 * self.filter.corner >= self.rate:
            raise ParameterError(
                f"LegServo.filter.corner must be < half the rate {self.rate} Hz,"
                f" got {self.filter.corner} Hz"
            )

    @property
    def lag(self) -> float:
        """Delay of a slow motion [s], from the phase of the closed loop."""
        f = 1e-2
        return float(-np.angle(closed_loop(self, f)) / (2 * np.pi * f))

    def scaled(self, factor: float) -> LegServo:
        """The same servo with both gains times a factor."""
        return replace(self, K1=self.K1 * factor, K2=self.K2 * factor)


_NOMINAL = "nominal, this project, with the thesis's"
LOW_GAINS = LegServo(
    rate=978.0,
    K1=12e3,
    K2=18e3,
    delay=1 / 978,
    source=f"{_NOMINAL} 2 Hz (5.2) and 1.023 ms (5.3, printed as 831 Hz)",
)
FILTERED = LegServo(
    rate=587.0,
    K1=20e3,
    K2=30e3,
    filter=Filter(),
    delay=1 / 587,
    source=f"{_NOMINAL} gains (5.6) and filter on the error (Table 5-1)",
)
FILTERED_FEEDBACK = replace(
    FILTERED,
    filter=Filter(place="feedback"),
    source=f"{_NOMINAL} gains (5.6) and filter on the feedback (5.4, not built)",
)
LEG_SERVOS = {
    "low-gains": LOW_GAINS,
    "filtered": FILTERED,
    "filtered-feedback": FILTERED_FEEDBACK,
}


def leg_clock(servo: LegServo) -> tuple[float, float]:
    """Control period and physics step [s] that suit a leg servo.

    The control period is the whole number of leg samples next to 80 Hz (thesis 2.4.2: 75
    to 90 Hz), the physics step the leg period or half of it, at most 1.25 ms.
    """
    samples = max(1, round(servo.rate / 80))
    return samples / servo.rate, 1 / (servo.rate * math.ceil(1 / (servo.rate * 1.25e-3)))


class Leg:
    """One leg, discretised exactly: the map from one leg sample to the next.

    A state has its components along the first axis (s, ...): speed and length of the
    rod, the mode's displacement and rate, the filter's memory, the last length and the
    valve commands under way. The time domain runs `sample` and `drift` on arrays; the
    frequency domain takes its matrices from the same two.
    """

    def __init__(self, servo: LegServo, extension: float = 0.5, steps: int = 1) -> None:
        """`steps` physics steps per leg period; the mode's frequency at `extension`."""
        self.servo, self.steps = servo, steps
        hertz = servo.mode_short + extension * (servo.mode_long - servo.mode_short)
        self.b, self.a = np.ones(1), np.ones(1)
        if servo.filter is not None:
            self.b, self.a = servo.filter.coefficients(servo.rate)
        self.order = len(self.b) - 1
        self.last = PLANT + self.order
        self.size = self.last + 1 + round(servo.delay * servo.rate)
        lag, w, zeta = servo.valve_lag, 2 * np.pi * hertz, servo.mode_damping
        generator = np.zeros((PLANT + 1, PLANT + 1))  # of speed, rod, bend, its rate, u
        generator[SPEED, ACCELERATION] = 1  # spool and pilot stage: two lags of half each
        generator[ACCELERATION, [SPEED, ACCELERATION, PLANT]] = (
            -4 / lag**2,
            -4 / lag,
            4 / lag**2,
        )
        generator[ROD, SPEED] = generator[BEND, BEND_RATE] = 1
        generator[BEND_RATE] = -generator[SPEED]  # shaken by the rod's acceleration
        generator[BEND_RATE, [BEND, BEND_RATE]] = -(w**2), -2 * zeta * w
        step = scipy.linalg.expm(generator / (servo.rate * steps))
        self.A, self.B = step[:PLANT, :PLANT], step[:PLANT, PLANT]

    def sensed(self, x: Array) -> Array:
        """Length at the transducer, before it is quantised [m]."""
        length: Array = x[ROD] + self.servo.participation * x[BEND]
        return length

    def measure(self, x: Array) -> Array:
        """Length as the transducer reports it [m].

        Args:
            x: (states, ...) leg states.
        """
        length, step = self.sensed(x), self.servo.resolution
        return np.rint(length / step) * step if step else length

    def steady_state(self, length: Array) -> Array:
        """State (s, ...) of a leg at rest at its commanded length (...) [m]."""
        x = np.zeros((self.size, *length.shape))
        x[ROD] = length
        measured = self.measure(x)
        if self.servo.filter is not None:
            fed_back = measured if self.servo.filter.place == "feedback" else length - measured
            memory = scipy.signal.lfilter_zi(self.b, self.a)
            x[PLANT : self.last] = np.multiply.outer(memory, fed_back)
        x[self.last] = measured
        return x

    def sample(
        self, x: Array, command: Array, gain: Array | float = 1.0, brake: Array | float = 1.0
    ) -> Array:
        """Run the controller once; changes its part of x.

        Args:
            x: (states, ...) leg states.
            command: (...) commanded length [m].
            gain: (...) both gains over those stated.
            brake: (...) the gain K2 alone, over that.

        Returns:
            (...) u at the valve.
        """
        servo, measured = self.servo, self.measure(x)
        if servo.filter is not None and servo.filter.place == "feedback":
            measured = self._filtered(x, measured)
        error = command - measured
        if servo.filter is not None and servo.filter.place == "error":
            error = self._filtered(x, error)
        braked = brake * servo.K2 * (measured - x[self.last])
        u: Array = gain * servo.scale * (servo.K1 * error - braked)
        x[self.last] = measured
        if self.size == self.last + 1:
            return u
        out: Array = x[self.last + 1].copy()
        x[self.last + 1 : -1] = x[self.last + 2 :]
        x[-1] = u
        return out

    def _filtered(self, x: Array, value: Array) -> Array:
        """Thesis eq. 5.1, its sums stored in x (transposed direct form II)."""
        memory = x[PLANT : self.last]
        out: Array = self.b[0] * value + memory[0]
        memory[:-1] = memory[1:]
        memory[-1] = 0.0
        for i in range(self.order):
            memory[i] += self.b[i + 1] * value - self.a[i + 1] * out
        return out

    def drift(self, x: Array, u: Array) -> None:
        """Advance x by one physics step in place, the valve command held.

        Args:
            x: (states, ...) leg states.
            u: (...) valve command.
        """
        # A sum of columns: a BLAS product may round differently for another batch size.
        shape = (PLANT, *(1,) * u.ndim)
        out = self.B.reshape(shape) * u
        for j in range(PLANT):
            out += self.A[:, j].reshape(shape) * x[j]
        x[:PLANT] = out

    @cached_property
    def closed(self) -> tuple[Array, Array, Array]:
        """A (s, s), B (s,), C (s,): x+ = A x + B command, length = C x, per leg sample."""
        return self.closed_with(1.0)

    def closed_with(self, gain: float) -> tuple[Array, Array, Array]:
        """`closed` with both gains times a factor; without the transducer's resolution."""
        leg = copy(self)
        leg.servo = replace(self.servo, resolution=0.0)
        x = np.eye(self.size, self.size + 1)
        C = x[ROD, :-1].copy()
        u = leg.sample(x, np.eye(1, self.size + 1, self.size)[0], gain)
        for _ in range(self.steps):
            self.drift(x, u)
        return x[:, :-1], x[:, -1], C


# -------------------------------------------------------------------- frequency domain
# At home; quantisation is left out.


def closed_loop(servo: LegServo, f: npt.ArrayLike) -> Complex:
    """Return the frequency response from commanded length to length of the rod, at f [Hz]."""
    return response(*Leg(servo).closed, on_circle(servo, f))


def on_circle(servo: LegServo, f: npt.ArrayLike) -> Complex:
    return np.exp(2j * np.pi * np.asarray(f, float) / servo.rate)


def response(A: Array, B: Array, C: Array, z: Complex) -> Complex:
    """C (z - A)^-1 B at points z (...)."""
    resolvent = z[..., None, None] * np.eye(len(A)) - A
    inputs = np.broadcast_to(B.astype(complex)[:, None], (*z.shape, len(B), 1))
    return np.linalg.solve(resolvent, inputs)[..., 0] @ C


_NEAR = 1e-6  # [m] error of a length that one more step of Newton's method makes rounding
_FROM_AFAR = 3  # steps from the pose to that of bent, quantised legs


class Legs:
    """The platform on its six leg servos: what carries their state over a control period.

    Every control period begins with a leg sample, so no simulation carries a clock. States
    are (n, s, 6): `s` numbers of each leg, of n simulations that share nothing.
    """

    def __init__(
        self, servo: LegServo, stewart: Stewart, control_dt: float, physics_dt: float
    ) -> None:
        """Settle the clocks.

        Raises:
            ParameterError: control_dt is no whole number of leg periods, or the leg period
                no whole number of physics steps (to 1e-9).
        """
        period = 1 / servo.rate
        self.samples = whole_steps("control_dt", control_dt, period)
        steps = whole_steps("physics_dt", physics_dt, period, divides=True)
        extension = (stewart.home_lengths.mean() - stewart.length_min) / (
            stewart.length_max - stewart.length_min
        )
        self.servo, self.stewart = servo, stewart
        self.leg = Leg(servo, float(extension), steps)

    def at_rest(self, y: npt.ArrayLike) -> Array:
        """State (n, s, 6) of legs at rest at poses (n, 6), which they are commanded."""
        return np.moveaxis(self.leg.steady_state(self.stewart.leg_lengths(y)), 0, 1)

    def advance(
        self,
        state: Array,
        pose: Array,
        y_cmd: Array,
        gain: Array | float = 1.0,
        brake: Array | float = 1.0,
    ) -> tuple[Array, Array, Array, Array, Array]:
        """Follow a pose that is held for one period of the leg controller.

        The legs are sent lengths only (thesis 2.4.2): the commanded rate is not used.

        Args:
            state: (n, s, 6) of the legs.
            pose: (n, 6) of the platform [m, rad].
            y_cmd: (n, 6) commanded pose [m, rad].
            gain, brake: (n, 1) of the servos over those stated, see `Leg.sample`.

        Returns:
            State and pose at the end, and Y, Y', Y'' (n, steps, 6) at the starts of the
            physics steps. NaN where the legs hold no platform (`stewart.forward`).
        """
        leg, stewart, h = self.leg, self.stewart, 1 / (self.servo.rate * self.leg.steps)
        x, y, path = np.moveaxis(state, 1, 0).copy(), pose, []
        u = leg.sample(x, stewart.leg_lengths(y_cmd), gain, brake)
        for _ in range(leg.steps):
            yd, ydd = stewart.motion(y, x[SPEED], x[ACCELERATION])
            path.append((y, yd, ydd))
            leg.drift(x, u)
            # where this motion leads, then Newton's method
            y, _ = stewart.step_to(y + h * yd + h * h / 2 * ydd, x[ROD])
            y = self._settled(y, x[ROD])
        at, rate, acceleration = zip(*path, strict=True)
        over = [np.stack(part, axis=1) for part in (at, rate, acceleration)]
        return np.moveaxis(x, 0, 1), y, over[0], over[1], over[2]

    def motion(self, state: Array, pose: Array) -> tuple[Array, Array]:
        """Return Y' and Y'' (n, 6) of the platform.

        Args:
            state, pose: see `advance`.
        """
        return self.stewart.motion(pose, state[:, SPEED], state[:, ACCELERATION])

    def present(self, state: Array, pose: Array) -> tuple[Array, Array]:
        """Return pose and rate (n, 6) that the legs have now.

        Args:
            state, pose: see `advance`.
        """
        y = self.stewart.forward(state[:, ROD], pose)
        return y, self.motion(state, y)[0]

    def measured(self, state: Array, pose: Array) -> Array:
        """Return the pose (n, 6) by forward kinematics of the measured lengths.

        Args:
            state, pose: see `advance`.

        Returns:
            NaN as `advance`.
        """
        lengths = self.leg.measure(np.moveaxis(state, 1, 0))
        y = pose
        for _ in range(_FROM_AFAR):
            y, _ = self.stewart.step_to(y, lengths)
        return self._settled(y, lengths)

    def _settled(self, y: Array, lengths: Array) -> Array:
        """A last step of Newton's method (n, 6); NaN where it is not the last one."""
        better, error = self.stewart.step_to(y, lengths)
        converged = (error <= _NEAR)[:, None]
        return np.where(converged, better, np.nan)
