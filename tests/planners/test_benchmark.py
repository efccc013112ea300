"""The benchmark: every answer simulated, the same rows from one process or two."""

import copy
import dataclasses
import json
import os
import re

import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.effects import GravityScale
from ves_gym.mechanics.vehicle import (
    BENT_THESIS,
    FREE_FLOATING,
    STRAIGHT_HORIZONTAL_THESIS,
)
from ves_gym.planners.benchmark import (
    SCHEMA,
    _run_workers,
    rank_correlation,
    run_benchmark,
    run_query,
    summarise,
)
from ves_gym.planners.execution_check import solve_with_reserve
from ves_gym.planners.query import NoPlan, Plan, Query
from ves_gym.planners.registry import PLANNERS, get_planner
from ves_gym.planners.suites import Suite, get_suite, reach100
from ves_gym.report.benchmark import benchmark_text
from ves_gym.simulation.playback import play_motions
from ves_gym.system.system import System

BENT = System(vehicle=BENT_THESIS)

DURATIONS = (0.5, 2.0)


def small_suite():
    """Two questions: the first of half a second and the first of two."""
    reach = reach100(BENT, "bent-thesis", 1)
    queries = tuple((v, q) for v, q in reach.queries if q.duration in DURATIONS)
    return dataclasses.replace(reach, queries=queries)


CALLS = []  # of progress
OPTIONS = {"planners": ["direct"], "seed": 3, "command": "a test"}


@pytest.fixture(scope="module")
def result():
    return run_benchmark(
        small_suite(), **OPTIONS, workers=1, progress=lambda *k: CALLS.append(k)
    )


# ------------------------------------------------------------------------------ rows


def test_the_schema(result):
    assert result["schema"] == SCHEMA == "ves-benchmark/1"
    keys = {"suite", "mode", "drive", "seed", "command", "created", "versions", "systems"}
    keys |= {"planners", "rows", "summary", "traces", "maps", "scenes", "seconds"}
    assert keys <= result.keys()
    assert (result["suite"], result["mode"], result["drive"]) == ("reach100", "ideal", "motor")
    assert (result["seed"], result["command"]) == (3, "a test")
    assert [p["name"] for p in result["planners"]] == ["straight", "direct"]
    assert {"E_int", "W_port", "predicted", "success"} <= result["rows"][0].keys()
    assert json.loads(json.dumps(result, allow_nan=False)) == result
    rows = [(r["planner"], r["query"]) for r in result["rows"]]
    names = "reach-0.5s-000", "reach-2s-000"
    assert rows == [(planner, query) for query in names for planner in ("straight", "direct")]
    with pytest.raises(ParameterError, match="planner must be one of"):
        run_benchmark(small_suite(), planners=["magic"], workers=1)
    assert result["systems"]["bent-thesis"]["hash"] == BENT.hash


def test_the_text_begins_with_the_answer_and_its_price(result):
    """In a pipe nothing is wider than 80 characters, and no cell is cut."""
    text = benchmark_text(result)
    assert text.startswith("direct disturbs bent-thesis least in 2 s: 0.")
    told = ("success 100 %", "planned in", "lin., ang.", "limits", "Medians of 1 queries")
    assert all(word in text for word in told)
    assert max(map(len, text.split("\n"))) <= 80 and "…" not in text
    assert {"python", "mujoco", "numpy"} <= result["versions"].keys()


def again(query, planner, seed, *systems):
    """The plan, its runs on the systems, and what these measure."""
    plan = solve_with_reserve(get_planner(planner), query, seed)
    how = {"servo": query.servo, "record_dt": 12.5e-3}
    runs = [play_motions(s, [plan.motion], **how) for s in systems]
    return plan, runs, [r.energies()[0] for r in runs]


def test_a_row_holds_what_its_motion_does(result):
    """Each row again on its own: planned, played and measured."""
    for row in result["rows"]:
        query = next(q for _, q in small_suite().queries if q.name == row["query"])
        plan, _, (measured,) = again(query, row["planner"], 3, query.system)
        for name, value in measured.to_dict().items():
            same = row[name] == value if value is None else row[name] == pytest.approx(value)
            assert same, name
        assert row["predicted"] == plan.predicted.E_mean
        assert row["prediction_error"] == pytest.approx(row["predicted"] / row["E_mean"] - 1)
        assert row["success"] is plan.feasible
        assert row["info"] == plan.info
        assert row["duration"] == query.duration
        assert row["plan_seconds"] > 0


