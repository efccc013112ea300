"""`ves-gym plan` and `ves-gym benchmark` with obstacles, searches and best known energies."""

import json

import numpy as np
import pytest

from ves_gym._util.params import write_table
from ves_gym.planners.benchmark_summary import read_best
from ves_gym.planners.obstacles import Box, Sphere, Surroundings, collisions
from ves_gym.system.system import System

ROOM = Surroundings(obstacles=(Box(centre=(0.75, 0.0, 0.7), size=(0.2, 0.2, 0.8)),))
ACROSS = ("--start", "-57,6,11", "--goal", "57,6,11", "--duration", "4")
SMALL = ("--planner", "ompl-time", "--evaluations", "5000")


@pytest.fixture
def room(tmp_path):
    write_table(tmp_path / "room.toml", ROOM)
    return tmp_path / "room.toml"


def test_a_path_around_obstacles(call, room):
    status, out, _, result = call("plan", *ACROSS, "--obstacles", room, *SMALL)
    assert status == 0 and "inside the limits" in out
    assert result["failure"] is None and result["info"]["algorithm"] == "bitstar"
    assert collisions(System(), ROOM).first_contact(result["path"]) is None
    status, out, _, result = call("plan", *ACROSS, "--obstacles", room, "--planner", "straight")
    assert status == 1 and "obstacle 1 (box)" in out
    assert "obstacle 1 (box)" in result["failure"] and not result["feasible"]


def test_no_path_is_a_negative_verdict_that_says_why(call, tmp_path):
    inside = Surroundings(obstacles=(Sphere(centre=(0.5, 0.9, 0.9), radius=0.5),))
    write_table(tmp_path / "room.json", inside)
    status, out, _, result = call(
        "plan", *ACROSS, "--obstacles", tmp_path / "room.json", *SMALL
    )
    assert status == 1 and "is too near: " in out
    assert result["failure"] in out and "path" not in result


def test_the_search_is_as_asked(call):
    words = ("--algorithm", "rrtstar", "--evaluations", "700", "--seconds", "20")
    _, _, _, result = call("plan", "--goal", "40,20,-20", "--planner", "ompl-q", *words)
    assert result["info"]["algorithm"] == "rrtstar"
    # half of them search; relaxing what was found ends at its minimum: 566 in all
    assert 350 <= result["info"]["evaluations"] < 1200


def test_a_plan_weighs_the_motion_of_the_base(call):
    words = ("plan", "--goal", "40,20,-20", "--duration", "1")
    _, out, _, plain = call(*words)
    options = ("--weight", "acceleration_peak=0.1", "--weight", "tip=0.1")
    status, out, _, calm = call(*words, *options, "--frequency-weight", "0.2:1,5:0")
    assert status == 0 and calm["planner"] == "direct:acceleration_peak=0.1+tip=0.1"
    assert "acceleration_peak [m/s^2]" in out and "gain 1, 0 above 1 Hz" in out
    before, after = (k["disturbance"]["simulated"] for k in (plain, calm))
    assert after["acceleration_peak"] < 0.7 * before["acceleration_peak"]
    for name, value in calm["disturbance"]["predicted"].items():
        off = 0.06 if name.endswith("_end") else 0.03  # what is left is small
        assert value == pytest.approx(after[name], rel=off), name
    assert calm["disturbance"]["straight"]["acceleration_peak"] > 0
    assert calm["simulated"]["E_mean"] > plain["simulated"]["E_mean"]


def test_a_benchmark_of_weights_shows_what_they_buy(call, tmp_path):
    options = ("--first", "1", "--durations", "0.5", "--workers", "1", "--planners", "straight")
    status, out, _, result = call(
        "benchmark", *options, "--weights", "acceleration_peak=0.01,0.3"
    )
    assert status == 0 and (tmp_path / "out" / "pareto.png").stat().st_size > 10_000
    rows = {row["planner"]: row for row in result["rows"]}
    names = ["refined", *(f"refined:acceleration_peak={w}" for w in ("0.01", "0.3"))]
    assert list(rows) == ["straight", *names]
    peaks = [rows[name]["acceleration_peak"] for name in names]
    assert peaks[0] > peaks[1] > peaks[2]
    assert "Motion of base and tool" in out and "0, 1 above 1 Hz" in out


def test_benchmark_asks_any_arm(call):
    options = ("--planners", "straight", "--first", "1", "--durations", "2", "--workers", "1")
    status, _, _, result = call("benchmark", "--arm", "iiwa14", *options, "--no-figures")
    assert status == 0
    (row,) = result["rows"]
    assert row["success"] and row["query"] == "reach-2s-000"
    assert "iiwa" in result["systems"]["bent"]["description"]


