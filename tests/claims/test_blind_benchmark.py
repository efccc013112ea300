"""The diagnosis on sealed cases: what is published is what was sealed and answered.

Scores come from the answers, labels from the seal, which was committed before any diagnosis;
the page says whether thresholds are still those of the answers. The command that answers it
again takes an hour: `ves-gym diagnose-benchmark --set sealed --salt docs/diagnosis-salt.txt
--cases 240`.
"""

import json
from pathlib import Path

import pytest

from ves_gym.diagnosis.benchmark.blind.cases import mix, order_of, root_seed
from ves_gym.diagnosis.benchmark.blind.write import seal
from ves_gym.diagnosis.benchmark.run import scored_part, stratified, thresholds_hash
from ves_gym.diagnosis.benchmark.score import score
from ves_gym.diagnosis.inference.model_selection import Thresholds
from ves_gym.report.benchmark_page import markdown

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(scope="module")
def published():
    return json.loads((DOCS / "diagnosis-results.json").read_text("utf-8"))


def test_labels_are_those_that_were_sealed(published):
    sealed = json.loads((DOCS / "diagnosis-seal.json").read_text("utf-8"))
    assert published["seal"]["digest"] == sealed["digest"]
    assert published["cases"] == sealed["cases"]
    labels, nonce = published["labels"], published["seal"]["nonce"]
    assert seal(labels, nonce)[0] == sealed["digest"]
    labels[0]["index"] += 1000
    assert seal(labels, nonce)[0] != sealed["digest"]
    labels[0]["index"] -= 1000


def test_cases_are_the_stated_share_of_all_kinds(published):
    root = root_seed("sealed", (DOCS / "diagnosis-salt.txt").read_text("utf-8").strip())
    assert published["cases"] == stratified(240, root)
    order, plans = order_of(root), mix()
    for label in published["labels"]:
        plan = plans[order[label["index"]]]
        assert [e["kind"] for e in label["effects"]] == list(plan.kinds)


def test_the_page_is_what_the_answers_score(published):
    result = {**published, "score": score(published["labels"], published["answers"])}
    assert markdown(result) == (DOCS / "diagnosis-results.md").read_text("utf-8")
    assert [scored_part(a) for a in published["answers"]] == published["answers"]


def test_a_page_of_other_thresholds_than_the_programs_says_so(published):
    assert {a["thresholds"] for a in published["answers"]} == {published["thresholds"]}
    page = (DOCS / "diagnosis-results.md").read_text("utf-8")
    changed = published["thresholds"] != thresholds_hash(Thresholds())
    assert ("not the answers of this version" in page) == changed
