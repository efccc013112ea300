"""The board says what its files say, and nothing is lost; the script fills it."""

import dataclasses
import json
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from scripts import leaderboard as script
from tests.leaderboard.entries import made_entry, noisy
from ves_gym._util.params import ParameterError
from ves_gym.leaderboard import statistics
from ves_gym.leaderboard.board import command, make_board, read_board
from ves_gym.leaderboard.entry import from_bytes, to_bytes
from ves_gym.leaderboard.problems import SCORES, problems
from ves_gym.leaderboard.verify import add

OFFICIAL = "official-0123456789abcdef"


@pytest.fixture
def entries():
    """Two problems, two kinds of seeds, one that was only replayed, three trainings."""
    out = []
    for problem in ("bent-1s", "bent-2s"):
        for k, name in enumerate(("straight", "refined")):
            scores = noisy(1.0 - 0.7 * k, seed=k, failed=2 * (1 - k))
            out.append(made_entry(name, scores=scores, problem=problem))
    out.append(made_entry("refined", scores=noisy(0.2), seeds=OFFICIAL))
    out.append(made_entry("believed", scores=noisy(0.01), level="replayed"))
    policy = {"track": "tasks", "problem": "ves/PumaReach-v0", "kind": "policy"}
    out.append(made_entry("ppo", scores=[noisy(2.0, seed=k) for k in range(3)], **policy))
    return out


def groups(board):
    return {
        (t["track"], g["problem"], g["seeds"]): g for t in board["tracks"] for g in t["groups"]
    }


def test_the_board_ranks_by_score_lowest_first(entries):
    board = make_board(entries)
    json.dumps(board, allow_nan=False)
    assert board == make_board(entries)
    assert [t["track"] for t in board["tracks"]] == ["paths", "tasks"]
    first, second = groups(board)["paths", "bent-1s", "public"]["entries"]
    assert (first["name"], second["name"]) == ("refined", "straight")
    assert first["rank"] == [1, 1, 1] and second["rank"] == [2, 2, 2]
    assert first["score"] == pytest.approx(statistics.score(entries[1].results), rel=1e-5)
    assert second["failed"] == 2 and second["success"][0] == 0.98
    assert "class" not in first


def test_a_board_of_tasks_tells_classes_and_trainings(entries):
    (ppo,) = groups(make_board(entries))["tasks", "ves/PumaReach-v0", "public"]["entries"]
    assert ppo["class"] == 1 and ppo["groups"] == 3 and len(ppo["by_group"]) == 3


def test_what_was_only_replayed_ranks_nowhere_and_seeds_are_not_mixed(entries):
    board = make_board(entries)
    assert [e["name"] for e in board["shown"]] == ["believed"]
    assert "believed" not in json.dumps(board["tracks"])
    (only,) = groups(board)["paths", "bent-2s", OFFICIAL]["entries"]
    assert only["rank"] == [1, 1, 1]


@pytest.mark.parametrize(
    ("code", "seeds", "after"),
    [
        ("ves_gym.planners.refine:Refined", "public", ""),
        ("https://example.org/x", "public", ""),
        ("x; rm -r ~:Planner", "public", ""),
        ("cma_es:Cma", "public", " --import examples/peers/cma_es.py"),
        ("ves_gym.a:B", OFFICIAL, f" --salt docs/leaderboard/salts/{OFFICIAL}"),
    ],
)
def test_an_entry_names_the_command_that_repeats_it(code, seeds, after):
    entry = made_entry("one", scores=noisy(1.0), seeds=seeds)
    told = command(dataclasses.replace(entry, about={"code": code}))
    place = f"docs/leaderboard/entries/{entry.file}"
    assert told == f"ves-gym leaderboard verify {place}{after}"


def test_a_board_is_read_from_its_files(entries, tmp_path):
    for entry in entries:
        add(tmp_path, entry)
    assert len(list(tmp_path.iterdir())) == len(entries)
    files = {e.file: e for e in read_board(tmp_path)}
    assert files.keys() == {e.file for e in entries}
    ours = from_bytes(to_bytes(entries[0])).results
    theirs = files[entries[0].file].results
    assert all(np.array_equal(ours[k], theirs[k]) for k in ours)


def test_files_that_are_no_entries_are_named(entries, tmp_path):
    place = add(tmp_path, entries[0])
    good = place.read_bytes()
    place.rename(tmp_path / "paths_bent-1s_ves-gym_other.json")
    with pytest.raises(ParameterError, match="belongs to paths_bent-1s_ves-gym_straight"):
        read_board(tmp_path)
    (tmp_path / "paths_bent-1s_ves-gym_other.json").unlink()
    place.write_bytes(good[:-5])
    with pytest.raises(ParameterError, match=r"straight\.json: malformed-entry"):
        read_board(tmp_path)
    few = made_entry("straight", scores=[1.0] * 5, problem="bent-1s")
    place.write_bytes(to_bytes(few))
    with pytest.raises(ParameterError, match="5 results, bent-1s asks 100"):
        read_board(tmp_path)
    gone = made_entry("straight", scores=noisy(1.0), problem="ves/Gone-v0", track="tasks")
    place.unlink()
    (tmp_path / gone.file).write_bytes(to_bytes(gone))
    with pytest.raises(ParameterError, match="problem of track tasks"):
        read_board(tmp_path)
    with pytest.raises(ParameterError, match="no such board"):
        read_board(tmp_path / "none")


def test_the_table_of_the_script_has_every_problem_and_nothing_twice():
    table = script.table()
    assert len(set(table)) == len(table)
    whole = {(t, p) for t in SCORES for p in problems(t) if not p.endswith("-quick")}
    assert {(w.track, w.problem) for w in table} == whole


def test_filling_goes_on_where_it_stopped(tmp_path, monkeypatch, capsys):
    """What is there is left alone, what fails keeps nothing else from the board."""
    there = made_entry("straight", scores=noisy(1.0), problem="bent-1s")
    add(tmp_path / "entries", there)

    def answer(wanted, salt):
        if wanted.method != "direct":
            raise ValueError("nothing found")
        return made_entry("direct", scores=noisy(0.5), problem="bent-1s")

    monkeypatch.setattr(script, "Workers", ThreadPoolExecutor)
    monkeypatch.setattr(script, "answer", answer)
    words = ["--board", str(tmp_path / "entries"), "--problem", "bent-1s"]
    for method in ("straight", "direct", "refined"):
        words += ["--method", method]
    assert script.main(words) == 1
    out = capsys.readouterr().out
    assert "1 of 3 entries are on the board" in out
    assert "paths bent-1s refined: FAILED: nothing found" in out
    assert [e.name for e in read_board(tmp_path / "entries")] == ["direct", "straight"]
    assert (tmp_path / "index.html").exists()
