"""Intervals against closed forms and their own promise: 95 of 100 hold the truth."""

import numpy as np
import pytest

from ves_gym._util.statistics import STATISTICS, bootstrap, iqm, rate


def test_interval_of_the_mean_is_that_of_statistics():
    """Reference: 1.96 standard errors; tolerance: of 2000 resamples."""
    x = np.random.default_rng(0).normal(2.0, 3.0, 400)
    e = bootstrap([x], STATISTICS["mean"])
    assert e.value == x.mean()
    half = 1.96 * x.std() / 20
    assert e.low == pytest.approx(x.mean() - half, abs=0.03)
    assert e.high == pytest.approx(x.mean() + half, abs=0.03)
    assert bootstrap([x], STATISTICS["mean"]) == e


def test_what_lies_between_strata_is_not_sampled():
    """Strata 0, 10, 20 with noise 1 within: the standard error is 1 / sqrt(n), not 8 / sqrt(n).

    The interval of the same values without strata is 8.2 times as wide.
    """
    rng = np.random.default_rng(1)
    strata = [rng.normal(10.0 * k, 1.0, 100) for k in range(3)]
    e = bootstrap(strata, STATISTICS["mean"])
    assert e.high - e.low == pytest.approx(2 * 1.96 / np.sqrt(300), rel=0.1)
    loose = bootstrap([np.concatenate(strata)], STATISTICS["mean"])
    wide = 2 * 1.96 * np.sqrt((200 / 3 + 1) / 300)  # variance between strata plus within
    assert loose.high - loose.low == pytest.approx(wide, rel=0.1)


@pytest.mark.parametrize(
    "name", ["iqm", *(pytest.param(k, marks=pytest.mark.slow) for k in ("mean", "median"))]
)
def test_the_interval_holds_the_truth_as_often_as_it_says(name):
    """200 samples of 100 from a normal distribution, whose centre is 0 for all three.

    Reference: 95 %; tolerance: three standard errors of 200 trials (4.6 %) and the
    percentile bootstrap's lack at 100 values (below 1 %).
    """
    rng = np.random.default_rng(7)
    found = [bootstrap([rng.normal(size=100)], STATISTICS[name]) for _ in range(200)]
    held = np.mean([e.low <= 0.0 <= e.high for e in found])
    assert 0.894 <= held <= 0.996


def test_what_belongs_together_is_drawn_together():
    """Five policies on the same 100 episodes, which differ more than the policies do.

    Reference: the mean's standard error is that of 100 episodes, not of 500 values, as the
    interval would have it that draws the policies' values one by one.
    """
    rng = np.random.default_rng(3)
    episodes = rng.normal(size=(100, 1))
    scores = episodes + 0.1 * rng.normal(size=(100, 5))
    together = bootstrap([scores], STATISTICS["mean"])
    half = 1.96 * scores.mean(axis=1).std() / np.sqrt(100)
    assert together.high - together.low == pytest.approx(2 * half, rel=0.06)
    apart = bootstrap(list(scores.T), STATISTICS["mean"])
    assert apart.high - apart.low < 0.5 * (together.high - together.low)


def test_interquartile_mean_is_that_of_the_middle_half():
    assert iqm(np.array([100.0, 1, 2, 3, 4, 5, 6, -100])) == 3.5


def test_a_quarter_of_failures_leaves_a_number_and_one_more_does_not():
    x = np.arange(8.0)
    x[6:] = np.inf
    assert iqm(x) == 3.5
    x[5] = np.inf
    assert iqm(x) == np.inf
    e = bootstrap([np.r_[np.ones(80), np.full(20, np.inf)]], iqm)
    assert (e.value, e.low, e.high) == (1.0, 1.0, np.inf)


def test_wilson_interval():
    """Reference: 8 of 10, Brown, Cai, DasGupta, Statistical Science 16(2), 2001: 0.49-0.943."""
    e = rate(np.array([True] * 8 + [False] * 2))
    assert e.low == pytest.approx(0.490, abs=5e-4) and e.high == pytest.approx(0.943, abs=5e-4)
    assert rate(np.ones(100, bool)).low == pytest.approx(0.963, abs=1e-3)
    five = np.repeat(np.array([True] * 8 + [False] * 2)[:, None], 5, axis=1)
    assert rate(five) == rate(five.mean(axis=1)) == e
