"""The diagnosis answers as it did when its answers were frozen (`benchmarks/trial/frozen.py`).

Here are the quickest cases whose names have values and intervals, or that have no names, some
40 s each; all of them take hours: `python -m benchmarks.trial check` (`check 16-003`: one).
"""

import pytest

from benchmarks.trial.frozen import check, differences, labelled, stored
from benchmarks.trial.targets import targets

CASES = stored()["cases"]
WHOLE = [k for k, case in CASES.items() if all("value" in name for name in case["names"])]
QUICKEST = sorted(WHOLE, key=lambda name: CASES[name]["cpu"])[:14]


@pytest.mark.slow
@pytest.mark.parametrize("name", QUICKEST)
def test_a_case_is_answered_as_before(name):
    assert check(name) == []


def test_what_differs_is_told():
    then = {"names": [{"kind": "a", "value": {"x": 1.0}}], "gap": {"p/x": [1e-7, 2.0]}}
    now = {"names": [{"kind": "a", "value": {"x": 1.0 + 1e-9}}], "gap": {"p/x": [2e-7, 2.0]}}
    assert differences(then, {**now, "cpu": 1.0}) == []
    now["names"][0]["value"]["x"] = 1.0 + 1e-5
    now["gap"]["p/x"][1] = 2.1
    told = differences(then, now)
    assert [t.partition(":")[0] for t in told] == ["/names/0/value/x", "/gap/p/x/1"]
    assert differences(then, {**now, "names": []}) != []


def test_the_stored_answers_are_those_of_the_page():
    """Singles, pairs and nulls of both sets, as docs/diagnosis-trial.md has them."""
    rows = targets(labelled({"16": 43, "17": 48}))
    assert "named alone, kind and place | 26 of 29" in rows
    assert "both named, nothing else | 9 of 12" in rows
    assert "false alarms | 0 of 16" in rows
