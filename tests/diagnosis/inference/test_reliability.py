"""How often a name is right: the constants are those of the names counted, and they hold."""

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from benchmarks.reliability import calibration_error, constants, left_out, read_names
from benchmarks.trial2.scoring import in_place
from ves_gym.diagnosis.inference.reliability import DOUBT, EVEN, GAIN, STRAIN, reliability
from ves_gym.diagnosis.inference.unknown import NONE_OF_THESE, NOTHING, doubting

DOCS = Path(__file__).parents[3] / "docs"
COUNTED = DOCS / "diagnosis-reliability.jsonl"


def test_constants_are_those_of_the_names_counted():
    found = constants(read_names(COUNTED))
    np.testing.assert_allclose((EVEN, GAIN, STRAIN), found, atol=0.06)


@pytest.mark.parametrize("sets", [False, True], ids=["cases", "sets"])
def test_probabilities_of_what_is_left_out_are_calibrated_better_than_without(sets):
    """Ten ranges, as trial 2 counts."""
    names = read_names(COUNTED)
    right = np.array([n["right"] for n in names], float)
    before = np.array([n["library"] for n in names])
    now = before * left_out(names, sets)
    print(calibration_error(before, right), calibration_error(now, right), len(right))
    assert calibration_error(now, right) < 0.03 < 0.04 < calibration_error(before, right)
    sure = right[now > 0.95]
    assert len(sure) > 190 and sure.mean() > 0.97
    assert right[now > 0.99].mean() > 0.97


def test_names_of_a_sealed_set_are_as_probable_as_they_say():
    """The third of trial 2, answered by the sealed code, whose constants are of the second."""
    found = answers_of("set-03")
    p, reliable, right = np.array(
        [
            (
                n["probability"],
                n["reliability"],
                any(in_place(t, n) for t in label["effects"]),
            )
            for label in found["labels"]
            for n in found["answers"][f"{label['index']:03d}"].get("names") or []
        ],
        float,
    ).T
    assert len(p) == 18
    rng = np.random.default_rng(0)  # what probabilities that are exact would have
    exact = [calibration_error(p, (rng.random(len(p)) < p).astype(float)) for _ in range(2000)]
    assert calibration_error(p, right) <= np.quantile(exact, 0.95)
    assert np.mean((p - right) ** 2) < 0.2
    assert right[p > 0.5].mean() > 0.8 > 0.3 > right[p <= 0.5].mean()
    without = p / reliable
    assert calibration_error(without, right) > 0.45 and np.mean((without - right) ** 2) > 0.4
    assert right[without > 0.99].mean() < 0.7


@pytest.mark.parametrize("strained", [5.0, 50.0])
def test_more_gain_and_less_strain_are_more_reliable(strained):
    shares = [reliability(gain, strained) for gain in (0.0, 35.0, 100.0, 1e3, 1e5)]
    assert sorted(shares) == shares and shares[0] > 0 and shares[-1] < 1
    assert reliability(100.0, strained) > reliability(100.0, 2 * strained)


def answers_of(folder):
    """Labels and answers of a sealed set."""
    return json.loads((DOCS / "trial2" / folder / "answers.json").read_text("utf-8"))


def told_of(number):
    """Probabilities of the names of a sealed set, which are right, errors of calibration that
    exact probabilities would have, names withheld that are right, and alarms among nulls."""
    found = answers_of(f"set-{number:02d}")
    given, withheld, alarms = [], [], 0
    for label in found["labels"]:
        answer = found["answers"][f"{label['index']:03d}"]
        truth, names = label["effects"], answer.get("names") or []
        given += [(n["probability"], any(in_place(t, n) for t in truth)) for n in names]
        withheld += [any(in_place(t, n) for t in truth) for n in answer["withheld"]]
        alarms += bool(names) and label["category"] == "null"
    p, right = np.array(given, float).T
    rng = np.random.default_rng(0)
    exact = [calibration_error(p, (rng.random(len(p)) < p).astype(float)) for _ in range(2000)]
    return p, right, exact, withheld, alarms


