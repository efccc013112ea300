"""The force sensor: frame, filter, errors, zero and calibration, each against a formula."""

import numpy as np
import pytest
import scipy.signal

from tests.running_blocks import RunningSensor
from ves_gym._util.params import ParameterError
from ves_gym.hardware.force_sensor import ForceSensor, SensorErrors, low_pass
from ves_gym.mechanics.link import matrix

NODES = np.arange(11) * 1.25e-3
DT = float(NODES[-1])
WRENCH = np.array([30.0, -20.0, -900.0, 40.0, -150.0, 12.0])


def generators(n, seed=0):
    return [np.random.default_rng((seed, i)) for i in range(n)]


def at_rest(sensor=None, n=1, nodes=NODES, wrench=WRENCH, **errors):
    """A sensor at rest under a wrench, with some errors, and its generators."""
    sensor = sensor or ForceSensor()
    given = SensorErrors.none(sensor, n)
    for name, value in errors.items():
        setattr(given, name, np.broadcast_to(value, getattr(given, name).shape).copy())
    runtime, rng = RunningSensor(sensor, given, nodes), generators(n)
    runtime.reset(np.arange(n), np.broadcast_to(wrench, (n, 6)), rng)
    return runtime, rng


# ---------------------------------------------------------------------------- frame


def test_the_frame_is_that_of_appendix_d_with_the_sign_corrected():
    """Platform wrench from sensor wrench, written out (docs/errata.md: M_z has -Fx y_o)."""
    sensor = ForceSensor(offset=(0.02, -0.03, 0.19))
    x, y, z = sensor.offset
    Fx, Fy, Fz, Mx, My, Mz = seen = np.array([3.0, -5.0, 7.0, 11.0, 13.0, -17.0])
    platform = np.array(
        [
            Fx,
            -Fy,
            -Fz,
            Mx + Fy * z - Fz * y,
            -My + Fx * z + Fz * x,
            -Mz - Fy * x - Fx * y,
        ]
    )
    np.testing.assert_allclose(sensor.frame @ platform, seen, rtol=1e-14)


def test_without_errors_a_constant_wrench_is_read_exactly():
    """Whatever the frame and the filter; tolerance: rounding of its inverse."""
    runtime, rng = at_rest(n=2)
    for _ in range(3):
        np.testing.assert_allclose(runtime.reading(), np.tile(WRENCH, (2, 1)), rtol=1e-12)
        runtime.advance(np.broadcast_to(WRENCH, (2, 11, 6)), rng)


# --------------------------------------------------------------------------- filter


def filtered(cutoff, state, nodes):
    """State (n, 6, 2) after one period."""
    hold, weights = low_pass(cutoff, NODES)
    return state @ np.swapaxes(hold, -1, -2) + np.swapaxes(weights @ nodes, -1, -2)


def test_the_filter_is_a_butterworth_exact_for_piecewise_linear_inputs():
    """Against scipy.signal.lsim, which is exact for these too; tolerance: rounding.

    A batch with three cut-offs, two of them alike.
    """
    cutoff = np.array([20.0, 5.0, 20.0])
    periods = 30
    rng = np.random.default_rng(0)
    t = np.arange(10 * periods + 1) * 1.25e-3
    u = rng.normal(size=(3, len(t), 6))
    state = np.zeros((3, 6, 2))
    for i in range(3):
        b, a = scipy.signal.butter(2, 2 * np.pi * cutoff[i], analog=True)
        for c in range(6):
            _, y, _ = scipy.signal.lsim((b, a), u[i, :, c], t)
            state[:] = 0
            for k in range(periods):
                state = filtered(cutoff, state, u[:, 10 * k : 10 * k + 11])
                assert state[i, c, 0] == pytest.approx(y[10 * (k + 1)], abs=1e-9)


