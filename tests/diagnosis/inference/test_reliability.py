"""How often a name is right: the constants are those of the names counted, and they hold."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.reliability import constants, left_out, read_names
from ves_gym.diagnosis.inference.reliability import EVEN, GAIN, STRETCH, reliability
from ves_gym.diagnosis.inference.unknown import NONE_OF_THESE, NOTHING, doubting

COUNTED = Path(__file__).parents[3] / "docs" / "diagnosis-reliability.jsonl"


def test_constants_are_those_of_the_names_counted():
    found = constants(read_names(COUNTED))
    np.testing.assert_allclose((EVEN, GAIN, STRETCH), found, atol=0.06)


def test_probabilities_of_cases_left_out_are_calibrated_better_than_without():
    """Ten ranges, as trial 2 counts; names given with the whole library."""
    names = read_names(COUNTED)
    usual = np.array([not n["hidden"] for n in names])
    right = np.array([n["right"] for n in names], float)

    def error(p):
        at = np.minimum((10 * p).astype(int), 9)
        off = [abs((p - right)[usual & (at == k)].sum()) for k in range(10)]
        return sum(off) / usual.sum()

    before, now = np.array([n["library"] for n in names]), left_out(names)
    print(error(before), error(now), usual.sum())
    assert error(now) < 0.15 < 0.3 < error(before)
    sure = right[usual & (now > 0.95)]
    assert len(sure) > 5 and sure.mean() > 0.97


@pytest.mark.parametrize("error", [1.0, 3.0])
def test_more_gain_and_smaller_errors_are_more_reliable(error):
    shares = [reliability(gain, error) for gain in (0.0, 35.0, 100.0, 1e3, 1e5)]
    assert sorted(shares) == shares and shares[0] > 0 and shares[-1] < 1
    assert reliability(100.0, error) > reliability(100.0, error + 1)


def test_what_names_are_not_trusted_with_goes_to_none_of_these():
    believed = {NOTHING: 0.1, "a + c": 0.5, "b + c": 0.2, NONE_OF_THESE: 0.2}
    found = doubting(believed, 0.6)
    assert found == pytest.approx(
        {NOTHING: 0.1, "a + c": 0.3, "b + c": 0.12, NONE_OF_THESE: 0.48}
    )
    assert doubting(believed, 1.0) == pytest.approx(believed)
