"""Clock, derivatives, noise and spectra of measured signals."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ves_gym._util.signals import (
    SensorNoiseModel,
    SpectralWindow,
    differentiated,
    differentiated_with_rates,
    estimate_noise,
    margin,
    on_uniform_clock,
    rate_crossover,
)

DT, TOP = 5e-3, 12.0
T = np.arange(2000) * DT
INNER = slice(100, -100)


@given(st.floats(0.2, 12.0))
@settings(max_examples=30, deadline=None)
def test_derivatives_are_flat_in_the_band(f):
    w = 2 * np.pi * f
    x, v, a = differentiated(np.sin(w * T)[:, None], DT, TOP)
    assert np.abs(x[INNER, 0] - np.sin(w * T)[INNER]).max() < 1e-4
    assert np.abs(v[INNER, 0] / w - np.cos(w * T)[INNER]).max() < 1e-4
    assert np.abs(a[INNER, 0] / w**2 + np.sin(w * T)[INNER]).max() < 1e-4


def test_what_stands_still_does_not_move():
    _, v, a = differentiated(np.full((500, 2), 3.7), DT, TOP)
    assert np.abs(v).max() < 1e-9 and np.abs(a).max() < 1e-7


def test_what_lies_above_the_band_is_gone():
    x, _, _ = differentiated(np.sin(2 * np.pi * 40 * T)[:, None], DT, TOP)
    assert np.abs(x[INNER]).max() < 1e-4


def test_ahead_is_a_shift_by_any_time():
    w, ahead = 2 * np.pi * 3.0, 0.0031
    x, _, _ = differentiated(np.sin(w * T)[:, None], DT, TOP, ahead)
    assert np.abs(x[INNER, 0] - np.sin(w * (T + ahead))[INNER]).max() < 1e-6


@pytest.mark.parametrize("correlation", [0.0, 0.4, 0.8])
def test_noise_is_told_from_motion(correlation):
    noise = SensorNoiseModel(np.array([0.3]), np.array([correlation]))
    x = noise.draw(np.random.default_rng(1), 1, 2000)[0]
    found = estimate_noise(x + 50 * np.sin(2 * np.pi * 1.3 * T)[:, None])
    assert found.std[0] == pytest.approx(0.3, rel=0.25)
    assert found.correlation[0] == pytest.approx(correlation, abs=0.12)


@pytest.mark.parametrize("std", [None, np.array([1e-4])])
def test_a_motion_that_ends_at_another_rate_is_no_noise(std):
    """At 80 Hz the jump of the rate from end to beginning leaks ten times such noise."""
    t = np.arange(640) / 80
    x = 0.5 * np.sin(2 * np.pi * 0.37 * t) + 1e-4 * np.random.default_rng(1).standard_normal(
        640
    )
    found = estimate_noise(x[:, None], std=std)
    assert found.std[0] == pytest.approx(1e-4, rel=0.2)
    assert found.correlation[0] < 0.15


def test_white_noise_has_unit_power_in_the_spectrum():
    band = SpectralWindow(2000, DT, TOP, margin(DT, TOP))
    x = np.random.default_rng(0).standard_normal((200, 2000, 1))
    assert np.mean(np.abs(band.spectrum(x)) ** 2) == pytest.approx(1.0, rel=0.05)


def test_stamps_that_are_true_are_used_and_others_are_not():
    rng = np.random.default_rng(0)
    shaken = T + rng.uniform(-0.2, 0.2, len(T)) * DT
    noise = 1e-5 * rng.standard_normal(len(T))

    def signal(t):
        return (np.sin(2 * np.pi * 3 * t) + noise)[:, None]

    dt, true = on_uniform_clock(shaken, signal(shaken))
    even = shaken[0] + dt * np.arange(len(T))
    assert np.abs(true - signal(even))[5:-5].max() < 1e-3
    late = on_uniform_clock(shaken, signal(T))[1]
    assert np.array_equal(late, signal(T))


def turning(n=800, dt=0.01, seed=0):
    """Angles and rates of a motion below 2 Hz with their noise, and the true derivatives."""
    t = dt * np.arange(n)
    w, phase = 2 * np.pi * np.array([0.3, 0.9, 1.7]), np.array([0.2, 1.0, 2.5])
    angle = w * t[:, None] + phase
    x, v, a = np.sin(angle), w * np.cos(angle), -(w**2) * np.sin(angle)
    rng = np.random.default_rng(seed)
    noise = [SensorNoiseModel(np.full(3, s), np.zeros(3)) for s in (2e-4, 2e-3)]
    noisy = [k + model.draw(rng, 1, n)[0] for k, model in zip((x, v), noise, strict=True)]
    return (x, v, a), noisy, noise, SpectralWindow(n, dt, 12.0, margin(dt, 12.0))


def test_measured_rates_take_noise_off_derivatives():
    truth, (x, v), noise, window = turning()
    crossover = rate_crossover(x, v, *noise, window)
    np.testing.assert_allclose(crossover, 10.0)  # rad/s: 2e-3 over 2e-4
    plain = differentiated(x, window.dt, window.top)
    both = differentiated_with_rates(x, v, window.dt, window.top, crossover)
    inner = slice(window.skip, -window.skip)
    off = [
        [np.std((found - true)[inner]) for found, true in zip(way, truth, strict=True)]
        for way in (plain, both)
    ]
    assert off[1][0] < 0.7 * off[0][0]
    assert off[1][1] < 0.25 * off[0][1]
    assert off[1][2] < 0.15 * off[0][2]


def test_rates_without_noise_change_nothing():
    truth, _, _, window = turning()
    x, v, _ = truth
    ahead = 0.004
    plain = differentiated(x, window.dt, window.top, ahead)
    both = differentiated_with_rates(x, v, window.dt, window.top, np.full(3, 10.0), ahead)
    inner = slice(2 * window.skip, -2 * window.skip)
    for a, b in zip(plain, both, strict=True):
        np.testing.assert_allclose(a[inner], b[inner], atol=1e-3 * np.abs(a).max())
    unused = differentiated_with_rates(x, v, window.dt, window.top, np.full(3, np.inf))
    for a, b in zip(differentiated(x, window.dt, window.top), unused, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("wrong", ["late", "larger"])
def test_rates_that_disagree_are_not_used(wrong):
    truth, (x, v), noise, window = turning()
    changed = v + 5e-3 * truth[2] if wrong == "late" else 1.005 * v
    v = np.column_stack([v[:, 0], changed[:, 1], v[:, 2]])
    assert np.isfinite(rate_crossover(x, v, *noise, window)).tolist() == [True, False, True]