def test_the_stated_lag_is_that_of_a_ramp():
    """sqrt(2) / w; tolerance: the transient of a 20 Hz filter after a second."""
    sensor = ForceSensor()
    cutoff, state = np.array([sensor.cutoff]), np.zeros((1, 6, 2))
    for k in range(80):
        state = filtered(cutoff, state, np.tile((k * DT + NODES)[:, None], (1, 1, 6)))
    np.testing.assert_allclose(80 * DT - state[..., 0], sensor.lag, rtol=1e-9)


# ---------------------------------------------------------------------------- noise


def test_noise_has_the_filters_spectrum():
    """White noise after a second-order Butterworth: its autocovariance
    exp(-a t) (cos a t + sin a t), a = w / sqrt(2), and hardly any power at ten times the
    cut-off (1e-4; aliasing at 1 kHz adds as much again).

    Six channels of 8 s, correlation time 8 ms: 3 % standard error.
    """
    nodes = np.array([0.0, 1e-3])
    runtime, rng = at_rest(nodes=nodes, wrench=0.0, noise=1.0)
    series = np.empty((8_000, 6))
    for k in range(len(series)):
        runtime.advance(np.zeros((1, 2, 6)), rng)
        series[k] = runtime.signal()[0]
    a = 2 * np.pi * 20.0 / np.sqrt(2)
    for lag in (0, 2, 5, 10, 20, 40):
        t = lag * 1e-3
        want = np.exp(-a * t) * (np.cos(a * t) + np.sin(a * t))
        assert np.mean(series[: len(series) - lag] * series[lag:]) == pytest.approx(
            want, abs=0.08
        )
    f, power = scipy.signal.welch(series, fs=1e3, nperseg=1000, axis=0)
    low = power[(f > 1) & (f < 8)].mean()
    assert power[np.abs(f - 200) < 10].mean() < 1e-3 * low
    assert power[np.abs(f - 20) < 1.5].mean() == pytest.approx(low / 2, rel=0.3)


def test_drift_starts_from_zero_and_reaches_its_deviation_over_its_time():
    """Gauss-Markov: deviation s sqrt(1 - exp(-2 t / T)), correlation exp(-dt / T).

    1200 series: 2 % standard error of a deviation, 0.03 of a correlation.
    """
    T, n = 0.5, 200
    runtime, rng = at_rest(n=n, wrench=0.0, drift=3.0, drift_time=T)
    assert (runtime.signal() == 0).all()
    series = []
    for _ in range(120):  # three times T
        runtime.advance(np.zeros((n, 11, 6)), rng)
        series.append(runtime.signal().ravel())
    t = np.arange(1, 121) * DT
    for k in (3, 19, 39, 119):
        want = 3.0 * np.sqrt(1 - np.exp(-2 * t[k] / T))
        assert np.std(series[k]) == pytest.approx(want, rel=0.08)
    correlation = np.corrcoef(series[79], series[119])[0, 1]
    assert correlation == pytest.approx(np.exp(-1), abs=0.1)
    runtime.reset(np.array([1]), np.zeros((1, 6)), rng)
    assert (runtime.signal()[1] == 0).all()
    assert (runtime.signal()[0] != 0).all()


# ------------------------------------------------- bias, cross-talk, quantisation, zero


def test_bias_and_cross_talk_act_on_the_signals():
    rng = np.random.default_rng(3)
    bias, error = rng.normal(size=6), rng.normal(size=(6, 6)) * 0.05
    sensor = ForceSensor()
    runtime, _ = at_rest(sensor, bias=bias, matrix=error)
    signal = (np.eye(6) + error) @ sensor.frame @ WRENCH + bias
    np.testing.assert_allclose(runtime.signal()[0], signal, rtol=1e-12)
    np.testing.assert_allclose(
        runtime.reading()[0], np.linalg.solve(sensor.frame, signal), rtol=1e-12
    )


