"""Searches: their trials depend on the file alone."""

import json
import math

import pytest

pytest.importorskip("optuna")

import optuna

from ves_gym._util.params import ParameterError
from ves_gym.experiments.search import Axis, search

PLAIN = """
[[evaluate]]
envs = ["BeamLQR-v0"]
policies = ["zero"]
episodes = 1

[search]
trials = {trials}
objective = "E_mean"
direction = "minimize"
sampler = "{sampler}"
batch = 2

[search.space]
"evaluate.0.settings.shift" = {{ low = 1e-3, high = 4e-3 }}
"evaluate.0.policies" = {{ choices = [["zero"], ["random"]] }}
"""


@pytest.fixture
def file(tmp_path):
    def write(trials=4, sampler="tpe", text=PLAIN):
        path = tmp_path / "search.toml"
        path.write_text(text.format(trials=trials, sampler=sampler))
        return path

    return write


def params(result):
    return [t["params"] for t in result.trials if t["state"] == "complete"]


# ---------------------------------------------------------------------------- searching


def test_the_best_of_all_trials(here, file, tmp_path):
    fractions = []
    result = search(
        file(),
        tmp_path / "out",
        workers=here,
        progress=lambda stage, done: fractions.append(round(done, 2)),
    )
    assert [t["state"] for t in result.trials] == ["complete"] * 4
    assert result.best["value"] == min(t["value"] for t in result.trials)
    for t in result.trials:
        assert 1e-3 <= t["params"]["evaluate.0.settings.shift"] <= 4e-3
        (unit,) = t["units"]
        stored = json.loads((tmp_path / "out" / "results" / f"{unit}.json").read_text())
        assert stored["summary"]["E_mean"] == t["value"]
        chosen = t["params"]["evaluate.0.policies"]
        assert [stored["unit"]["who"]] == json.loads(chosen)
    assert fractions == [0.0, 0.5, 1.0]

    again = search(file(), tmp_path / "out", workers=here)
    assert again == result  # nothing is left to do
    assert len(search(file(trials=5), tmp_path / "out", workers=here).trials) == 5


@pytest.mark.parametrize("sampler", ["tpe", "random"])
def test_seeds_decide(here, file, tmp_path, sampler):
    path = file(sampler=sampler)
    one, two, other = (
        search(path, tmp_path / name, workers=here, seed=seed)
        for name, seed in (("one", 0), ("two", 0), ("other", 1))
    )
    assert one.trials == two.trials
    assert params(one) != params(other)


def test_settings_that_do_not_work_are_failed_trials(here, file, tmp_path):
    text = PLAIN.replace("low = 1e-3", "low = -4e-3").replace("high = 4e-3", "high = 1e-3")
    result = search(file(trials=3, text=text), tmp_path / "out", workers=here)
    assert result.best is None or result.best["value"] >= 0
    failed = [t for t in result.trials if t["state"] == "fail"]
    assert failed and all(t["why"] for t in failed)
    assert len(result.trials) == 3


def test_a_search_begun_again_comes_to_the_same_trials(here, file, tmp_path):
    """And does only the units that have no result yet."""
    whole = search(file(trials=6), tmp_path / "out", workers=here)
    results = tmp_path / "out" / "results"
    lost = {id for t in whole.trials[3:] for id in t["units"]} - {
        id for t in whole.trials[:3] for id in t["units"]
    }
    for id in lost:
        (results / f"{id}.json").unlink()
    kept = {path: path.stat().st_mtime_ns for path in results.iterdir()}
    assert search(file(trials=6), tmp_path / "out", workers=here) == whole
    assert {path: path.stat().st_mtime_ns for path in kept} == kept


# ------------------------------------------------------------------------------ bad input


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[search]", "[other]", "missing key 'trials'"),
        (PLAIN.partition("[search]")[2], "", "missing key"),
        (f"[search]{PLAIN.partition('[search]')[2]}", "", r"expected a table \[search\]"),
        ('"minimize"', '"down"', "direction must be one of"),
        ('"{sampler}"', '"grid"', "sampler must be one of"),
        ("batch = 2", "batch = 0", "batch must be >= 1"),
        ("batch = 2", "speed = 2", "unknown key 'speed'"),
        ("low = 1e-3, high = 4e-3", "low = 4e-3, high = 1e-3", "low < high"),
        ("low = 1e-3, ", "", "needs low and high, or choices"),
        ("low = 1e-3, high = 4e-3", "low = 0.0, high = 2.0, log = true", "low > 0"),
        ("evaluate.0.policies", "evaluate.3.policies", "leads to no entry"),
        ("evaluate.0.policies", "evaluate.0.speed", "unknown key 'speed'"),
    ],
)
def test_a_bad_file_is_refused(here, file, tmp_path, old, new, message):
    assert old in PLAIN
    with pytest.raises(ParameterError, match=message):
        search(file(text=PLAIN.replace(old, new, 1)), tmp_path / "out", workers=here)
    assert not (tmp_path / "out").exists()


def test_an_unknown_objective_names_the_known(here, file, tmp_path):
    with pytest.raises(ParameterError, match="objective must be one of E_int, E_mean"):
        search(file(text=PLAIN.replace("E_mean", "speed")), tmp_path / "out", workers=here)


def test_axes_draw_what_they_say():
    trial = optuna.create_study(sampler=optuna.samplers.RandomSampler(seed=0)).ask()
    x = Axis(low=1e-4, high=1e-2, log=True).draw(trial, "x")
    assert 1e-4 <= x <= 1e-2
    n = Axis(low=2, high=4, integer=True).draw(trial, "n")
    assert n in (2, 3, 4) and isinstance(n, int)
    assert Axis(choices=([1, 2], "a", None)).draw(trial, "c") in ([1, 2], "a", None)
    assert math.isclose(trial.params["x"], x)
