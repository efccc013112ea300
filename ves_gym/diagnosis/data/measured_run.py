"""`Run`: a measured log on an even clock, with its noise; what the workflow works on."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt
import scipy

from ves_gym._util.params import Array, ParameterError
from ves_gym._util.signals import (
    GAP,
    SensorNoiseModel,
    SpectralWindow,
    differentiated,
    differentiated_with_rates,
    estimate_noise,
    margin,
    noise_power,
    on_uniform_clock,
    rate_crossover,
    repeats,
)
from ves_gym.mechanics.servo import JointServo
from ves_gym.system.runlog import RunLog

T = TypeVar("T")
BAND = 12.0  # Hz: motion above it is below the noise of differentiated encoders
MEASURED = ("q", "v", "tau", "y", "yd", "w")  # signals of the log that a sensor gives
NEAR = "near"  # in the memory of noisy copies: that of the run itself
COMMANDED = ("q_cmd", "v_cmd")  # that a controller is told
REMEMBERED = 40  # of one kind: both ports of an arm ask, with one friction after another
_SAME_CLOCK = 1e-3  # relative difference of steps
_STILL = 1e-4  # rad/s: noise of a rate that turns no friction round, a hundredth of its creep
_PER_BAND = 4.0  # samples per period of the band's top that derivatives need
SHORTEST = 15.0  # periods of the band's top: in less, slow motion is no more than a slope


def forget(remembered: dict[Any, Any], most: int = REMEMBERED) -> None:
    """Drop the oldest of what is remembered but for the first, the description's own."""
    if len(remembered) > most:
        del remembered[list(remembered)[1]]


def cached(
    memory: dict[Any, Any],
    kind: Hashable,
    key: Any,
    make: Callable[[], T],
    most: int = REMEMBERED,
) -> T:
    """Return what a run remembers of a kind for a key: the `most` latest are computed once."""
    entries: dict[Any, T] = memory.setdefault(kind, {})
    if key not in entries:
        entries[key] = make()
        forget(entries, most)
    return entries[key]


class Kinematics(NamedTuple):
    """A signal with its first and second derivative; (..., T, c) each."""

    x: Array
    v: Array
    a: Array


class Derived(NamedTuple):
    """Key of what is derived from some signals of a run and from no others."""

    name: Hashable
    signals: frozenset[str]


