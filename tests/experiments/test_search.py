"""Searches: seeded, resumable, and a journal that survives a torn line."""

import json
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("optuna")

import optuna

from tests.experiments.sweeps import wait_until
from ves_gym._util.params import ParameterError
from ves_gym.experiments import search as s
from ves_gym.experiments.search import Axis, open_journal, read_search, search

ROOT = Path(__file__).parents[2]
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


class Here:
    """Runs jobs at once in this process: what is tested is not where they run."""

    shares_files = True

    def __init__(self, **options):
        pass

    def submit(self, function, *args):
        from concurrent.futures import Future

        future = Future()
        try:
            future.set_result(function(*args))
        except Exception as error:
            future.set_exception(error)
        return future

    def __enter__(self):
        return self

    def __exit__(self, *error):
        pass


@pytest.fixture
def here(monkeypatch):
    monkeypatch.setattr(s, "open_executor", lambda name, **options: Here())


def params(found):
    return [t["params"] for t in found.trials if t["state"] == "complete"]


# ---------------------------------------------------------------------------- searching


def test_the_best_of_all_trials(here, file, tmp_path):
    told = []
    found = search(
        file(), tmp_path / "out", progress=lambda stage, done: told.append(round(done, 2))
    )
    assert [t["state"] for t in found.trials] == ["complete"] * 4
    assert found.best["value"] == min(t["value"] for t in found.trials)
    for t in found.trials:
        assert 1e-3 <= t["params"]["evaluate.0.settings.shift"] <= 4e-3
        (unit,) = t["units"]
        result = json.loads((tmp_path / "out" / "results" / f"{unit}.json").read_text())
        assert result["summary"]["E_mean"] == t["value"]
        chosen = t["params"]["evaluate.0.policies"]
        assert [result["unit"]["who"]] == json.loads(chosen)
    assert told == [0.0, 0.5, 1.0]

    again = search(file(), tmp_path / "out")
    assert again == found  # nothing is left to do
    assert len(search(file(trials=5), tmp_path / "out").trials) == 5


@pytest.mark.parametrize("sampler", ["tpe", "random"])
def test_seeds_decide(here, file, tmp_path, sampler):
    path = file(sampler=sampler)
    one, two, other = (
        search(path, tmp_path / name, seed=seed)
        for name, seed in (("one", 0), ("two", 0), ("other", 1))
    )
    assert one.trials == two.trials
    assert params(one) != params(other)


def test_settings_that_do_not_work_are_failed_trials(here, file, tmp_path):
    text = PLAIN.replace("low = 1e-3", "low = -4e-3").replace("high = 4e-3", "high = 1e-3")
    found = search(file(trials=3, text=text), tmp_path / "out")
    assert found.best is None or found.best["value"] >= 0
    failed = [t for t in found.trials if t["state"] == "fail"]
    assert failed and all(t["why"] for t in failed)
    assert len(found.trials) == 3


def test_a_search_that_died_ends_as_if_it_had_not(here, file, tmp_path, monkeypatch):
    whole = search(file(trials=6), tmp_path / "whole")
    run_units, calls = s.run_units, []

    def dying(pool, units, report, *rest):
        calls.append(units)
        if len(calls) == 2:
            run_units(pool, units[:1], report)  # half of the second batch
            raise KeyboardInterrupt
        run_units(pool, units, report, *rest)

    monkeypatch.setattr(s, "run_units", dying)
    with pytest.raises(KeyboardInterrupt):
        search(file(trials=6), tmp_path / "parts")
    found = search(file(trials=6), tmp_path / "parts")
    assert params(found) == params(whole)
    assert found.best["value"] == whole.best["value"]
    dead = [t for t in found.trials if t["state"] == "fail"]
    assert len(dead) == 2 and all(t["why"] is None for t in dead)
    assert len(calls[2]) == 1  # the other unit was finished


@pytest.mark.parametrize("step", ["ask", "tell"])
def test_a_search_that_died_between_trials_ends_as_if_it_had_not(here, file, tmp_path, step):
    whole = search(file(trials=6), tmp_path / "whole")
    right, calls = getattr(optuna.Study, step), []

    def dying(*args, **options):
        calls.append(args)
        if len(calls) == 4:  # the second of the second batch
            raise KeyboardInterrupt
        return right(*args, **options)

    with pytest.MonkeyPatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(optuna.Study, step, dying)
        search(file(trials=6), tmp_path / "parts")
    found = search(file(trials=6), tmp_path / "parts")
    assert params(found) == params(whole)
    assert found.best["value"] == whole.best["value"]


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="SIGKILL")
def test_a_killed_search_goes_on(file, tmp_path):
    """A process of its own with two workers, killed in its second batch."""
    path, out = file(trials=8), tmp_path / "out"
    words = ["search", str(path), "--out", str(out), "--workers", "2"]
    process = subprocess.Popen([sys.executable, "-m", "ves_gym.cli.main", *words], cwd=ROOT)
    wait_until(lambda: len(list((out / "results").glob("*.json"))) >= 3)
    process.send_signal(signal.SIGKILL)
    process.wait()
    found = search(path, out, workers=2)
    assert [t["state"] for t in found.trials].count("complete") == 8
    assert params(found) == params(search(path, tmp_path / "whole", workers=1))


def test_one_search_in_a_folder(here, file, tmp_path):
    (tmp_path / "out").mkdir()
    with (
        s._alone(tmp_path / "out" / ".search.lock"),
        pytest.raises(ParameterError, match="another search is at work"),
    ):
        search(file(), tmp_path / "out")


