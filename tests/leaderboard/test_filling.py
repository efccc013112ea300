"""`make leaderboard`: the table names what there is, and filling goes on where it stopped."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from scripts import leaderboard as filling
from ves_gym.leaderboard.journal import read
from ves_gym.leaderboard.protocol import PROTOCOL, get_problem, problems
from ves_gym.leaderboard.tracks.selectors import SELECTORS
from ves_gym.planners.registry import PLANNERS

ROOT = Path(__file__).parents[2]
PROGRAM = ROOT / "scripts/leaderboard.py"


def test_the_table_has_every_problem_and_nothing_twice():
    table = filling.table(whole_blind=True)
    assert len({str(w) for w in table}) == len({w.bundle for w in table}) == len(table)
    for wanted in table:
        assert get_problem(wanted.track, wanted.problem).name == wanted.problem
    there = {(w.track, w.problem) for w in table}
    known = {(t, p) for t in PROTOCOL for p in problems(t) if not p.endswith(filling.QUICK)}
    assert there >= known - {("discrepancy", "blind-sealed")}  # of the maintainer's salt
    assert {w.method for w in table if w.track == "discrepancy"} == set(SELECTORS)
    planners = {w.method for w in table if w.track == "paths"}
    # damp answers queries that begin with a moving base, robust ones for an uncertain machine;
    # those of the board begin at rest, on a machine that is known
    other_questions = {"damp", "robust", "robust-worst"}
    assert planners == set(PLANNERS) - {"bad-path", "refined-long"} - other_questions


def test_selectors_that_read_the_same_diagnoses_are_one_job(monkeypatch):
    table = filling.table(whole_blind=True)
    jobs = filling.in_jobs(table)
    assert [w for part in jobs for w in part if w.track != "discrepancy"] == [
        w for w in table if w.track != "discrepancy"
    ]
    together = [part for part in jobs if part[0].track == "discrepancy"]
    assert {part[0].problem for part in together} == {
        "blind-development", f"blind-development{filling.QUICK}"
    }  # fmt: skip
    assert all({w.method for w in part} == set(SELECTORS) for part in together)

    def prove(wanted, blind):
        if wanted.method == SELECTORS[1]:
            raise ValueError("no answer")
        return wanted

    monkeypatch.setattr(filling, "prove", prove)
    entries = filling.prove_each(together[0], None)
    assert sum(isinstance(e, ValueError) for e in entries) == 1
    assert [w for w in together[0] if w.method != SELECTORS[1]] == [
        e for e in entries if not isinstance(e, ValueError)
    ]


@pytest.mark.slow
def test_filling_goes_on_where_it_stopped(tmp_path):
    board = tmp_path / "entries"

    def fill(*skip):
        words = [word for name in skip for word in ("--skip", name)]
        done = subprocess.run(
            [sys.executable, str(PROGRAM), "--quick", "--board", str(board), *words,
             "--problem", "ves/PumaReach-v0"],
            cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(ROOT)}, check=True,
            capture_output=True, text=True,
        )  # fmt: skip
        return done.stdout

    assert fill("random", "hold", "resolved").startswith("0 of 2 entries")
    (bundle,) = (tmp_path / "out/leaderboard/bundles").glob("*-ppo.zip")
    entries = [r.entry for r in read(board).records]
    assert [e["name"] for e in entries] == ["zero", "ppo"]
    assert {e["level"] for e in entries} == {"reproduced"}
    first = sorted(board.iterdir())

    assert fill("random", "hold", "resolved").startswith("2 of 2 entries")
    assert sorted(board.iterdir()) == first
    (board / read(board).records[1].name).unlink()  # its bundle is there still
    bundle.write_bytes(bundle.read_bytes()[:-100])  # and damaged
    assert fill("random", "resolved").startswith("1 of 3 entries")
    assert [r.entry["name"] for r in read(board).records] == ["zero", "hold", "ppo"]
    assert "ppo" in (tmp_path / "index.html").read_text("utf-8")