@dataclass(frozen=True, eq=False)
class Run:
    """Signals of one run at equal steps, and the noise in each."""

    name: str
    dt: float  # s
    signals: Mapping[str, Array]  # (..., T, c) by the names of the run log; for wg, `weight`:
    #                               what was subtracted from w
    noise: Mapping[str, SensorNoiseModel]  # of the sensors
    meta: Mapping[str, Any]
    band: float = BAND  # Hz
    repeats: Mapping[str, float] = field(default_factory=dict)  # share of samples that stay
    crossover: Array | None = None  # (n,) rad/s from where rates tell more than angles
    by_log: bool = False  # torques are told by the log alone, not by what was asked as well
    jitter: Mapping[tuple[str, ...], float] = field(default_factory=dict)  # s, by recorder
    memory: dict[Any, Any] = field(default_factory=dict)  # what machines derive from it

    @property
    def length(self) -> int:
        """Number of samples T."""
        return int(next(iter(self.signals.values())).shape[-2])

    @property
    def window(self) -> SpectralWindow:
        """The frequencies that are compared."""
        return SpectralWindow(self.length, self.dt, self.band, margin(self.dt, self.band))

    def __getitem__(self, name: str) -> Array:
        return self.signals[name]

    def __contains__(self, name: str) -> bool:
        if name == "controller":
            return {"kp", "kd"} <= set(self.meta.get("controller", {}))
        return name in self.signals

    @property
    def servo(self) -> JointServo | None:
        """The controller of the joints, where the log names it."""
        return JointServo(**self.meta["controller"]) if "controller" in self else None

    @cached_property
    def angles(self) -> Kinematics:
        """Joint angles as a computer reads them, noise and all, and their derivatives."""
        return Kinematics(*differentiated(self["q"], self.dt, self.band))

    @cached_property
    def joints(self) -> Kinematics:
        """Motion of the joints: angles, rates and accelerations."""
        return self.joints_ahead(0.0)

    def joints_ahead(self, ahead: float) -> Kinematics:
        """Motion of the joints from angles and rates as measured, `ahead` s later."""
        if self.crossover is None:
            return Kinematics(*differentiated(self["q"], self.dt, self.band, ahead))
        q, v = self["q"], self["v"]
        return Kinematics(
            *differentiated_with_rates(q, v, self.dt, self.band, self.crossover, ahead)
        )

    @cached_property
    def padded_frequencies(self) -> Array:
        """(K,) Hz of a run with as many zeros behind it."""
        return np.asarray(np.fft.rfftfreq(2 * self.length, self.dt), float)

    @cached_property
    def noise_of_angles(self) -> Array:
        """Power (K, n) of noise in the joints' angles at the padded frequencies."""
        f = self.padded_frequencies
        power = noise_power(self.noise["q"], f, self.dt)
        for signals, late in self.jitter.items():
            if "q" in signals:
                power = power + noise_power(_white(late * _rms(self.rate_of("q"))), f, self.dt)
        if self.crossover is not None:  # from there on rates tell it
            power = power / (1 + (2 * np.pi * f[:, None] / self.crossover) ** 2)
        return power

    @cached_property
    def turning_rate(self) -> Array:
        """(..., T, n) rates of the joints for laws that change with their direction [rad/s].

        Where a joint turns round quickly a rate of the band alone is too smooth, and friction
        turns too slowly; where angles have noise to speak of, one of neighbouring samples would
        turn it to and fro.
        """
        noise = self.noise["q"].std.max() * np.sqrt(2) / self.dt if "q" in self.noise else 0.0
        if noise > _STILL:
            return self.joints.v
        t = self.dt * np.arange(self.length)
        spline = scipy.interpolate.CubicSpline(t, self["q"], axis=-2)
        return np.asarray(spline.derivative()(t), float)

    @cached_property
    def base(self) -> Kinematics:
        """Measured base or platform pose with its rates and accelerations."""
        return Kinematics(*differentiated(self["y"], self.dt, self.band))

    def derived(
        self, name: Hashable, signals: Iterable[str], make: Callable[[], T], near: bool = False
    ) -> T:
        """Return what follows from some signals alone, computed once.

        Where it is `near`, noise hardly moves it: a noisy copy takes that of the run itself.
        """
        key = Derived(name, frozenset(signals))
        original = self.memory.get(NEAR, {}) if near else {}
        if key not in self.memory and key not in original:
            self.memory[key] = make()
        return original[key] if key in original else self.memory[key]

    def with_signals(self, changes: Mapping[str, Array]) -> Run:
        """Return the run with other signals (..., T, c); what the rest leads to is kept."""
        memory = {
            key: value
            for key, value in self.memory.items()
            if isinstance(key, Derived) and key.signals.isdisjoint(changes)
        }
        return replace(self, signals={**self.signals, **changes}, memory=memory)

    def rate_of(self, name: str) -> Array:
        """Return how fast a signal changes (..., T, c)."""
        return self.derived(
            f"rate of {name}", [name], lambda: differentiated(self[name], self.dt, self.band)[1]
        )

    def with_noise(
        self,
        rng: np.random.Generator,
        n: int,
        exact: Sequence[str] = (),
        sensors: bool = True,
        jitter: bool = True,
    ) -> Run:
        """Return the run n times, each with another draw of its noise on top: (n, T, c).

        Signals that are `exact` were really given as the log has them. Jitter is that of
        instants, common to the signals of a recorder.
        """
        noisy = {k: np.broadcast_to(x, (n, *x.shape)) for k, x in self.signals.items()}
        inexact = [k for k in noisy if k not in exact]
        for name in (k for k in inexact if sensors and k in self.noise):
            noisy[name] = noisy[name] + self.noise[name].draw(rng, n, self.length)
        for signals, std in self.jitter.items() if jitter else ():
            late = std * rng.standard_normal((n, self.length, 1))
            for name in (k for k in signals if k in inexact):
                noisy[name] = noisy[name] + late * self.rate_of(name)
        return replace(self, signals=noisy, memory={NEAR: self.memory})


def _white(std: Array) -> SensorNoiseModel:
    return SensorNoiseModel(std, np.zeros_like(std))


def _rms(x: Array) -> Array:
    """Return (c,) root mean squares of samples (T, c)."""
    return np.sqrt(np.mean(x.reshape(-1, x.shape[-1]) ** 2, axis=0))


def run_of(log: RunLog, name: str, band: float = BAND) -> Run:
    """Return a log as a run called `name`, on an even clock, compared up to `band` Hz.

    Noise is the metadata's `noise_std` where stated, else estimated from the signal; its colour
    is always estimated.

    Raises:
        ParameterError: too short, or sampled too slowly for the band.
    """
    names = ("q_cmd", "v_cmd", "q", "v", "tau", "tau_ff", "y", "y_cmd", "yd", "w")
    signals = {k: getattr(log, k) for k in names if getattr(log, k) is not None}
    if log.w is not None and log.wg is not None:  # both contain the same noise
        signals["weight"] = log.w - log.wg
    run = run_of_signals(log.t, signals, name, band, log.meta)
    return replace(run, crossover=_crossover(run))


