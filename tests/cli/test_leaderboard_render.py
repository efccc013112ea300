"""`ves-gym leaderboard render`: page and tables from a journal, or a line that says why not."""

import json

import pytest

from tests.entries import made_entry
from ves_gym.cli.main import main
from ves_gym.leaderboard.journal import append, read


@pytest.fixture
def board(tmp_path):
    path = tmp_path / "board.jsonl"
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
    assert "not ranked: line 4, few: track paths needs at least 20 episodes, got 4" in out


def test_a_torn_line_is_told_and_the_rest_rendered(call, board):
    with open(board, "ab") as file:
        file.write(b'{"entry":')
    status, out, err, _ = call("leaderboard", "render", board)
    assert status == 0 and out.startswith("3 entries")
    assert "the last line was cut short (9 bytes)" in err


@pytest.mark.parametrize("fault", ["changed", "removed", "head", "missing"])
def test_a_broken_journal_renders_nothing(call, board, tmp_path, fault):
    lines = board.read_bytes().splitlines(keepends=True)
    words, where = [], "line 2"
    if fault == "changed":
        lines[1] = lines[1].replace(b"2.0", b"0.1")
    elif fault == "removed":
        del lines[1]
    elif fault == "head":
        words, where = ["--head", "0" * 64], "line 3"
    board.write_bytes(b"".join(lines))
    if fault == "missing":
        board.unlink()
        where = "no such journal"
    status, out, err, result = call("leaderboard", "render", board, *words)
    assert (status, out, result) == (2, "", None)
    assert where in err
    assert not (tmp_path / "out").exists()


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