def test_benchmark_shows_why_a_planner_refuses(call):
    words = ("benchmark", "--vehicle", "free-floating", "--first", "1", "--durations", "2")
    words += (
        "--planners",
        "straight,hotspot-q,reaction-null",
        "--workers",
        "1",
        "--no-figures",
    )
    status, out, _, result = call(*words)
    assert status == 0
    failures = {r["planner"]: r["failure"] for r in result["rows"]}
    assert failures["straight"] is None
    assert failures["hotspot-q"].endswith("has no stiffness (Q = 0)")
    assert failures["reaction-null"].startswith("no reactionless motion: every motion of 3 ")
    for name in ("hotspot-q", "reaction-null"):
        assert f"failed 1 x: {name}: {failures[name]}" in out.replace("\n", " ")


def test_acceleration_limits_are_kept(call):
    _, _, _, result = call("plan", "--goal", "20,10,-20", "--a-max", "60,60,90")
    t, q = np.array(result["t"]), np.array(result["path"])
    a = np.abs(np.gradient(np.gradient(q, t, axis=0), t, axis=0)[3:-3])
    assert (a <= np.deg2rad([60, 60, 90]) * 1.02).all()


BENCHMARK = ("benchmark", "--durations", "2", "--first", "1", "--workers", "1", "--no-figures")


def test_a_part_of_the_suite(call):
    status, out, _, result = call(*BENCHMARK, "--planners", "straight", "--obstacles", "both")
    assert status == 0
    assert [r["query"] for r in result["rows"]] == ["reach-2s-000", "reach-2s-000-obstacles"]
    assert "bent, obstacles" in out
    _, _, _, result = call(*BENCHMARK, "--planners", "straight", "--skip", "3")
    assert [r["query"] for r in result["rows"]] == ["reach-2s-003"]


def test_every_planner_by_one_word(call, monkeypatch):
    from ves_gym.planners.registry import PLANNERS

    for name in list(PLANNERS):
        if name not in ("straight", "smooth-jerk", "direct"):
            monkeypatch.delitem(PLANNERS, name)
    _, _, _, result = call(*BENCHMARK, "--planners", "all")
    assert [r["planner"] for r in result["rows"]] == ["straight", "smooth-jerk", "direct"]


def test_best_energies_are_kept(call, tmp_path):
    path = tmp_path / "best.json"
    _, out, _, result = call(*BENCHMARK, "--planners", "direct", "--keep-best", path)
    assert "best known: 1 new or lower" in out
    (entry,) = read_best(path).values()
    direct = next(r for r in result["rows"] if r["planner"] == "direct")
    assert entry["E_mean"] == pytest.approx(direct["E_mean"], rel=1e-8)
    assert json.loads(path.read_text())["unit"] == "J"
    # the packaged file knows this query: its straight line scores 0
    assert [r["score"] for r in result["rows"]] == [0.0, pytest.approx(1.0, abs=0.05)]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("plan", "--goal", "1,1,1", "--algorithm", "rrtstar"), "--algorithm is for planners"),
        (("plan", "--goal", "1,1,1", "--weight", "tpi=1"), "tip"),
        (("plan", "--goal", "1,1,1", "--weight", "tip"), "NAME=VALUE"),
        (("plan", "--goal", "1,1,1", "--planner", "bad-path", "--weight", "tip=1"), "direct,"),
        (
            ("plan", "--goal", "1,1,1", "--planner", "straight:tip=1"),
            "weights are for planners",
        ),
        (("plan", "--goal", "1,1,1", "--frequency-weight", "1"), "HZ:GAIN"),
        (("benchmark", "--weights", "0.1,0.2"), "--weights must be like"),
        (("plan", "--goal", "1,1,1", *SMALL, "--algorithm", "prm"), "must be one of rrtstar"),
        (("plan", "--goal", "1,1,1", "--obstacles", "none.toml"), "none.toml"),
        ((*BENCHMARK, "--obstacles", "some"), "obstacles must be one of off, on, both"),
        (("benchmark", "--suite", "thesis", "--obstacles", "on"), "thesis has no obstacles"),
        (("benchmark", "--durations", "3"), "--durations must be of 0.5, 1, 2, 4 s, got 3"),
        (("benchmark", "--durations", "x"), "--durations must be numbers like 1,2,4 [s]"),
        (("benchmark", "--first", "0"), "--first must be >= 1, got 0"),
        (("benchmark", "--skip", "-1"), "--skip must be >= 0, got -1"),
        (("benchmark", "--skip", "100"), "--skip 100 leaves none of 100 queries"),
    ],
)
def test_words_that_are_refused(refused, words, message):
    assert message in refused(*words)
