"""The column `gap`: energies over a certified lower bound, or the reason why there is none."""

from dataclasses import replace

import pytest

from ves_gym.effects import BaseStiffness
from ves_gym.mechanics.arm_library import get_arm
from ves_gym.planners import gap
from ves_gym.planners.benchmark import run_benchmark
from ves_gym.planners.gap import NOT_ASKED, add_gaps, reason_without_bound
from ves_gym.planners.prediction import BaseState
from ves_gym.planners.suites import reach100
from ves_gym.system.system import System

BOUNDED = "straight-vertical-thesis"  # a beam of six condensed modes


def one_query(vehicle=BOUNDED, system=None, duration=0.5):
    suite = reach100(system or System(), vehicle, 1, durations=(duration,))
    return replace(suite, queries=suite.queries[:1])


@pytest.mark.slow
def test_the_gap_is_the_energy_over_a_certified_bound():
    result = run_benchmark(one_query(BOUNDED), planners=["direct"], workers=1, bound=True)
    straight, direct = result["rows"]
    assert straight["bound"] == direct["bound"] > 0
    for row in (straight, direct):
        assert row["gap"] == row["E_mean"] / row["bound"] >= 1 and row["no_gap"] is None
    gaps = [row["gap_median"] for row in result["summary"]]
    assert gaps == [straight["gap"], direct["gap"]] and gaps[0] > gaps[1]


def test_bounds_are_found_where_they_are_asked_for_only():
    result = run_benchmark(one_query(BOUNDED), workers=1, planners=["straight"])
    (row,) = result["rows"]
    assert (row["gap"], row["bound"], row["no_gap"]) == (None, None, NOT_ASKED)
    assert result["summary"][0]["gap_median"] is None


def test_a_motion_that_is_no_answer_has_no_gap(monkeypatch):
    monkeypatch.setattr(gap, "_bound", lambda query: 0.5)  # finding one takes seconds
    suite = one_query(BOUNDED)
    ((vehicle, query),) = suite.queries
    row = {"vehicle": vehicle, "query": query.name, "success": False, "E_mean": 1.0}
    add_gaps([row], suite.queries, True, 1, lambda stage, done: None)
    assert row["bound"] == 0.5 and row["gap"] is None
    assert row["no_gap"] == "the motion is no answer"
    row["success"] = True
    add_gaps([row], suite.queries, True, 1, lambda stage, done: None)
    assert row["gap"] == 2.0 and row["no_gap"] is None


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"system": System(mode="emulated")}, "laboratory"),
        ({"system": System(arm=get_arm("ur5e"))}, "6 joints"),
        ({"vehicle": "bent"}, "5 internal modes"),
    ],
)
def test_what_has_no_bound_says_why(change, why):
    ((_, query),) = one_query(**change).queries
    assert why in reason_without_bound(query)


def test_a_moving_start_and_effects_have_no_bound():
    ((_, query),) = one_query(BOUNDED).queries
    assert reason_without_bound(query) is None
    assert "move" in reason_without_bound(replace(query, start_rate=(0.1, 0.0, 0.0)))
    assert "move" in reason_without_bound(
        replace(query, base=BaseState(y=(0.1, 0, 0, 0, 0, 0)))
    )
    softer = query.system.replace(effects=(BaseStiffness(error=-0.1),))
    assert "effects" in reason_without_bound(replace(query, system=softer))