def _crossover(run: Run) -> Array | None:
    """Return from where measured rates are used; None where angles alone are as good.

    The noise of both must be stated: in a log that rings, noise is told from no ringing, and
    rates have more of what lies between samples than angles. Angles with next to no noise need
    no help, and rates that a drive has smoothed give none.
    """
    if not {"q", "v"} <= set(run.meta.get("noise_std", {})) & set(run.signals):
        return None
    angles, rates = run.noise["q"], run.noise["v"]
    if not rates.std.all() or angles.std.min() * np.sqrt(2) / run.dt < _STILL:
        return None
    crossings = rate_crossover(run["q"], run["v"], angles, rates, run.window)
    return crossings if np.isfinite(crossings).any() else None


def run_of_signals(
    t: npt.ArrayLike,
    signals: Mapping[str, Array],
    name: str,
    band: float = BAND,
    meta: Mapping[str, Any] | None = None,
) -> Run:
    """Return signals stamped at t on an even clock; as `run_of` otherwise.

    Args:
        t: (T,) time stamps [s].
        signals: (T, c) each, by the names of the run log.
        name: of the run, in messages and results.
        band: frequencies compared reach up to it [Hz].
        meta: as of a run log.

    Raises:
        ParameterError: too short, or sampled too slowly for the band.
    """
    meta, t = {} if meta is None else meta, np.asarray(t, float)
    stacked = np.concatenate(list(signals.values()), axis=1)
    dt, even = on_uniform_clock(t, stacked)
    if 1 / dt < _PER_BAND * band:
        milli = ", or is the clock in ms? s is expected" if 1e3 / dt >= _PER_BAND * band else ""
        raise ParameterError(
            f"{name}: sampled at {1 / dt:.4g} Hz, comparing up to {band:g} Hz needs at least"
            f" {_PER_BAND * band:g} Hz: take a band up to {1 / dt / _PER_BAND:.3g} Hz{milli}"
        )
    shortest = max(4 * margin(dt, band) * dt, SHORTEST / band)
    if dt * len(even) < shortest:
        milli = "; is the clock in s, read as ms?" if 1e-3 / dt >= _PER_BAND * band else ""
        raise ParameterError(
            f"{name}: {t[-1] - t[0]:.3g} s is too short, need {shortest:.3g} s{milli}"
        )
    uniform, noise, at = {}, {}, 0
    stated = meta.get("noise_std", {})
    for key, x in signals.items():
        uniform[key] = even[:, at : at + x.shape[1]]
        at += x.shape[1]
        std = None
        if key in stated:
            std = np.broadcast_to(np.asarray(stated[key], float), (x.shape[1],)).copy()
        noise[key] = estimate_noise(uniform[key], std=std, computed=key not in MEASURED)
    measured = {k: x for k, x in signals.items() if k in MEASURED}
    return Run(name, dt, uniform, noise, meta, band, repeats(measured))


def with_shared_colour(runs: Sequence[Run], like: Sequence[Run]) -> list[Run]:
    """Return runs whose noise of a stated size has the colour that runs `like` them tell.

    Colour is a sensor's, not a run's, and whatever moves fast makes noise look whiter: the run
    in which the least does tells it.
    """
    out = []
    for run in runs:
        noise = dict(run.noise)
        others = [k for k in like if abs(k.dt / run.dt - 1) < _SAME_CLOCK]
        for name in set(noise) & set(run.meta.get("noise_std", {})):
            correlations = [k.noise[name].correlation for k in others if name in k.noise]
            if correlations:
                noise[name] = SensorNoiseModel(noise[name].std, np.max(correlations, axis=0))
        out.append(replace(run, noise=noise, memory={}))
    return out


def require_steady(t: Array, name: str) -> None:
    """Refuse a clock (T,) that does not run forward or has gaps, naming the row.

    Raises:
        ParameterError: a step that is not positive, or far longer than the usual one.
    """
    steps = np.diff(t)
    usual = float(np.median(steps))
    back, late = int(np.argmin(steps)), int(np.argmax(steps))
    if not steps[back] > 0:
        raise ParameterError(f"{name}: row {back + 2}: the clock does not run forward")
    if steps[late] > GAP * usual:
        raise ParameterError(
            f"{name}: row {late + 2}: {steps[late]:.4g} s after the row before, usually"
            f" {usual:.4g} s: cut the log at the gap"
        )