def test_machines_share_a_database(here, file, tmp_path):
    url = f"sqlite:///{tmp_path}/study.db"
    one = search(file(trials=2), tmp_path / "one", storage=url)
    two = search(file(trials=4), tmp_path / "two", storage=url, seed=1)
    assert [t["number"] for t in two.trials] == [0, 1, 2, 3]
    assert two.trials[:2] == one.trials
    assert not (tmp_path / "one" / "study.jsonl").exists()


@pytest.mark.slow
def test_a_dead_machine_s_trial_is_failed_and_asked_for_again(file, tmp_path, monkeypatch):
    monkeypatch.setattr(s, "_HEARTBEAT", 1)
    wanted, _ = read_search(file())
    url, axis = f"sqlite:///{tmp_path}/study.db", "evaluate.0.settings.shift"

    def states(study):
        return [t.state.name for t in study.get_trials()]

    with s._study(tmp_path, wanted, url) as (study, beat):
        trial = s._ask(study)
        trial.suggest_float(axis, 1e-3, 4e-3)
        with beat([trial]):
            time.sleep(6)
        assert states(study) == ["RUNNING"]  # it gave signs of life
        time.sleep(6)  # as if it had died
        s._fail_dead(study)
        assert states(study) == ["FAIL", "WAITING"]
        assert s._ask(study).suggest_float(axis, 1e-3, 4e-3) == trial.params[axis]


def test_no_database_there(here, file, tmp_path):
    with pytest.raises(ParameterError, match="no database at nonsense"):
        search(file(), tmp_path / "out", storage="nonsense://x")


# ------------------------------------------------------------------------------ journal


def quadratic(path, trials):
    study = optuna.create_study(
        storage=open_journal(path), study_name="search", load_if_exists=True
    )
    for _ in range(trials):
        trial = study.ask()
        study.tell(trial, trial.suggest_float("x", -1, 1) ** 2)
    return study


@pytest.mark.parametrize("tail", [b'{"op_code": 4, "tri', b'{"op_code":', b"\x00\x00\x00"])
def test_a_torn_last_line_is_cut_off(tmp_path, tail):
    path = tmp_path / "study.jsonl"
    before = [t.value for t in quadratic(path, 3).trials]
    whole = path.read_bytes()
    path.write_bytes(whole + tail)
    study = quadratic(path, 2)
    assert [t.value for t in study.trials][:3] == before and len(study.trials) == 5
    assert path.read_bytes().startswith(whole)
    assert path.with_name("study.jsonl.snapshot").read_bytes() == whole
    assert not path.with_name("study.jsonl.lock").exists()


def test_without_the_repair_the_study_would_be_lost(tmp_path):
    """What the repair is for: the line after a torn one cannot be read."""
    from optuna.storages.journal import JournalFileBackend, JournalStorage

    path = tmp_path / "study.jsonl"
    quadratic(path, 2)
    path.write_bytes(path.read_bytes() + b'{"op_code": 4, "tri')
    with pytest.raises(ValueError), pytest.MonkeyPatch.context() as patch:
        patch.setattr(s, "_repair", lambda path: None)
        for _ in range(3):
            quadratic(path, 1)
        JournalStorage(JournalFileBackend(str(path)))


def test_a_torn_line_at_every_byte(tmp_path):
    path = tmp_path / "study.jsonl"
    quadratic(path, 1)
    whole = path.read_bytes()
    ends = [k + 1 for k, byte in enumerate(whole) if byte == 10]
    for cut in range(0, len(whole), 7):
        path.write_bytes(whole[:cut])
        open_journal(path)
        assert path.read_bytes() == whole[: max([0, *(e for e in ends if e <= cut)])]


def test_a_line_in_the_middle_is_named(tmp_path):
    path = tmp_path / "study.jsonl"
    quadratic(path, 2)
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join([*lines[:3], b"{oh}\n", *lines[3:]]))
    with pytest.raises(ParameterError, match=r"line 4 of .* is no JSON"):
        open_journal(path)
    assert not path.with_name("study.jsonl.lock").exists()


# ------------------------------------------------------------------------------ bad input


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[search]", "[other]", "missing key 'trials'"),
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
        search(file(text=PLAIN.replace(old, new, 1)), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_sweep_is_no_search(here, file, tmp_path):
    text = PLAIN.partition("[search]")[0]
    with pytest.raises(ParameterError, match=r"expected a table \[search\]"):
        search(file(text=text), tmp_path / "out")


def test_an_unknown_objective_names_the_known(here, file, tmp_path):
    with pytest.raises(ParameterError, match="objective must be one of E_int, E_mean"):
        search(file(text=PLAIN.replace("E_mean", "speed")), tmp_path / "out")


def test_axes_draw_what_they_say():
    trial = optuna.create_study(sampler=optuna.samplers.RandomSampler(seed=0)).ask()
    x = Axis(low=1e-4, high=1e-2, log=True).draw(trial, "x")
    assert 1e-4 <= x <= 1e-2
    n = Axis(low=2, high=4, integer=True).draw(trial, "n")
    assert n in (2, 3, 4) and isinstance(n, int)
    assert Axis(choices=([1, 2], "a", None)).draw(trial, "c") in ([1, 2], "a", None)
    assert math.isclose(trial.params["x"], x)
