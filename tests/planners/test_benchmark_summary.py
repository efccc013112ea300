"""Best known energies: merged from results, never worse, and scores relative to them."""

import json

import pytest

from ves_gym._util.params import ParameterError
from ves_gym.mechanics.vehicle import VEHICLES
from ves_gym.planners import benchmark
from ves_gym.planners.benchmark import (
    add_scores,
    key,
    merge_best,
    near_best,
    packaged,
    read_best,
)
from ves_gym.planners.suites import get_suite
from ves_gym.system.system import System

HASH = "0123456789abcdef"


def row(planner, query, energy, success=True):
    return {
        "planner": planner,
        "query": query,
        "vehicle": "bent-thesis",
        "E_mean": energy,
        "success": success,
    }


def result(*rows, mode="ideal", seed=3):
    return {
        "mode": mode,
        "seed": seed,
        "systems": {"bent-thesis": {"hash": HASH}},
        "rows": list(rows),
    }


def test_the_least_energy_stays(tmp_path):
    path = tmp_path / "best.json"
    assert merge_best(path, result(row("straight", "a", 1.0), row("direct", "a", 0.5))) == 1
    assert merge_best(path, result(row("refined", "a", 0.4), row("straight", "b", 2.0))) == 2
    assert merge_best(path, result(row("direct", "a", 0.45))) == 0
    entries = read_best(path)
    assert {k: (e["E_mean"], e["planner"], e["seed"]) for k, e in entries.items()} == {
        key(HASH, "a"): (0.4, "refined", 3),
        key(HASH, "b"): (2.0, "straight", 3),
    }
    assert json.loads(path.read_text())["format"] == "ves-best/1"


def test_what_breaks_a_limit_or_has_no_energy_does_not_count(tmp_path):
    path = tmp_path / "best.json"
    rows = row("refined", "a", 0.1, success=False), row("ompl-q", "b", None, success=False)
    assert merge_best(path, result(*rows)) == 0
    assert read_best(path) == {}
    assert read_best(tmp_path / "none.json") == {}


def test_only_motions_in_space_count(tmp_path):
    with pytest.raises(ParameterError, match="are of mode ideal, got emulated"):
        merge_best(tmp_path / "best.json", result(mode="emulated"))


def test_another_file_is_refused(tmp_path):
    path = tmp_path / "best.json"
    path.write_text('{"format": "ves-motion/1"}')
    with pytest.raises(ParameterError, match=r"best\.json: format must be 'ves-best/1'"):
        read_best(path)
    path.write_text('{"format": "ves-best/1", "entries": {"a": {"E_mean": "low"}}}')
    with pytest.raises(ParameterError, match=r"best\.json: 'a' must hold a number E_mean"):
        read_best(path)


def test_scores(monkeypatch):
    """0 for the straight line, 1 for the best known, above it for better still."""
    best = {key(HASH, "a"): {"E_mean": 0.2}}
    monkeypatch.setattr(benchmark, "packaged", lambda: best)
    rows = [
        row("straight", "a", 1.0),
        row("direct", "a", 0.6),
        row("refined", "a", 0.2),
        row("new", "a", 0.1),
        row("broken", "a", None, success=False),
        row("fast", "a", 0.15, success=False),
        row("straight", "b", 1.0),
    ]
    add_scores(rows, {"bent-thesis": HASH})
    assert [r["score"] for r in rows] == [
        0.0, pytest.approx(0.5), 1.0, pytest.approx(1.125), None, None, None,
    ]  # fmt: skip
    assert [r["best_known"] for r in rows] == [0.2] * 6 + [None]
    assert near_best(rows[:4]) == 0.5
    assert near_best(rows[5:6]) == 0.0  # it breaks a limit
    assert near_best(rows[6:]) is None


def test_the_packaged_file_is_of_the_suite():
    """Every entry is a question of reach100 on a bent beam or the straight one along x."""
    names = set()
    for vehicle in ("bent-thesis", "bent", "straight-horizontal"):
        suite = get_suite("reach100", system=System(), obstacles="both", vehicle=vehicle)
        described = System(vehicle=VEHICLES[vehicle]).hash
        names |= {key(described, q.name) for _, q in suite.queries}
    entries = packaged()
    assert entries.keys() <= names
    assert all(e["E_mean"] > 0 and e["planner"] for e in entries.values())
