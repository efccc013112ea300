"""Selectors of the track discrepancy on records of diagnoses made by hand, without diagnosing.

What a diagnosis finds is tested elsewhere (tests/diagnosis); here, what the track makes of it.
"""

import json
from dataclasses import asdict

import pytest

from ves_gym._util.params import canonical_json, write_text
from ves_gym.diagnosis.benchmark import run as blind_benchmark
from ves_gym.diagnosis.benchmark.score import METHODS
from ves_gym.diagnosis.diagnose import NAMED, NOTHING, UNKNOWN
from ves_gym.diagnosis.inference.model_selection import Thresholds
from ves_gym.leaderboard.errors import BundleError, Code
from ves_gym.leaderboard.protocol import get_problem, seeds_of
from ves_gym.leaderboard.tracks import selectors as s
from ves_gym.leaderboard.tracks.base import Method
from ves_gym.leaderboard.tracks.diagnosis import DiagnosisTrack

PROBLEM = get_problem("discrepancy", "blind-development-quick")
SEEDS = seeds_of(PROBLEM, None)
RIGHT = {"kind": "joint/viscous", "slot": "joint 2", "value": {"coefficient": 4.0}}
WRONG = {"kind": "joint/coulomb", "slot": "joint 1", "value": {"torque": 3.0}}
BESIDES = ("std", "probability", "rivals")  # what a score does not need


def diagnosed(index, effects, gap=1.0, baselines=WRONG):
    """The record of a diagnosis; every simpler method names `baselines`, nothing for None."""
    named = [] if baselines is None else [baselines]
    return {
        "index": index,
        "thresholds": blind_benchmark.thresholds_hash(Thresholds()),
        "verdict": NAMED if effects else NOTHING,
        "effects": [{**e, **dict.fromkeys(BESIDES)} for e in effects],
        "gaps": [["joint", "tau_1", 1.0, 1.0], ["wrench", "F_x", gap, 1.0]],
        "final": [],
        "seconds": {"total": 20.0 + index},
        "baselines": dict.fromkeys(METHODS[1:], named),
    }


@pytest.fixture
def track(tmp_path):
    """Thirty cases: joint 2 has friction in those of even place, nothing is wrong in others."""
    rules = DiagnosisTrack(tmp_path)
    benchmark = rules.benchmark(PROBLEM, SEEDS)
    for place, i in enumerate(benchmark.cases):
        ill = place % 2 == 0
        effects = [{**RIGHT, "wanted": 10.0, "reached": 10.0}] if ill else []
        label = {"index": i, "category": "single" if ill else "null", "effects": effects}
        write(benchmark.labels / f"case-{i:03d}.json", label)
        for folder in (benchmark.answers, f"again-{benchmark.answers}"):
            answer = diagnosed(i, [RIGHT] if ill else [], 10.0 if ill else 1.0)
            write(benchmark.folder / folder / f"case-{i:03d}.json", answer)
    return rules


def write(path, plain):
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, canonical_json(plain))


def run(track, name):
    method = Method(kind="selector", name=name)
    answers = track.run(PROBLEM, SEEDS, method)
    assert track.replay(PROBLEM, SEEDS, method, answers.rows, answers.payload) == answers.rows
    members = {track.payload(PROBLEM): answers.payload}
    assert track.reproduce(PROBLEM, SEEDS, method, members, answers.rows) == answers.rows
    return answers


@pytest.mark.parametrize(
    ("name", "right"),
    [("ves-gym", 30), ("stepwise", 0), ("location only", 15), ("always nothing", 15)],
)
def test_a_selector_scores_what_it_says(track, name, right):
    """A location is no name: it is right where nothing is wrong, as silence is."""
    rows = run(track, name).rows
    assert sum(row["success"] for row in rows) == right
    assert {row["score"] for row in rows} <= {0.0, 1.0}
    assert all((row["seconds"] is None) == (name != "ves-gym") for row in rows)


def test_every_selector_has_an_answer_to_every_case(track):
    for name in s.SELECTORS:
        table = json.loads(run(track, name).payload)
        assert [a["index"] for a in table["answers"]] == track.seed_list(PROBLEM, SEEDS)


def test_a_location_says_where_and_names_nothing():
    told = s.answer_of(diagnosed(7, [RIGHT], gap=3.0), s.LOCATION)
    where = {"kind": "wrench", "slot": "F_x", "value": {"gap": 3.0}}
    assert told == {"index": 7, "verdict": UNKNOWN, "effects": [where]}
    quiet = s.answer_of(diagnosed(7, [RIGHT], gap=s.AUDIBLE), s.LOCATION)
    assert quiet == s.silent(7)


def test_a_diagnosis_that_failed_is_a_failure_of_whoever_needs_it():
    failed = {"index": 3, "verdict": blind_benchmark.FAILED, "effects": [], "baselines": {}}
    for name in set(s.SELECTORS) - {s.SILENT}:
        assert s.answer_of(failed, name)["verdict"] == blind_benchmark.FAILED


def test_what_a_bundle_was_made_from_does_not_reproduce_it(track, monkeypatch):
    """Other answers when the method runs again: refused, though those of before are there."""
    method = Method(kind="selector", name="ves-gym")
    answers = track.run(PROBLEM, SEEDS, method)
    asked = []

    def diagnose_anew(benchmark, *_):
        asked.append(asdict(benchmark))
        for i in benchmark.cases:
            write(benchmark.answer_file(i), diagnosed(i, [WRONG]))

    monkeypatch.setattr(blind_benchmark, "run_benchmark", diagnose_anew)
    members = {track.payload(PROBLEM): answers.payload}
    with pytest.raises(BundleError) as refused:
        track.reproduce(PROBLEM, SEEDS, method, members, answers.rows)
    assert refused.value.code is Code.NOT_REPRODUCED
    (again,) = asked
    assert again["answers"] != track.benchmark(PROBLEM, SEEDS).answers


def test_silence_needs_no_diagnosis(track, monkeypatch):
    monkeypatch.setattr(blind_benchmark, "run_benchmark", None)
    assert len(run(track, s.SILENT).rows) == PROBLEM.count
