"""The benchmark's run: which cases, sealing before diagnosing, resuming."""

from collections import Counter

import pytest

pytest.importorskip("numba")

from ves_gym._util.params import ParameterError, canonical_json, read_table
from ves_gym.diagnosis.benchmark import run as t
from ves_gym.diagnosis.benchmark.blind import cases as generator
from ves_gym.diagnosis.inference.model_selection import Thresholds

SALT = "0123456789abcdef"


@pytest.fixture
def salt(tmp_path):
    path = tmp_path / "salt.txt"
    path.write_text(SALT + "\n")
    return path


@pytest.fixture
def by_hand(monkeypatch):
    """Run jobs here, with cases and answers made of nothing; the order in which it is done."""
    done = []

    def write(path, value):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(canonical_json(value))

    def run(jobs, workers, tell):
        for function, *rest in jobs:
            if function is t.make_case:
                folder, _, index = rest
                label = {"index": index, "effects": []}
                write(t.Path(folder) / "labels" / f"case-{index:03d}.json", label)
                done.append(("made", index))
            else:
                _, index, path = rest
                sealed = (t.Path(path).parents[1] / "seal.json").exists()
                mark = t.thresholds_hash(Thresholds())
                write(t.Path(path), {"thresholds": mark, "verdict": "nothing missing"})
                done.append(("answered, sealed" if sealed else "answered", index))

    monkeypatch.setattr(t, "_in_processes", run)
    return done


def test_thirty_cases_have_the_proportions_of_all():
    root = generator.root_seed("development")
    plans = [generator.plan_of(i, root) for i in t.stratified(30, root)]
    count = Counter(p.category for p in plans)
    assert count == {"single": 16, "null": 6, "outside": 3, "pair": 4, "weak": 1}
    ratios = Counter(p.ratios[0] for p in plans if p.category == "single")
    assert min(ratios[r] for r in generator.RATIOS) >= 4
    assert {p.variant for p in plans if p.category == "null"} == {"usual", "large"}
    assert t.stratified(600, root) == list(range(600))


def test_sealed_set_needs_a_salt(tmp_path, salt):
    with pytest.raises(ParameterError, match="the sealed set needs a salt"):
        t.benchmark_run(tmp_path, "sealed")
    with pytest.raises(ParameterError, match="takes no salt"):
        t.benchmark_run(tmp_path, "development", salt)
    with pytest.raises(ParameterError, match="cannot be read"):
        t.benchmark_run(tmp_path, "sealed", tmp_path / "nowhere")
    salt.write_text("short")
    with pytest.raises(ParameterError, match="at least 16 characters, got 5"):
        t.benchmark_run(tmp_path, "sealed", salt)


@pytest.mark.parametrize("cases", [range(599, 601), [], 0, 601])
def test_cases_that_there_are_not(tmp_path, cases):
    with pytest.raises(ParameterError, match="cases must be"):
        t.benchmark_run(tmp_path, "development", cases=cases)


def test_finished_cases_are_skipped(tmp_path, by_hand):
    t.run_benchmark(t.benchmark_run(tmp_path, "development", cases=range(2)))
    assert by_hand == [("made", 0), ("made", 1), ("answered", 0), ("answered", 1)]
    by_hand.clear()
    t.run_benchmark(t.benchmark_run(tmp_path, "development", cases=range(3)))
    assert by_hand == [("made", 2), ("answered", 2)]
    assert not (tmp_path / "seal.json").exists()


def test_answers_under_other_thresholds_are_not_mixed(tmp_path, by_hand, monkeypatch):
    benchmark = t.benchmark_run(tmp_path, "development", cases=range(1))
    t.run_benchmark(benchmark)
    monkeypatch.setattr(t, "thresholds_hash", lambda limits: "1" * 64)
    with pytest.raises(ParameterError, match="with other thresholds; take another folder"):
        t.run_benchmark(benchmark)


def test_labels_are_sealed_before_any_diagnosis(tmp_path, salt, by_hand):
    benchmark = t.benchmark_run(tmp_path, "sealed", salt, range(2))
    t.run_benchmark(benchmark)
    assert by_hand[2:] == [("answered, sealed", 0), ("answered, sealed", 1)]
    known = read_table(tmp_path / "seal.json")
    assert known["cases"] == [0, 1] and len(known["digest"]) == 64
    assert set(known) == {"cases", "digest"}  # the nonce stays with the labels
    t.run_benchmark(benchmark)
    assert read_table(tmp_path / "seal.json") == known


def test_a_seal_does_not_give_way(tmp_path, salt, by_hand):
    benchmark = t.benchmark_run(tmp_path, "sealed", salt, range(2))
    t.run_benchmark(benchmark)
    with pytest.raises(ParameterError, match="seals other cases"):
        t.run_benchmark(t.benchmark_run(tmp_path, "sealed", salt, range(3)))
    label = benchmark.labels / "case-000.json"
    before = label.read_text()
    label.write_text(canonical_json({"index": 0, "effects": ["other"]}))
    with pytest.raises(ParameterError, match="not those that were sealed"):
        t.run_benchmark(benchmark)
    label.write_text(before)
    (tmp_path / "seal.json").unlink()
    with pytest.raises(ParameterError, match="there are answers already"):
        t.run_benchmark(benchmark)


def test_a_diagnosis_that_fails_is_an_answer_and_is_tried_again(tmp_path):
    benchmark = t.benchmark_run(tmp_path, "development", cases=range(1))
    t.answer_case(str(tmp_path / "logs"), 0, str(benchmark.answer_file(0)))
    known = read_table(benchmark.answer_file(0))
    assert known["verdict"] == t.FAILED and "RunLogError" in known["why"]
    assert not t._finished(benchmark, 0, known["thresholds"])


@pytest.mark.slow
def test_two_development_cases_from_end_to_end(tmp_path):
    from ves_gym.diagnosis.benchmark.score import METHODS, score

    benchmark = t.benchmark_run(tmp_path, "development", cases=range(2))
    told = []
    t.run_benchmark(benchmark, 1, lambda what, done: told.append((what, done)))
    assert told[-1] == ("diagnosing", 1.0)
    answers = t.read_answers(benchmark)
    for known in answers:
        assert known["verdict"] != t.FAILED, known.get("why")
        assert known["final"] and known["seconds"]["total"] > 0
        assert len(known["baselines"]["smallest error"]) == 1
        assert set(known["baselines"]) == set(METHODS[1:])
        assert len(known["baselines"]["stepwise"]) <= 3
    found = score(t.read_truth(benchmark), answers)
    assert set(found["methods"]) == set(METHODS) and not found["failed"]