def test_progress_goes_through_its_stages(result):
    assert [stage for stage, _ in CALLS] == ["planning"] * 4 + ["simulating"] * 2
    for stage in ("planning", "simulating"):
        done = [d for s, d in CALLS if s == stage]
        assert done == sorted(done)
        assert done[-1] == 1.0


def test_pictures_cover_what_was_run(result):
    assert {t["query"] for t in result["traces"]} == {"reach-0.5s-000", "reach-2s-000"}
    for trace in result["traces"]:
        assert [s["planner"] for s in trace["series"]] == ["straight", "direct"]
        for series in trace["series"]:
            assert len(series["t"]) == len(series["E"]) > 100
            assert series["t"][0] == 0
    assert len(result["scenes"]) == 2
    for scene in result["scenes"]:
        assert [r["planner"] for r in scene["runs"]] == ["straight", "direct"]
        frames = {len(r[k]) for r in scene["runs"] for k in ("arm", "base", "beam", "E")}
        assert len(frames) == 1
    assert len(result["maps"]) == 6
    for section in result["maps"]:
        assert np.shape(section["most"]) == (len(section["x"]), len(section["y"]))
        assert [p["planner"] for p in section["paths"]] == ["straight", "direct"]


# --------------------------------------------------------------------------- workers


def timeless(result):
    """Without what depends on the clock."""
    out = copy.deepcopy(result)
    for key in ("created", "seconds"):
        del out[key]
    for row in out["rows"]:
        del row["plan_seconds"]
    for row in out["summary"]:
        for key in ("plan_seconds_median", "plan_seconds_p95", "plan_seconds_max"):
            del row[key]
    return out


@pytest.mark.slow
def test_two_processes_give_the_same_result(result):
    other = run_benchmark(small_suite(), **OPTIONS, workers=2)
    assert timeless(other) == timeless(result)


def test_one_query_alone_gives_the_row(result):
    vehicle, query = small_suite().queries[0]
    row = run_query("direct", vehicle, query, 3)
    (same,) = (
        r for r in result["rows"] if (r["planner"], r["query"]) == ("direct", query.name)
    )
    del row["plan_seconds"]
    assert row.keys() < same.keys()
    energies = {name for name in row if name.startswith("E_")}
    for name in row.keys() - energies - {"predicted", "prediction_error", "W_port", "t_5"}:
        assert row[name] == same[name], name
    for name in energies:  # of two motions played at once in the other
        assert row[name] == pytest.approx(same[name], rel=1e-9)


# -------------------------------------------------------------------------- planners


def test_a_free_base_and_a_query_that_goes_nowhere_are_strict_json_too():
    system = System(vehicle=FREE_FLOATING, drive="prescribed")
    point = (0.2, 0.1, -0.3)
    queries = (
        Query(system=system, start=point, goal=(0.6, 0.3, 0.1), duration=1.0, name="go"),
        Query(system=system, start=point, goal=point, duration=1.0, name="stay"),
    )
    suite = Suite(
        name="odd", queries=tuple(("free", q) for q in queries), planners=("straight",)
    )
    result = run_benchmark(suite, workers=1)
    json.dumps(result, allow_nan=False)
    go, stay = result["rows"]
    assert go["E_peak"] > 0
    assert stay["E_mean"] == pytest.approx(0.0, abs=1e-20)
    assert result["summary"][0]["E_res_ratio_median"] is None  # at rest after any motion
    assert all(scene["rest_beam"] is None for scene in result["scenes"])


# --------------------------------------------------------------------------- summary


def row(planner, query, mean, *, res=None, success=True, duration=1.0, **extra):
    return {
        "planner": planner,
        "query": query,
        "vehicle": "bent-thesis",
        "duration": duration,
        "E_mean": mean,
        "E_res": mean if res is None else res,
        "E_peak": None if mean is None else 10 * mean,
        "prediction_error": 0.1,
        "plan_seconds": 1.0,
        "success": success,
        "failure": None if success else "torque of joint 1 reaches 2 of its limit",
        "info": {},
        **extra,
    }


