"""`ves-gym sweep`, `search` and `merge`."""

import json

import pytest

SPEC = """
[[evaluate]]
envs = ["BeamLQR-v0"]
policies = ["zero", "high"]
episodes = 2
"""
SEARCH = """
[search]
trials = 2
batch = 2
objective = "E_mean"
space = { "evaluate.0.settings.shift" = { low = 1e-3, high = 4e-3 } }
"""


@pytest.fixture
def file(tmp_path):
    def write(text=SPEC):
        path = tmp_path / "spec.toml"
        path.write_text(text)
        return path

    return write


def test_sweeps_and_goes_on(call, file, tmp_path):
    status, out, err, result = call("sweep", file(), "--workers", 1)
    assert (status, err) == (0, "") and "2 units done, 0 were done before, 0 failed" in out
    assert result["schema"] == "ves-sweep/1" and len(result["done"]) == 2
    rows = (tmp_path / "out" / "rows.jsonl").read_text().splitlines()
    assert len(rows) == result["rows"] == 4

    status, out, _, result = call("sweep", file(), "--workers", 1)
    assert status == 0 and "0 units done, 2 were done before" in out and result["done"] == []

    folder = tmp_path / "out"
    status, out, _, result = call("merge", folder, folder)
    assert status == 0 and result["units"] == 2 and result["rows"] == {"evaluate": 4}
    assert (folder / "rows.jsonl").read_text().splitlines() == rows


def test_a_unit_that_fails_is_a_negative_verdict(call, file, tmp_path):
    text = SPEC.replace('"high"', '"resolved"')
    status, out, err, result = call("sweep", file(text), "--workers", 1)
    assert status == 1 and "1 units done" in out and "failed: evaluate" in err
    assert len(result["failed"]) == 1 and len(result["done"]) == 1
    (failure,) = (tmp_path / "out" / "failed").iterdir()
    assert json.loads(failure.read_text())["id"] == failure.stem


def test_searches(call, file):
    pytest.importorskip("optuna")
    status, out, err, result = call("search", file(SPEC + SEARCH), "--workers", 1)
    assert (status, err) == (0, "") and "2 of 2 trials complete" in out and "shift" in out
    assert result["schema"] == "ves-search/1" and len(result["trials"]) == 2
    assert result["best"]["value"] == min(t["value"] for t in result["trials"])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("sweep", "nothing.toml"), "cannot be read"),
        (("sweep", "{}", "--workers", "0"), "workers must be >= 1"),
        (("sweep", "{}", "--part", "3/2"), "part must be k of n"),
        (("sweep", "{}", "--part", "half"), "--part must be K/N"),
        (("search", "{}"), "expected a table [search]"),
        (("merge", "nowhere"), "expected the folder of a sweep"),
    ],
)
def test_bad_input_is_one_line(refused, file, words, message):
    path = str(file())
    assert message in refused(*(word.format(path) for word in words))
