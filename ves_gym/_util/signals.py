"""Signals of a run: one clock, derivatives, noise, and spectra in a band of frequencies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from ves_gym._util.params import Array

GAP = 3.0  # usual steps of a clock: more is a gap
_CUT = 1.7  # cut-off of the differentiating filter over the band: flat inside the band
_POWER = 6  # of the cosine that is the filter's window: its spectrum falls off fast
_LOBE = 7.5  # width of its transition times its length
_DIFFERENCES = 3  # that leave noise and take away motion
_QUIET = 0.12  # of the sampling rate: above it nothing moves
_AGREE = 1.5  # of the power that noise has: rates that disagree by more are not used
_TAPER = 0.1  # share of a run that the window brings to zero


def on_uniform_clock(t: Array, x: Array) -> tuple[float, Array]:
    """Resample signals (T, c) with stamps t (T,) [s] at equal steps; return step [s] and
    samples.

    Uneven stamps may be true, or a regular sampler's samples stamped late. Whichever makes the
    signals smoother is taken: a wrong clock adds noise wherever something moves.
    """
    dt = float(t[-1] - t[0]) / (len(t) - 1)
    even = t[0] + dt * np.arange(len(t))
    if np.abs(t - even).max() < 1e-6 * dt:
        return dt, x
    moved = np.asarray(scipy.interpolate.CubicSpline(t, x, axis=0)(even))
    if np.diff(t).max() > 1.5 * dt:  # samples are missing: the stamps are all there is
        return dt, moved
    rough = [np.square(np.diff(k, _DIFFERENCES, axis=0)).sum(axis=0) for k in (x, moved)]
    votes = np.log(np.maximum(rough[0], 1e-300) / np.maximum(rough[1], 1e-300))
    return dt, moved if float(np.median(votes)) > 0 else x


def interpolated(t: Array, x: Array, at: Array) -> Array:
    """Return signals (T, c) at other stamps (S,) [s], by cubic splines; NaN outside of theirs,
    which increase, and in gaps; NaN where a sample is missing."""
    out = np.full((len(at), x.shape[1]), np.nan)
    most = GAP * float(np.median(np.diff(t)))
    for column, series in zip(out.T, x.T, strict=True):
        good = np.isfinite(series)
        if good.sum() < 2:
            continue
        stamps = t[good]
        after = np.clip(np.searchsorted(stamps, at), 1, len(stamps) - 1)
        near = stamps[after] - stamps[after - 1] <= most
        inside = near & (at >= stamps[0]) & (at <= stamps[-1])
        column[inside] = scipy.interpolate.CubicSpline(stamps, series[good])(at[inside])
    return out


def interpolation_error(t: Array, x: Array) -> Array:
    """Return a bound (c,) of what `interpolated` is wrong by between samples, noise included.

    Every second sample is foretold by the others, at steps twice as long: 16 times the error
    where a signal is smooth.
    """
    if len(t) < 4:
        return np.full(x.shape[1], np.inf)
    error = np.abs(interpolated(t[::2], x[::2], t[1::2]) - x[1::2])
    return np.asarray(np.max(error, axis=0, initial=0.0, where=np.isfinite(error)))


def told_error(names: Sequence[str], t: Array, x: Array) -> str:
    """Return a sentence on `interpolation_error`: the one of the named columns that is worst
    for its range."""
    error, far = interpolation_error(t, x), np.nan_to_num(np.abs(x)).max(axis=0)
    worst = int(np.argmax(error / np.maximum(far, 1e-300)))
    share = 100 * error[worst] / max(float(far[worst]), 1e-300)
    return f"wrong by at most {error[worst]:.2g} or {share:.2g} % ({names[worst]})"


def differentiated(
    x: Array, dt: float, band: float, ahead: float = 0.0
) -> tuple[Array, Array, Array]:
    """Return x, x' and x'' of a signal (..., T, c) sampled every dt [s], flat up to `band`
    [Hz], of `ahead` [s] later.

    Correlation with a windowed sinc and its two derivatives; beyond the ends the signal goes on
    point-symmetrically, so the first and last `margin` samples are less true.
    """
    out = _correlated(x, dt, band, ahead)
    return out[0], out[1], out[2]


def differentiated_with_rates(
    x: Array, rates: Array, dt: float, band: float, crossover: Array, ahead: float = 0.0
) -> tuple[Array, Array, Array]:
    """Return x, x' and x'' of a sampled signal whose rate is measured, too.

    With noise densities S_x and S_v the best linear estimate of x by frequency takes the
    integrated rate with the share w^2 / (w^2 + a^2), a^2 = S_v / S_x (Wiener): what rates and
    differences disagree by, e, is noise alone, and comes in as x - i w / (w^2 + a^2) e, with
    its derivatives. Otherwise as `differentiated`. `crossover` (c,) is a [rad/s], from where
    rates are more exact; infinite: they are not used.
    """
    plain = differentiated(x, dt, band, ahead)
    rate, change, _ = differentiated(rates, dt, band, ahead)
    length = x.shape[-2]
    w = 2 * np.pi * np.fft.rfftfreq(2 * length, dt)[:, None]
    low = 1 / (1 + (w / crossover) ** 2)
    e = np.fft.rfft(rate - plain[1], 2 * length, axis=-2) * low  # zeros behind: no wrap

    def part(factor: npt.NDArray[Any]) -> Array:
        back = np.fft.irfft(factor * e, 2 * length, axis=-2)
        return np.asarray(back[..., :length, :], float)

    both = (
        plain[0] - part(1j * w / crossover**2),
        rate - part(np.ones_like(w)),
        change - part(1j * w),
    )
    used = np.isfinite(crossover)
    out = [np.where(used, a, b) for a, b in zip(both, plain, strict=True)]
    return out[0], out[1], out[2]


def rate_crossover(
    x: Array,
    rates: Array,
    of_x: SensorNoiseModel,
    of_rates: SensorNoiseModel,
    window: SpectralWindow,
) -> Array:
    """Return (c,) from where measured rates (T, c) are more exact than a signal's differences
    [rad/s].

    Infinite where the two disagree by more than their noise: the rates are late, smoothed or of
    another scale.
    """
    f = window.frequencies[1:]
    e = differentiated(rates, window.dt, window.top)[0]
    e = e - differentiated(x, window.dt, window.top)[1]
    w = 2 * np.pi * f[:, None]
    expected = noise_power(of_rates, f, window.dt) + w**2 * noise_power(of_x, f, window.dt)
    off = (np.abs(window.spectrum(e)[1:]) ** 2 / np.maximum(expected, 1e-300)).mean(axis=0)
    still = np.zeros(1)
    ratio = noise_power(of_rates, still, window.dt) / np.maximum(
        noise_power(of_x, still, window.dt), 1e-300
    )
    return np.where(off < _AGREE, np.sqrt(np.maximum(ratio[0], 1e-12)), np.inf)


def noise_power(noise: SensorNoiseModel, f: Array, dt: float) -> Array:
    """Power (K, c) of noise at frequencies f (K,), white noise of variance s^2 having s^2."""
    a = noise.correlation
    shape = (1 - a**2) / (1 - 2 * a * np.cos(2 * np.pi * f[:, None] * dt) + a**2)
    return np.asarray(noise.std**2 * shape)


def _correlated(x: Array, dt: float, band: float, ahead: float) -> list[Array]:
    """Convolve along time; beyond its ends a signal goes on point-symmetrically."""
    m = len(_kernels(dt, band, ahead)[0]) // 2
    reach = min(m, x.shape[-2] - 1)
    first, last = x[..., :1, :], x[..., -1:, :]
    before = 2 * first - x[..., reach:0:-1, :]
    after = 2 * last - x[..., -2 : -reach - 2 : -1, :]
    extended = np.concatenate([before, x, after], axis=-2)
    n = scipy.fft.next_fast_len(extended.shape[-2], real=True)
    spectrum = scipy.fft.rfft(extended, n, axis=-2)
    return [
        scipy.fft.irfft(spectrum * of, n, axis=-2)[..., 2 * reach : extended.shape[-2], :]
        for of in _transfers(dt, band, ahead, reach, n)
    ]


@lru_cache(maxsize=64)
def _transfers(dt: float, band: float, ahead: float, reach: int, n: int) -> list[Array]:
    """Return the kernels (n // 2 + 1, 1) at frequencies, cut to `reach` samples a side."""
    kernels = _kernels(dt, band, ahead)
    cut = slice(len(kernels[0]) // 2 - reach, len(kernels[0]) // 2 + reach + 1)
    return [scipy.fft.rfft(k[cut], n)[:, None] for k in kernels]


def downsampled(x: Array, factor: int) -> Array:
    """Return every `factor`-th sample of a signal (T, c) whose higher frequencies are filtered
    out.

    The filter is symmetric (no delay), flat up to 0.3 of the new sampling rate and down by 80
    dB from half of it; beyond its ends a signal goes on point-symmetrically.
    """
    half = 15 * factor
    taps = scipy.signal.firwin(2 * half + 1, 0.8 / factor, window=("kaiser", 8.0))
    reach = min(half, len(x) - 1)
    extended = np.pad(x, ((reach, reach), (0, 0)), mode="reflect", reflect_type="odd")
    cut = taps[half - reach : half + reach + 1]
    smooth = scipy.signal.fftconvolve(extended, (cut / cut.sum())[:, None], "valid", axes=0)
    return np.asarray(smooth[::factor])


def margin(dt: float, band: float) -> int:
    """Return the number of samples at either end that `differentiated` has to guess at."""
    return _instants(dt, band)[1]


def _instants(dt: float, band: float) -> tuple[Array, int]:
    half = int(np.ceil(_LOBE / (2 * 0.75 * _cut(dt, band)) / dt))
    return np.asarray(dt * np.arange(-half, half + 1), float), half


def _cut(dt: float, band: float) -> float:
    return min(_CUT * band, 0.35 / dt)


def _smooth(t: Array, dt: float, band: float, half: int) -> Array:
    """A low-pass kernel at instants t: a sinc under a window with smooth ends."""
    cut, length = _cut(dt, band), (half + 1) * dt
    window = np.cos(np.pi / 2 * np.clip(t / length, -1, 1)) ** _POWER
    return np.asarray(2 * cut * np.sinc(2 * cut * t) * window)


@lru_cache(maxsize=32)
def _kernels(dt: float, band: float, ahead: float) -> tuple[Array, Array, Array]:
    """A low-pass kernel and its first and second derivative."""
    t, half = _instants(dt, band)
    t = t + ahead
    step = 1e-4 / _cut(dt, band)
    h0, later, sooner = (_smooth(t + s, dt, band, half) for s in (0.0, step, -step))
    h1, h2 = (later - sooner) / (2 * step), (later - 2 * h0 + sooner) / step**2
    h1, h2, h0 = (k / h0.sum() for k in (h1, h2, h0))
    return h0, h1, h2 - h2.sum() * h0  # what stands still has no curvature


@dataclass(frozen=True)
class SensorNoiseModel:
    """First-order coloured noise of one quantity: x[k + 1] = correlation x[k] + fresh."""

    std: Array  # (c,)
    correlation: Array  # (c,) of neighbouring samples

    def draw(self, rng: np.random.Generator, n: int, length: int) -> Array:
        """Return realisations (n, length, c)."""
        a = self.correlation
        fresh = rng.standard_normal((n, length, len(self.std))) * np.sqrt(1 - a**2)
        fresh[:, 0] /= np.sqrt(1 - a**2)
        out = np.empty_like(fresh)
        for i in range(len(a)):
            out[..., i] = scipy.signal.lfilter([1.0], [1.0, -a[i]], fresh[..., i], axis=-1)
        return out * self.std


def estimate_noise(
    x: Array, quiet: float = _QUIET, std: Array | None = None, computed: bool = False
) -> SensorNoiseModel:
    """Estimate the noise of a sampled signal (T, c), separated from its motion by frequency.

    Above `quiet`, a part of the sampling rate, there is no motion: first-order noise is fitted
    to the spectrum there by Whittle's likelihood. Where standard deviations (c,) are stated,
    the median power above twice `quiet`, which nothing that rings moves, tells the correlation;
    the slope of the spectrum alone tells it badly. Of a signal that is computed what leaks from
    the motion counts: it stands for what the model that computes it leaves out.
    """
    d = x - np.linspace(0, 1, len(x))[:, None] * (x[-1] - x[0])  # ends meet: no leakage
    window = "boxcar" if computed else "hann"  # nor from rates that differ there
    taper = scipy.signal.get_window(window, len(x), fftbins=False)[:, None]
    power = np.abs(np.fft.rfft((d - d.mean(axis=0)) * taper, axis=0)) ** 2 / (taper**2).sum()
    f = np.fft.rfftfreq(len(x))
    take = f > quiet
    power, f = power[take][:-1], f[take][:-1]
    grid = np.linspace(0.0, 0.95, 96)
    shape = (1 - grid**2) / (1 - 2 * grid * np.cos(2 * np.pi * f[:, None]) + grid**2)
    ratio = power[:, None, :] / shape[:, :, None]  # (f, grid, c)
    variance = np.maximum(ratio.mean(axis=0), 1e-300)
    if std is None:
        misfit = np.log(variance) + np.log(shape).mean(axis=0)[:, None]
    else:
        level = np.median(ratio[f > 2 * quiet], axis=0) / np.log(2)  # of an exponential law
        variance = np.broadcast_to(np.maximum(np.square(std), 1e-300), level.shape)
        misfit = np.abs(np.log(np.maximum(level, 1e-300)) - np.log(variance))
    best = np.argmin(misfit, axis=0)
    return SensorNoiseModel(np.sqrt(variance[best, np.arange(x.shape[1])]), grid[best])


def repeats(signals: Mapping[str, Array]) -> dict[str, float]:
    """Return the share of samples in which a signal (T, c) stays while every other one moves.

    Twice or more in a row: coarse readings repeat by chance. Less what chance has of that.
    """
    stays = {k: np.diff(x, axis=0) == 0 for k, x in signals.items()}
    all_repeat = {k: x.all(axis=1) for k, x in stays.items()}
    out = {}
    for name, same in all_repeat.items():
        others = [x for k, x in all_repeat.items() if k != name]
        alone = same & ~np.any(others, axis=0) if others else same
        twice = alone[1:] & alone[:-1]
        lost = np.append(twice, False) | np.insert(twice, 0, False)
        chance = float(np.prod(stays[name].mean(axis=0)))
        out[name] = max(0.0, float(lost.mean()) - chance)
    return out


@lru_cache
def _taper(length: int) -> Array:
    return np.asarray(scipy.signal.windows.tukey(length, _TAPER))


@dataclass(frozen=True)
class SpectralWindow:
    """The spectral window of runs of one length: (..., T, c) <-> coefficients (..., K, c)."""

    length: int
    dt: float
    top: float  # Hz
    skip: int  # samples at either end that do not count

    @property
    def frequencies(self) -> Array:
        """(K,) Hz, from 0 to the top."""
        f = np.fft.rfftfreq(self.length - 2 * self.skip, self.dt)
        return np.asarray(f[f <= self.top])

    def spectrum(self, x: Array) -> Array:
        """Coefficients of a windowed signal; white noise of variance s^2 gives |.|^2 = s^2."""
        inner = x[..., self.skip : self.length - self.skip, :]
        taper = _taper(inner.shape[-2])
        out = np.fft.rfft(inner * taper[:, None], axis=-2)[..., : len(self.frequencies), :]
        return np.asarray(out / np.sqrt((taper**2).sum()))