def test_the_summary_of_hand_made_rows():
    """Ratios query by query, then the median: 0.5, 0.25, 2 -> 0.5 (not 1/3 of medians)."""
    rows = [
        row("straight", "a", 1.0),
        row("straight", "b", 4.0),
        row("straight", "c", 10.0),
        row("direct", "a", 0.5, prediction_error=-0.3, plan_seconds=2.0),
        row("direct", "b", 1.0, prediction_error=0.2, plan_seconds=4.0, success=False),
        row("direct", "c", 20.0, prediction_error=None, plan_seconds=9.0),
    ]
    straight, direct = summarise(rows)
    ones = dict.fromkeys(("ratio_median", "ratio_low", "ratio_high"), 1.0)
    expected = {"planner": "straight", "n": 3, "E_mean_median": 4.0, **ones}
    assert {name: straight[name] for name in expected} == expected
    expected = {
        "planner": "direct",
        "vehicle": "bent-thesis",
        "ratio_median": 0.5,
        "E_mean_median": 1.0,
        "success_rate": pytest.approx(2 / 3),
        "prediction_error_max": 0.3,  # of the one that kept its limits
        "plan_seconds_median": 4.0,
        "E_res_ratio_median": 0.5,
        "E_peak_ratio_median": 0.5,
    }
    assert {name: direct[name] for name in expected} == expected
    assert 0.25 <= direct["ratio_low"] <= 0.5 <= direct["ratio_high"] <= 2.0


def test_no_ratio_to_nothing():
    rows = summarise([row("straight", "a", 1.0, res=0.0), row("direct", "a", 0.5, res=0.0)])
    assert [r["E_res_ratio_median"] for r in rows] == [None, None]
    assert rows[1]["ratio_median"] == 0.5
    json.dumps(rows, allow_nan=False)
    _, dead = summarise([row("straight", "a", 0.0), row("direct", "a", 0.0)])
    assert dead["ratio_median"] is dead["ratio_low"] is None
    assert summarise([]) == []


def test_ranks_in_the_laboratory_and_in_space():
    """By query: one agrees, one is upside down, one too small to rank."""

    def pair(planner, query, emulated, ideal):
        return row(planner, query, emulated, E_mean_ideal=ideal)

    rows = [pair(p, "a", e, e) for p, e in zip("xyz", (1.0, 2.0, 3.0), strict=True)]
    rows += [pair(p, "b", e, -e) for p, e in zip("xyz", (1.0, 2.0, 3.0), strict=True)]
    rows += [pair("x", "c", 1.0, 1.0), pair("y", "c", 2.0, 2.0)]
    rows += [row("w", "a", None, E_mean_ideal=9.0)]  # stopped
    (correlation,) = rank_correlation(rows)
    assert correlation == {"vehicle": "bent-thesis", "duration": 1.0, "n": 2, "rho_median": 0.0}
    assert rank_correlation(rows[:3])[0]["rho_median"] == pytest.approx(1.0)


# ------------------------------------------------------------------------- what fails


class Broken:
    """A planner that crashes, gives up, or answers, by query."""

    name = "broken"
    summary = "for this test"

    def find(self, query, seed):
        if query.duration == 0.5:
            raise ZeroDivisionError("oh dear")
        raise NoPlan("no way there")


def test_a_planner_that_fails_costs_nothing_but_its_rows(monkeypatch):
    monkeypatch.setitem(PLANNERS, "broken", Broken())
    result = run_benchmark(small_suite(), planners=["broken"], workers=1)
    json.dumps(result, allow_nan=False)
    failures = {r["query"]: r["failure"] for r in result["rows"] if r["planner"] == "broken"}
    assert failures == {
        "reach-0.5s-000": "ZeroDivisionError: oh dear",
        "reach-2s-000": "no way there",
    }
    lost = [r for r in result["rows"] if r["planner"] == "broken"]
    assert all(r["E_mean"] is None and not r["success"] for r in lost)
    assert all(
        r["E_mean"] > 0 and r["failure"] is None for r in result["rows"] if r not in lost
    )
    summary = next(s for s in result["summary"] if s["planner"] == "broken")
    assert (summary["success_rate"], summary["ratio_median"]) == (0.0, None)
    assert [s["planner"] for t in result["traces"] for s in t["series"]] == ["straight"] * 2


def crashing(job):
    if job[1].name.endswith("001"):
        os._exit(1)
    return Plan(job[0], job[1], None, 0.0, "answered")


@pytest.mark.slow
def test_a_crash_of_a_planning_process_costs_one_query():
    suite = get_suite("reach100", system=BENT, vehicle="bent-thesis")
    work = [("straight", q, 0) for _, q in suite.queries[:4]]
    plans = list(_run_workers(work, 2, crashing))
    assert [p.query.name for p in plans] == [q.name for _, q, _ in work]
    assert [p.failure for p in plans] == [
        "answered", "the planning process crashed", "answered", "answered",
    ]  # fmt: skip


