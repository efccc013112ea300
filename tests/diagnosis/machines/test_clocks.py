"""Clocks of recorders that are not in step, and samples that jitter."""

import dataclasses

import numpy as np
import pytest

from ves_gym.diagnosis.data.measured_run import run_of_signals
from ves_gym.diagnosis.inference.fit import fit
from ves_gym.diagnosis.inference.tolerance_scale import likeliest_scale
from ves_gym.diagnosis.inference.whitened_residuals import WhitenedResiduals
from ves_gym.diagnosis.machines.clocks import ROBOT, ClockError, with_jitter
from ves_gym.diagnosis.machines.system import SystemMachine
from ves_gym.mechanics.motion import Motion
from ves_gym.simulation.playback import play_motions
from ves_gym.system.system import System

SYSTEM = System()
JITTER = 4e-4  # s
NOISE = {"q": 1e-5, "v": 2e-4, "tau": 0.05}


@pytest.fixture(scope="module")
def log():
    motion = Motion.straight(np.zeros(3), (0.6, 0.3, -0.4), duration=5.0)
    return play_motions(SYSTEM, [motion], settle=1.0).log(0)


def residuals_of(log, jitter, stated=JITTER):
    """Residuals at the joints of a log whose robot read it at instants that jitter [s]."""
    rng = np.random.default_rng(3)
    late = jitter * rng.standard_normal((len(log.t), 1))
    signals = {"q_cmd": log.q_cmd, "v_cmd": log.v_cmd, "y": log.y}
    for k, std in NOISE.items():
        x = getattr(log, k)
        rate = np.gradient(x, log.t, axis=0)
        signals[k] = x + late * rate + std * rng.standard_normal(x.shape)
    run = run_of_signals(log.t, signals, "run", meta={"noise_std": {**NOISE, "y": 1e-8}})
    machine = SystemMachine(SYSTEM)
    machine.ports = tuple(p for p in machine.ports if p.name in ("joint", "velocity"))
    return WhitenedResiduals(machine, [with_jitter(run, stated, emulated=False)])


def test_a_clock_that_is_late_is_put_right():
    """Closed form: a sine read 2 ms late, and 1 % too slow; of other runs nothing changes."""
    t = np.arange(400) * 0.0125
    x = np.sin(2 * t)[:, None] * np.ones(3)
    read = np.sin(2 * (1.001 * t + 2e-3))[:, None] * np.ones(3)
    run = run_of_signals(t, {"q": read, "y": x.repeat(2, axis=1)}, "run")
    error = ClockError("run", ROBOT, offset=2e-3, rate=1e-3)
    inside = slice(40, -40)
    np.testing.assert_allclose(error.undone(run)["q"][inside], x[inside], atol=1e-4)
    assert error.undone(run)["y"] is run["y"]
    other = dataclasses.replace(error, run="another")
    assert other.undone(run) is run


def test_jitter_is_common_to_the_signals_of_a_recorder():
    """Over its rate each signal has the same noise; what another recorder reads has its own."""
    t = np.arange(400) * 0.0125
    x = np.stack([np.sin(2 * t), np.cos(3 * t), t], axis=1)
    plain = run_of_signals(t, {"q": x, "v": 2 * x, "y": np.hstack([x, x])}, "run")
    run = with_jitter(plain, JITTER, emulated=False)
    drawn = run.with_noise(np.random.default_rng(0), 50, sensors=False)
    late = {k: (drawn[k] - run[k])[..., 2] / run.rate_of(k)[:, 2] for k in "qvy"}
    np.testing.assert_allclose(late["q"], late["v"], atol=1e-9)
    assert late["q"].std() == pytest.approx(JITTER, rel=0.02)
    assert abs(np.corrcoef(late["q"].ravel(), late["y"].ravel())[0, 1]) < 0.03
    none = plain.with_noise(np.random.default_rng(0), 2, sensors=False)
    assert all((none[k] == plain[k]).all() for k in "qvy")
    assert ("w",) not in with_jitter(plain, JITTER, emulated=True).jitter


def test_wider_jitter_whitens_as_if_it_had_been_stated(log):
    """Reference: residuals of the same log with three times the jitter stated."""
    wide = residuals_of(log, JITTER).with_tolerances(3.0)
    stated = residuals_of(log, JITTER, 3 * JITTER)
    at = stated.measured
    np.testing.assert_allclose(wide.null[at], stated.null[at], atol=1e-3)
    p = wide.shared
    np.testing.assert_allclose(wide.slopes[at, :p], 3 * stated.slopes[at, :p], atol=1e-2)
    assert wide.density == pytest.approx(stated.density, abs=0.1)
    exact = residuals_of(log, JITTER, 0.0)
    assert (exact.with_tolerances(3.0).null == exact.null).all()


@pytest.mark.parametrize(("times", "low", "high"), [(1.0, 1.0, 1.3), (4.0, 2.5, 5.0)])
def test_how_far_samples_jitter_is_told_with_the_tolerances(log, times, low, high):
    residuals = residuals_of(log, times * JITTER)
    assert low <= likeliest_scale(fit(residuals, (), ()), residuals) <= high
