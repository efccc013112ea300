"""Scoring, on answers made by hand: right ones and wrong ones."""

import pytest

from ves_gym.diagnosis import diagnose as d
from ves_gym.diagnosis.benchmark import score as s
from ves_gym.diagnosis.benchmark.labels import answer_name, label_name, numbers
from ves_gym.report.benchmark_page import markdown


def truth(category, *effects, wanted=10.0, index=0):
    """A label; effects are (kind, slot, parameters)."""
    return {
        "index": index,
        "category": category,
        "variant": "",
        "effects": [
            {"kind": k, "slot": at, "parameters": p, "wanted": wanted, "reached": wanted}
            for k, at, p in effects
        ],
    }


def named(kind, slot, value, p=0.95, std=None, rivals=()):
    own = {"kind": kind, "slot": slot, "value": value}
    return {
        **own,
        "std": std or dict.fromkeys(value, 0.1),
        "probability": p,
        "rivals": [{**own, "probability": p, "near": True}, *rivals],
    }


def said(verdict, *effects, final=(("joint", "tau_1", 11.0, 1.1),), baselines=None):
    return {
        "index": 0,
        "thresholds": "0" * 64,
        "verdict": verdict,
        "effects": list(effects),
        "final": [list(g) for g in final],
        "seconds": {"total": 12.0},
        "baselines": {**dict.fromkeys(s.METHODS[1:], ()), **(baselines or {})},
    }


COULOMB = ("joint/coulomb", "joint 1", {"torque": 2.0})
RIGHT = named("joint/coulomb", "joint 1", {"torque": 2.1})


def value_of(rows, start):
    (row,) = [r for r in rows if r.name.startswith(start)]
    return row.value


def rows_of(*pairs):
    return s.rows(s.cases_of([a for a, _ in pairs], [b for _, b in pairs]))


def test_a_right_name_with_its_number():
    rows = rows_of((truth("single", COULOMB), said(d.NAMED, RIGHT)))
    assert value_of(rows, "single, 3x noise and more: name") == 1
    assert value_of(rows, "single, 3x and more: mean probability") == pytest.approx(0.95)
    assert value_of(rows, "right slot") == 1
    assert value_of(rows, "90 % intervals") == 1
    assert value_of(rows, "relative error") == pytest.approx(0.05)
    assert value_of(rows, "calibration error") == pytest.approx(0.05)
    removed = value_of(rows, "single, 10x: gap")
    assert removed == pytest.approx(1 - (0.21 / 120) ** 0.5)


@pytest.mark.parametrize(
    "answer",
    [
        said(d.NOTHING),
        said(d.UNKNOWN, RIGHT),  # an effect was fitted, but no name given
        said(d.NAMED, named("joint/viscous", "joint 1", {"damping": 1.0})),
        said(d.NAMED, named("joint/coulomb", "joint 2", {"torque": 2.0})),
        said(d.NAMED, RIGHT, named("sensor/lag", "", {"error": -0.1})),
        said("failed"),
    ],
)
def test_everything_else_is_not_the_name(answer):
    rows = rows_of((truth("single", COULOMB), answer))
    assert value_of(rows, "single, 3x noise and more: name") == 0
    assert value_of(rows, "single, 3x and more: in the class") == 0


def test_another_slot_of_the_right_kind_counts_against_the_slot():
    other = named("joint/coulomb", "joint 2", {"torque": 2.0})
    rows = rows_of((truth("single", COULOMB), said(d.NAMED, other)))
    assert value_of(rows, "right slot") == 0
    assert value_of(rows, "single, 3x and more: mean probability") == 0


@pytest.mark.parametrize("near", [True, False])
def test_a_class_holds_the_truth_only_if_it_is_near(near):
    truly = {"kind": "joint/coulomb", "slot": "joint 1", "value": {"torque": 2.0}}
    rival = {**truly, "probability": 0.4, "near": near}
    first = named("joint/viscous", "joint 1", {"damping": 1.0}, p=0.6, rivals=[rival])
    rows = rows_of((truth("single", COULOMB), said(d.ONE_OF, first)))
    assert value_of(rows, "single, 3x noise and more: name") == 0
    assert value_of(rows, "single, 3x and more: in the class") == near
    assert value_of(rows, "single, 3x and more: mean probability") == pytest.approx(0.4)


def test_small_gaps_are_not_owed_a_name():
    rows = rows_of((truth("single", COULOMB, wanted=1.5), said(d.NOTHING)))
    assert value_of(rows, "single, 3x noise and more: name") is None


@pytest.mark.parametrize(
    ("verdict", "alarm"),
    [(d.NOTHING, 0), (d.WEAK, 0), (d.NAMED, 1), (d.UNKNOWN, 1), ("failed", 1)],
)
def test_false_alarms(verdict, alarm):
    assert value_of(rows_of((truth("null"), said(verdict))), "null") == alarm


def test_bounds_are_those_of_the_protocol():
    assert s.bounds(1, 120)[1] == pytest.approx(0.039, abs=5e-4)
    assert s.bounds(0, 10)[0] == 0 and s.bounds(10, 10)[1] == 1


def test_outside_the_library():
    hose = ("outside/hose_drag", "", {"stiffness": 3.0})
    unknown, wrong = said(d.UNKNOWN, RIGHT), said(d.MORE, RIGHT)
    rows = rows_of((truth("outside", hose), unknown), (truth("outside", hose), wrong))
    assert value_of(rows, "outside: said to be unknown") == 0.5
    assert value_of(rows, "outside: a wrong name") == 0.5