@pytest.mark.slow
def test_among_obstacles():
    """Ends inside one are said so; nothing that is called a success touches anything."""
    suite = get_suite("reach100", system=BENT, obstacles="both", vehicle="bent-thesis")
    assert len(suite.queries) == 800
    names = {"reach-1s-000", "reach-4s-001"}
    names |= {f"{name}-obstacles" for name in names}
    queries = tuple((v, q) for v, q in suite.queries if q.name in names)
    result = run_benchmark(
        dataclasses.replace(suite, queries=queries),
        planners=["ompl-time", "refined"],
        workers=1,
    )
    assert {r["vehicle"] for r in result["rows"]} == {"bent-thesis", "bent-thesis, obstacles"}
    assert set(result["systems"]) == {"bent-thesis", "bent-thesis, obstacles"}
    for row in result["rows"]:
        assert row["obstacles"] == row["query"].endswith("-obstacles")
        if not row["success"]:
            assert "too near" in row["failure"] or "limit" in row["failure"]
    refined = [r for r in result["rows"] if r["planner"] == "refined"]
    straight = [r for r in result["rows"] if r["planner"] == "straight" and r["obstacles"]]
    assert not all(r["success"] for r in straight)
    assert all(r["success"] for r in refined if "no motion" not in (r["failure"] or ""))
    among = [s for s in result["scenes"] if s["obstacles"]]
    assert among and {o["kind"] for o in among[0]["obstacles"]} == {"box", "sphere"}


# -------------------------------------------------------------------------- emulated

NAMES = ["straight", "bad-path"]


@pytest.fixture(scope="module")
def lab():
    """Two seconds on the straight beam; the bad path also with its weight."""
    system = System(mode="emulated", vehicle=STRAIGHT_HORIZONTAL_THESIS)
    ends = {"start": (0.0, -0.4, 0.8), "goal": (0.5, 0.0, 0.3)}
    question = Query(system=system, **ends, duration=2.0, name="go")
    return Suite(name="lab", queries=(("beam", question),), planners=("bad-path",))


def test_an_emulated_row_stands_beside_the_same_motion_in_space(lab):
    """Each run again on its own, in the laboratory and in space."""
    emulated = run_benchmark(lab, workers=1)
    assert emulated["mode"] == "emulated"
    assert [r["planner"] for r in emulated["rows"]] == NAMES
    system = lab.queries[0][1].system
    query = dataclasses.replace(lab.queries[0][1], system=system.ideal())
    for row in emulated["rows"]:
        name = row["planner"]
        plan, (laboratory, space), (E, E_space) = again(query, name, 0, system, query.system)
        assert row["mode"] == "emulated" and row["stopped"] is None
        assert row["success"] is (row["failure"] is None)
        assert row["success"] or "from the goal" in row["failure"]  # joint 2, by 0.01 rad
        assert row["E_mean"] == pytest.approx(E.E_mean)
        for key in ("E_mean", "E_res", "E_peak"):
            assert row[f"{key}_ideal"] == pytest.approx(getattr(E_space, key))
        assert row["emulation_error"] == pytest.approx(E.E_mean / E_space.E_mean - 1)
        error, far = (
            np.linalg.norm(part[0, :, :3], axis=-1).max()
            for part in (laboratory.y - space.y, space.y)
        )
        assert row["base_error"] == pytest.approx(error / far)
        assert row["predicted"] == plan.predicted.E_mean
        # a planner answers for the space system
        expected = plan.predicted.E_mean / E_space.E_mean - 1
        assert row["prediction_error"] == pytest.approx(expected)


def test_stopped_runs_have_a_reason_and_no_energy(lab):
    """A tenth of the weight drives the platform to the end of its legs."""
    ((vehicle, query),) = lab.queries
    heavy = query.system.replace(effects=(GravityScale(error=0.1),))
    queries = ((vehicle, dataclasses.replace(query, system=heavy)),)
    result = run_benchmark(dataclasses.replace(lab, queries=queries), workers=1)
    json.dumps(result, allow_nan=False)
    assert "gravity/scale" in result["machine"]["effects"]
    for row in result["rows"]:
        assert re.match(r"platform frozen at t = [\d.]+ s: .+", row["stopped"])
        assert row["success"] is False
        none = ("E_mean", "E_res", "t_5", "emulation_error", "base_error")
        assert {row[name] for name in none} == {None} and row["E_mean_ideal"] > 0
    for row in result["summary"]:
        assert (row["stopped"], row["n"], row["success_rate"]) == (1, 1, 0)
        assert row["E_mean_median"] is row["ratio_median"] is row["ratio_low"] is None
    assert result["traces"][0]["series"][0]["t"][-1] < 2
    for run in result["scenes"][0]["runs"]:
        assert run["base"][-1] == run["base"][-2]  # stays where it stopped