def test_quantised_signals_are_the_nearest_multiples():
    sensor = ForceSensor(force_resolution=0.5, moment_resolution=0.25)
    runtime, _ = at_rest(sensor, n=50, wrench=np.random.default_rng(4).normal(size=(50, 6)) * 9)
    step = np.repeat([0.5, 0.25], 3)
    true = runtime.x["filter"][..., 0] @ sensor.frame.T
    signal = runtime.signal()
    np.testing.assert_array_equal(signal / step, np.round(signal / step))
    assert (np.abs(signal - true) <= step / 2 + 1e-12).all()
    assert (signal != true).all()
    # forces alone: the moments stay as they are
    half, _ = at_rest(ForceSensor(force_resolution=0.5))
    np.testing.assert_allclose(half.signal()[0, 3:], (sensor.frame @ WRENCH)[3:], rtol=1e-12)


def test_the_zero_can_be_set_so_that_any_wrench_is_read():
    """With bias, cross-talk, noise and a calibration matrix; only where it is asked for."""
    rng = np.random.default_rng(5)
    sensor = ForceSensor(calibration=matrix(np.eye(6) + 0.1 * rng.normal(size=(6, 6))))
    runtime, draws = at_rest(sensor, n=3, bias=2.0, matrix=0.01, noise=0.1)
    before = runtime.reading()
    wanted = rng.normal(size=(2, 6)) * 100
    runtime.zero_to(np.array([0, 2]), wanted)
    np.testing.assert_allclose(runtime.reading()[[0, 2]], wanted, rtol=1e-10)
    assert runtime.reading()[1].tobytes() == before[1].tobytes()
    runtime.reset(np.array([0]), np.tile(WRENCH, (1, 1)), draws)
    assert np.abs(runtime.reading()[0] - wanted[0]).max() > 1  # a reset forgets it


# ---------------------------------------------------------------------- calibration


def test_a_calibrated_sensor_reads_the_corrected_wrench():
    """reading -> C reading + offset; tolerance: rounding of two inverses of condition < 50."""
    rng = np.random.default_rng(6)
    sensor = ForceSensor(
        calibration=matrix(np.eye(6) + 0.1 * rng.normal(size=(6, 6))),
        zero=tuple(rng.normal(size=6).tolist()),
    )
    C, offset = np.eye(6) + 0.1 * rng.normal(size=(6, 6)), rng.normal(size=6) * 10
    corrected = sensor.calibrated(C, offset)
    for wrench in rng.normal(size=(5, 6)) * [100, 100, 900, 100, 100, 100]:
        raw = at_rest(sensor, wrench=wrench, bias=1.0, matrix=0.02)[0].reading()[0]
        got = at_rest(corrected, wrench=wrench, bias=1.0, matrix=0.02)[0].reading()[0]
        np.testing.assert_allclose(got, C @ raw + offset, rtol=0, atol=1e-9)


def test_bad_sensors_are_refused():
    singular = np.eye(6)
    singular[5] = singular[4]
    with pytest.raises(
        ParameterError, match=r"calibration must be invertible, got a condition"
    ):
        ForceSensor(calibration=matrix(singular))
    with pytest.raises(ParameterError, match=r"calibration must be invertible"):
        ForceSensor().calibrated(singular, np.zeros(6))
    with pytest.raises(ParameterError, match=r"C must have shape \(6, 6\)"):
        ForceSensor().calibrated(np.eye(3), np.zeros(6))
    with pytest.raises(ParameterError, match=r"offset must be finite"):
        ForceSensor().calibrated(np.eye(6), np.full(6, np.nan))
    for name, value, message in [
        ("cutoff", 0.0, "cutoff must be > 0 Hz, got 0.0"),
        ("moment_resolution", np.nan, "moment_resolution must be >= 0 N m, got nan"),
        ("offset", (0.0, 0.0), r"ForceSensor.offset must have shape \(3,\)"),
    ]:
        with pytest.raises(ParameterError, match=message):
            ForceSensor(**{name: value})
