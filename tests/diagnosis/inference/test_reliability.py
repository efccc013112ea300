"""How often a name is right: the constants are those of the names counted, and they hold."""

import numpy as np
import pytest

from benchmarks.trial import reliability as counted
from benchmarks.trial.reliability import constants, left_out, read_names
from benchmarks.trial.targets import calibration_error
from ves_gym.diagnosis.inference.reliability import (
    DOUBT,
    EVEN,
    GAIN,
    NEEDED,
    STRAIN,
    USUAL,
    reliability,
)
from ves_gym.diagnosis.inference.unknown import NONE_OF_THESE, NOTHING, doubting


def test_constants_are_those_of_the_names_counted():
    assert (counted.NEEDED, counted.USUAL) == (NEEDED, USUAL)
    np.testing.assert_allclose((EVEN, GAIN, STRAIN), constants(read_names()), atol=0.06)


@pytest.mark.parametrize("sets", [False, True], ids=["cases", "sets"])
def test_probabilities_of_what_is_left_out_are_calibrated_better_than_without(sets):
    """Ten ranges, as the trial counts."""
    names = read_names()
    right, before = names["right"], names["library"]
    now = before * left_out(names, sets)
    print(calibration_error(before, right), calibration_error(now, right), len(right))
    assert calibration_error(now, right) < 0.03 < 0.04 < calibration_error(before, right)
    sure = right[now > 0.95]
    assert len(sure) > 190 and sure.mean() > 0.97
    assert right[now > 0.99].mean() > 0.97


@pytest.mark.parametrize("strained", [5.0, 50.0])
def test_more_gain_and_less_strain_are_more_reliable(strained):
    shares = [reliability(gain, strained) for gain in (0.0, 35.0, 100.0, 1e3, 1e5)]
    assert sorted(shares) == shares and shares[0] > 0 and shares[-1] < 1
    assert reliability(100.0, strained) > reliability(100.0, 2 * strained)


def test_what_names_are_not_trusted_with_goes_to_none_of_these():
    believed = {NOTHING: 0.1, "a + c": 0.5, "b + c": 0.2, NONE_OF_THESE: 0.2}
    found = doubting(believed, 0.6)
    assert found == pytest.approx(
        {NOTHING: 0.1, "a + c": 0.3, "b + c": 0.12, NONE_OF_THESE: 0.48}
    )
    assert doubting(believed, 1.0) == pytest.approx(believed)


def test_names_given_are_mostly_right():
    """Of the names counted, by constants from all other cases."""
    names = read_names()
    right = names["right"] == 1
    withheld = left_out(names) < DOUBT
    assert (right & withheld).sum() <= 5 < 252 == right.sum()
    assert right[~withheld].mean() > 0.95 > 0.7 > right[withheld].mean()
