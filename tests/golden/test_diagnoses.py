"""The diagnosis answers as it did when its answers were frozen (`benchmarks/trial/frozen.py`).

Of 24 cases of every kind the quickest are answered again here, some 20 s each; all of them:
`python -m benchmarks.trial check` (`check 16-032`: one).
"""

import pytest

from benchmarks.trial.frozen import check, differences, labelled, stored

CASES = stored()["cases"]
QUICKEST = sorted(CASES, key=lambda name: CASES[name]["cpu"])[:10]


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


def test_cases_of_every_kind_are_stored():
    labels = [label for label, _ in labelled()]
    for category in ("null", "single", "pair", "outside"):
        modes = {a["mode"] for a in labels if a["category"] == category}
        assert modes == {"ideal", "emulated"}
