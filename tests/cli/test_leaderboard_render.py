"""`ves-gym leaderboard render`: page and tables from a journal, or a line that says why not."""

import json
import subprocess

import pytest

from tests.entries import made_entry
from ves_gym.cli.main import main
from ves_gym.leaderboard.journal import append, read


@pytest.fixture
def board(tmp_path):
    path = tmp_path / "entries"
    for k in range(3):
        append(path, made_entry(f"planner {k}", scores=[1.0 + k] * 20))
    return path


def test_it_writes_the_page_and_the_tables(call, board, tmp_path):
    status, out, err, result = call("leaderboard", "render", board, "--sqlite", "--parquet")
    assert (status, err) == (0, "")
    assert read(board).head in out
    names = {p.name for p in (tmp_path / "out").iterdir()}
    assert names == {
        "index.html",
        "board.sqlite",
        "entries.parquet",
        "episodes.parquet",
        "anytime.parquet",
    }
    (group,) = result["tracks"][0]["groups"]
    assert [e["name"] for e in group["entries"]] == [f"planner {k}" for k in range(3)]


def test_the_same_journal_gives_the_same_page(call, board, tmp_path):
    pages = []
    for _ in range(2):
        assert call("leaderboard", "render", board)[0] == 0
        pages.append((tmp_path / "out" / "index.html").read_bytes())
    assert pages[0] == pages[1]


def test_entries_that_cannot_be_ranked_are_named(call, board):
    append(board, made_entry("few"))
    status, out, _, _ = call("leaderboard", "render", board)
    assert status == 0
    entry = read(board).records[3].id
    assert f"not ranked: {entry}, few: track paths needs at least 20 episodes, got 4" in out


@pytest.mark.parametrize("fault", ["changed", "alien", "head", "missing", "older"])
def test_a_broken_board_renders_nothing(call, board, tmp_path, fault):
    first = min(board.iterdir())
    words, where, place = [], first.name, board
    if fault == "changed":
        first.write_bytes(first.read_bytes().replace(b"0.5", b"0.1"))
    elif fault == "alien":
        first.rename(board / "x.json")
        where = "x.json"
    elif fault == "head":
        words, where = ["--head", "0" * 64], "3 entries have the hash"
    elif fault == "missing":
        place, where = tmp_path / "none", "no such board"
    else:
        place, where = tmp_path / "board.jsonl", "a board is a folder"
        place.write_text("")
    status, out, err, result = call("leaderboard", "render", place, *words)
    assert (status, out, result) == (2, "", None)
    assert where in err
    assert not (tmp_path / "out").exists()


def test_check_names_files_and_commits(call, board):
    """Outside of git there is no history to check: said in one line."""
    status, out, err, _ = call("leaderboard", "check", board)
    assert (status, out) == (2, "") and "git" in err and err.count("\n") == 1
    subprocess.run(["git", "init", "-q", str(board.parent)], check=True)
    status, _, err, _ = call("leaderboard", "check", board)
    assert status == 2 and "git says" in err  # no commit yet
    who = ["-c", "user.name=a", "-c", "user.email=a@example.org"]
    subprocess.run(["git", "-C", str(board), "add", "."], check=True)
    subprocess.run(["git", "-C", str(board), *who, "commit", "-qm", "x"], check=True)
    status, out, err, result = call("leaderboard", "check", board, "--since", "HEAD")
    assert (status, err, result["faults"]) == (0, "", [])
    assert out.startswith("3 entries, 0 faults")
    first = min(board.iterdir())
    first.write_bytes(first.read_bytes() + b" ")
    status, _, err, result = call("leaderboard", "check", board)
    assert status == 1 and len(result["faults"]) == 2 and err.count(first.name) >= 2


def test_options_before_and_after_the_action(board, tmp_path, capsys):
    for k, words in enumerate(
        (
            ["leaderboard", "--out", "{}", "render", "{board}"],
            ["leaderboard", "render", "{board}", "--out", "{}"],
        )
    ):
        folder = tmp_path / str(k)
        assert main([w.format(folder, board=board) for w in words]) == 0
        assert (folder / "index.html").exists()
    assert json.dumps(capsys.readouterr().out).count("written") == 2