def test_pairs():
    lag = ("sensor/lag", "", {"error": -0.3})
    one = said(d.NAMED, RIGHT)
    both = said(d.NAMED, RIGHT, named("sensor/lag", "", {"error": -0.3}))
    rows = rows_of((truth("pair", COULOMB, lag), one), (truth("pair", COULOMB, lag), both))
    assert value_of(rows, "pair: both") == 0.5
    assert value_of(rows, "pair: precision") == 1
    assert value_of(rows, "pair: recall") == 0.75
    assert value_of(rows, "pair: F1") == pytest.approx(6 / 7)


def test_gap_removed_needs_a_gap():
    assert s.removed_gap([["joint", "tau_1", 1.2, 1.0]]) is None
    assert s.removed_gap([["a", "x", 5.0, 5.0], ["b", "y", 9.0, 0.9]]) == 1
    assert s.removed_gap([["a", "x", 5.0, 5.0]]) == 0


def test_confusion_has_columns_for_no_name():
    viscous = named("joint/viscous", "joint 1", {"damping": 1.0})
    label = truth("single", COULOMB)
    answers = [
        said(d.NAMED, RIGHT),
        said(d.NAMED, viscous),
        said(d.NOTHING),
        said(d.UNKNOWN),
        said(d.ONE_OF, RIGHT),
    ]
    found = s.confusion(s.cases_of([label] * 5, answers))
    names = ("joint/coulomb", "joint/viscous", "nothing", "unknown", "ambiguous")
    assert found == {"joint/coulomb": dict.fromkeys(sorted(names), 1)}


@pytest.mark.parametrize(
    ("label", "given"),
    [
        (("sensor/bias", "m_y", {}), ("sensor/bias", "M_y", {"bias": 1.0})),  # of before
        (("sensor/bias", "m_y", {}), ("sensor/bias", "", {"F_x": 0.01, "M_y": -1.0})),
        (("base/extra_mode", "x", {}), ("base/extra_mode", "x", {"mass": 1.0})),
        (
            ("gravity/tilt", "y", {}),
            ("gravity/tilt", "", {"x": 0.1, "y": -0.2, "z": 0.0}),
        ),
    ],
)
def test_slots_of_labels_and_candidates_are_the_same_names(label, given):
    kind, slot, _ = label
    other, at, value = given
    assert label_name({"kind": kind, "slot": slot}) == answer_name(
        {"kind": other, "slot": at, "value": value}
    )


def test_every_label_can_be_named_by_some_candidate():
    pytest.importorskip("numba")
    from ves_gym.diagnosis.benchmark.blind.effects import LIBRARY, TRUTHS
    from ves_gym.diagnosis.inference.candidates import library

    ports = ["joint", "servo", "wrench", "gravity", "admittance", "platform"]
    known = library(3, ports, "emulated", ["run-1"])
    names = set()
    for c in known:
        for axis in c.names:
            value = {**dict.fromkeys(c.names, 0.0), axis: 1.0}
            names.add(answer_name({"kind": c.kind, "slot": c.slot, "value": value}))
    for kind in LIBRARY:
        for slot in TRUTHS[kind].slots:
            assert label_name({"kind": kind, "slot": slot}) in names


@pytest.mark.parametrize(
    ("label", "value", "pairs"),
    [
        (
            ("joint/ripple", "joint 1", {"amplitude": 5.0, "cycles": 9.0, "phase": 0.1}),
            {"sine": 3.0, "cosine": 4.0, "cycles": 9.1},
            [(5.0, 5.0), (9.0, 9.1)],
        ),
        (
            ("joint/stribeck", "joint 1", {"coulomb": 1.0, "stiction": 3.0, "fade_speed": 0.1}),
            {"coulomb": 1.25, "breakaway": 1.0, "fade_speed": 0.2},
            [(1.0, 1.25), (3.0, 2.5), (0.1, 0.2)],
        ),
        (
            ("sensor/calibration", "m_z", {"error": 0.1, "from": 1}),
            {"F_x": 0.0, "F_y": 0.0, "F_z": 0.0, "M_x": 0.12, "M_y": 0.0, "M_z": 0.0},
            [(0.1, 0.12)],
        ),
        (
            ("payload/com", "z", {"offset": -0.1}),
            {"x": 0.0, "y": 0.01, "z": -0.11},
            [(-0.1, -0.11)],
        ),
        (("sensor/drift", "f_x", {"std": 3.0, "time": 5.0}), {"run-1 1": 2.0}, []),
    ],
)
def test_numbers_are_compared_with_those_of_the_label(label, value, pairs):
    kind, slot, parameters = label
    found = numbers(
        {"kind": kind, "slot": slot, "parameters": parameters}, {"value": value, "std": {}}
    )
    assert [p[:2] for p in found] == [pytest.approx(p) for p in pairs]


def test_the_page_names_what_was_missed():
    labels = [truth("single", COULOMB, index=7), truth("null", index=8)]
    beside = {"stepwise": [{k: RIGHT[k] for k in ("kind", "slot", "value")}]}
    answers = [said(d.NOTHING, baselines=beside), said(d.NOTHING)]
    found = s.score(labels, answers)
    by_name = {r["name"]: r for r in found["methods"]["stepwise"]["rows"]}
    assert by_name["single, 3x noise and more: name"]["value"] == 1
    page = markdown(
        {
            "score": found,
            "set": "development",
            "cases": [7, 8],
            "command": "ves-gym diagnose-benchmark",
            "version": "1",
            "thresholds": "0" * 64,
            "seal": None,
        }
    )
    assert "| 7 | single | joint/coulomb joint 1 (10.0) | nothing missing |" in page
    assert "Not met: single, 3x noise and more: name;" in page
    assert "| 8 | null |" not in page
