"""`ves-gym diagnose-benchmark`: scores, a page, or one line."""

import pytest

pytest.importorskip("numba")

from ves_gym.diagnosis.benchmark import run
from ves_gym.diagnosis.benchmark.score import METHODS


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["--set", "secret"], "set must be one of development, sealed, got 'secret'"),
        (["--set", "sealed"], "the sealed set needs a salt"),
        (["--set", "sealed", "--salt", "nowhere.txt"], "nowhere.txt: cannot be read"),
        (["--salt", "nowhere.txt"], "the development set is public and takes no salt"),
        (["--cases", "few"], "--cases must be N or A:B with 0 <= A < B, got 'few'"),
        (["--cases", "5:5"], "--cases must be N or A:B with 0 <= A < B, got '5:5'"),
        (["--cases", "590:601"], "cases must be of 0 to 599, got 600"),
        (["--cases", "0"], "cases must be 1 to 600 in number, got 0"),
        (["--cases", "2", "--quick"], "not allowed with argument"),
        (["--workers", "0"], "--workers must be >= 1, got 0"),
    ],
)
def test_bad_input_is_one_line(refused, words, why):
    assert why in refused("diagnose-benchmark", *words)


def test_scores_are_printed_and_written(call, tmp_path, monkeypatch):
    label = {"index": 0, "category": "null", "variant": "", "effects": []}
    known = {
        "index": 0,
        "verdict": "nothing missing",
        "effects": [],
        "final": [],
        "seconds": {"total": 3.0},
        "baselines": {key: [] for key in METHODS[1:]},
    }
    monkeypatch.setattr(run, "run_benchmark", lambda *a: None)
    monkeypatch.setattr(run, "read_truth", lambda t: [label])
    monkeypatch.setattr(run, "read_answers", lambda t: [known])
    page = tmp_path / "results.md"
    status, out, err, result = call("diagnose-benchmark", "--cases", "0:1", "--docs", page)
    assert (status, err) == (0, "")
    assert result["schema"] == "ves-diagnose-benchmark/1" and result["cases"] == [0]
    assert result["command"] == "ves-gym diagnose-benchmark --set development --cases 0:1"
    assert page.read_text() == out == (tmp_path / "out" / "scores.md").read_text()
    assert "| null: false alarm | 0.0 % | 0.0 % to 95.0 % | 1 | <= 0.8 % | yes |" in out