def test_names_of_the_fourth_set_can_be_believed():
    """Of the diagnosis that withholds names below one half, by its sealed code."""
    p, right, exact, withheld, alarms = told_of(4)
    assert (len(p), right.sum(), alarms) == (37, 30, 0)
    assert 0.05 < np.quantile(exact, 0.05) < calibration_error(p, right) < np.median(exact)
    assert right[p > 0.95].all() and (p > 0.95).sum() == 14
    assert (p <= 0.95).sum() == 23 and p[p <= 0.95].sum() == pytest.approx(15.8, abs=0.05)
    assert (len(withheld), sum(withheld)) == (18, 7)


def test_names_of_the_fifth_set_are_about_as_probable_as_they_say():
    """Of the diagnosis that uses measured rates, by its sealed code."""
    p, right, exact, _, alarms = told_of(5)
    low, high = np.quantile(exact, (0.05, 0.95))
    assert (len(p), right.sum(), alarms) == (20, 15, 0)
    assert low < calibration_error(p, right) < high
    assert (right[p > 0.95].sum(), (p > 0.95).sum()) == (9, 10)


@pytest.mark.parametrize(
    ("number", "counts", "most", "above", "held"),
    [
        (6, (35, 32, 0), 0.5, (15, 15), (7, 1)),
        (7, (43, 40, 1), 0.5, (27, 28), (1, 1)),
        (8, (43, 41, 0), 0.5, (31, 32), (4, 3)),
        (9, (55, 55, 0), 0.95, (35, 35), (4, 2)),
        (10, (53, 51, 0), 0.95, (25, 25), (2, 1)),
        (11, (35, 34, 0), 0.95, (22, 22), (0, 0)),
        (12, (23, 23, 0), 0.95, (12, 12), (1, 1)),
        (13, (26, 24, 0), 0.95, (15, 16), (0, 0)),
        (14, (38, 36, 0), 0.95, (31, 32), (0, 0)),
        (15, (15, 13, 0), 0.98, (11, 12), (2, 1)),
        (16, (30, 30, 0), 0.95, (21, 21), (0, 0)),
        (17, (35, 34, 0), 0.98, (25, 25), (2, 1)),
    ],
)
def test_names_of_later_sets_can_be_believed(number, counts, most, above, held):
    """By the code sealed with each.

    Names, right ones and alarms; right of those above 0.95, and those; withheld, and right ones
    of these. `most` is a quantile of the error that exact probabilities would have.
    """
    p, right, exact, withheld, alarms = told_of(number)
    assert (len(p), right.sum(), alarms) == counts
    low, high = np.quantile(exact, (0.05, most))
    assert low <= calibration_error(p, right) < high
    assert (right[p > 0.95].sum(), (p > 0.95).sum()) == above
    assert (len(withheld), sum(withheld)) == held


@cache
def categories_of(folder):
    """Category of each case of a set, by number."""
    found = answers_of(folder)
    return {k["index"]: k["category"] for k in found["labels"]}


def test_what_names_are_not_trusted_with_goes_to_none_of_these():
    believed = {NOTHING: 0.1, "a + c": 0.5, "b + c": 0.2, NONE_OF_THESE: 0.2}
    found = doubting(believed, 0.6)
    assert found == pytest.approx(
        {NOTHING: 0.1, "a + c": 0.3, "b + c": 0.12, NONE_OF_THESE: 0.48}
    )
    assert doubting(believed, 1.0) == pytest.approx(believed)


def test_names_given_are_mostly_right_and_none_is_an_alarm():
    """Of the names counted, by constants from all other cases; two of nulls are doubtful."""
    names = read_names(COUNTED)
    right = np.array([n["right"] for n in names])
    withheld = left_out(names) < DOUBT
    assert (right & withheld).sum() <= 5 < 252 == right.sum()
    assert right[~withheld].mean() > 0.95 > 0.7 > right[withheld].mean()
    cases = [n["case"].split("/") for n in names]
    nulls = [categories_of(folder)[int(number)] == "null" for folder, number in cases]
    assert sum(nulls) == 2
    library = np.array([n["library"] for n in names])
    assert (library * left_out(names))[nulls].max() < DOUBT
