"""Gaps over time and their intervals, against what is known of noise."""

import numpy as np
import pytest

from ves_gym.diagnosis.data.measured_run import run_of_signals
from ves_gym.diagnosis.inference.intervals import intervals, stretches
from ves_gym.diagnosis.inference.whitened_residuals import WhitenedResiduals
from ves_gym.diagnosis.machines.joint_library import MjcfJoint
from ves_gym.diagnosis.machines.mjcf import MjcfMachine


def test_intervals_of_a_size_cover_it():
    """20 stretches of 50 numbers, as of two logs of 10 s."""
    rng, inside, times = np.random.default_rng(0), [], 300
    for _ in range(times):
        before, after = 9 * rng.chisquare(50, 20), rng.chisquare(50, 20)
        found = intervals(1000, [before, after])
        inside.append([a < x < b for (a, b), x in zip(found, (3.0, 1.0, 1 / 3), strict=True)])
    assert np.mean(inside, axis=0) == pytest.approx(0.94, abs=0.035)


def test_a_burst_is_found_when_it_happens_and_nothing_is_lost():
    """A rate that is wrong for a second, from 12 s on, in the second of two runs."""
    rng, t = np.random.default_rng(1), np.arange(4000) * 5e-3
    runs = []
    for late in (False, True):
        q = np.sin(2 * t)[:, None] + 1e-6 * rng.standard_normal((4000, 1))
        v = 2 * np.cos(2 * t)[:, None] + 1e-3 * rng.standard_normal((4000, 1))
        if late:
            v[2400:2600] += 0.05
        runs.append(run_of_signals(t, {"q": q, "v": v}, f"run {late}"))
    residuals = WhitenedResiduals(MjcfMachine("one", [MjcfJoint("a")]), runs)
    first, second = stretches(residuals, residuals.groups, residuals.null)
    total = sum(float(np.sum(residuals.null[g.part] ** 2)) for g in residuals.groups)
    assert first.sum() + second.sum() == pytest.approx(total)
    step = (runs[1].length - 2 * runs[1].window.skip) * runs[1].dt / len(second)
    loudest = runs[1].window.skip * runs[1].dt + (np.argmax(second) + 0.5) * step
    assert loudest == pytest.approx(12.5, abs=1.0)
    assert second.max() > 20 * np.median(second) > 0
