"""Tables and the board say what the journal says, and nothing of it is lost."""

import json
import sqlite3
from contextlib import closing

import numpy as np
import pytest

from ves_gym.leaderboard import statistics
from ves_gym.leaderboard.board import ALL, make_board
from ves_gym.leaderboard.journal import append, check, read
from ves_gym.leaderboard.protocol import salt_mark
from ves_gym.leaderboard.seasons import Season, season_file, write_season
from ves_gym.leaderboard.table import make_tables, write_parquet, write_sqlite


@pytest.fixture
def journal(tmp_path, make_entry, noisy_scores):
    """Nine entries: two problems, two kinds of seeds, one that came again, two unranked."""
    path = tmp_path / "entries"
    curve = {"anytime": [[0.1, 4.0], [0.4, 1.0]]}
    for problem in ("reach100-1s", "reach100-2s"):
        for k, name in enumerate(("refined", "straight")):
            scores = noisy_scores(0.3 + 0.7 * k, n=30, seed=k, failed=2 * k)
            entry = make_entry(name, scores=scores, problem=problem)
            if name == "refined":
                for row in entry["rows"]:
                    row.update(curve)
            append(path, entry)
    append(path, make_entry("refined", scores=noisy_scores(0.2, n=30), problem="reach100-2s"))
    append(path, make_entry("refined", scores=noisy_scores(0.2, n=30), seeds="official"))
    append(path, make_entry("few", scores=[0.1] * 5))
    append(path, make_entry("more", scores=[0.1] * 31))
    policy = {"track": "policies", "problem": "ves/PumaReach-v0", "kind": "policy"}
    append(path, make_entry("ppo", scores=noisy_scores(2.0, n=60), groups=3, **policy))
    return read(path)


def ids(journal, *places):
    return [journal.records[k].id for k in places]


def group(board, track, problem, seeds="public"):
    groups = [g for t in board["tracks"] if t["track"] == track for g in t["groups"]]
    (found,) = [g for g in groups if (g["problem"], g["seeds"]) == (problem, seeds)]
    return found


# ---------------------------------------------------------------------------- board


def test_the_board_ranks_by_score_lowest_first(journal):
    board = make_board(journal)
    json.dumps(board, allow_nan=False)
    assert board == make_board(journal)
    assert board["head"] == journal.head and board["entries"] == 9
    assert [t["track"] for t in board["tracks"]] == ["paths", "policies"]
    first, second = group(board, "paths", "reach100-1s")["entries"]
    assert (first["name"], second["name"]) == ("refined", "straight")
    assert first["rank"] == [1, 1, 1] and second["rank"] == [2, 2, 2]
    assert first["score"] == pytest.approx(
        statistics.score([journal.records[0].entry]), rel=1e-5
    )
    assert second["failed"] == 2 and second["success"][0] == pytest.approx(28 / 30)
    assert second["ids"] == ids(journal, 1) and first["bundle"] == "ab" * 32


def test_an_entry_that_came_again_replaces_the_first(journal):
    first = group(make_board(journal), "paths", "reach100-2s")["entries"][0]
    assert first["ids"] == ids(journal, 4)


def test_what_was_only_replayed_is_shown_and_replaces_nothing(
    tmp_path, make_entry, noisy_scores
):
    """A false score under the name of a reproduced entry, and one of its own."""
    path = tmp_path / "entries"
    append(path, make_entry("ppo", scores=noisy_scores(0.5)))
    for name in ("ppo", "other"):
        append(path, make_entry(name, scores=noisy_scores(0.01)) | {"level": "replayed"})
    board = make_board(read(path))
    (only,) = group(board, "paths", "reach100-2s")["entries"]
    assert only["name"] == "ppo" and only["ids"] == ids(read(path), 0)
    (shown,) = board["shown"]
    assert shown["name"] == "other" and shown["why"].startswith("replayed")
    append(path, make_entry("ppo", scores=noisy_scores(0.4)))  # reproduced again: that counts
    (only,) = group(make_board(read(path)), "paths", "reach100-2s")["entries"]
    assert only["ids"] == ids(read(path), 3)


def test_seeds_are_not_mixed(journal):
    (only,) = group(make_board(journal), "paths", "reach100-2s", "official")["entries"]
    assert only["ids"] == ids(journal, 5) and only["rank"] == [1, 1, 1]


def test_seasons_of_official_seeds_are_not_mixed(tmp_path, make_entry, noisy_scores):
    path, marks = tmp_path / "entries", [salt_mark(f"a salt, number {k}") for k in range(3)]
    write_season(season_file(path, "2026-11"), Season(marks[0]))
    write_season(season_file(path, "2026-12"), Season(marks[1]))
    for k, mark in enumerate(marks):
        entry = make_entry("refined", scores=noisy_scores(0.2 + k, n=30), seeds="official")
        entry["about"]["salt"] = mark
        append(path, entry)
    journal = read(path)
    for k, season in enumerate(("2026-11", "2026-12", marks[2][:8])):
        board = group(make_board(journal), "paths", "reach100-2s", f"official {season}")
        assert [e["ids"] for e in board["entries"]] == [ids(journal, k)]


def test_a_season_that_cannot_be_read_is_a_fault_of_the_board(tmp_path):
    file = season_file(tmp_path / "entries", "2026-11")
    file.parent.mkdir()
    file.write_text("{}")
    (fault,) = check(tmp_path / "entries").problems
    assert "2026-11.json: expected mark, salt, schema" in fault


def test_all_problems_are_one_table_where_scores_are_relative(journal):
    whole = group(make_board(journal), "paths", ALL)
    assert [e["name"] for e in whole["entries"]] == ["refined", "straight"]
    assert whole["entries"][0]["episodes"] == 60 and whole["entries"][0]["ids"] == ids(
        journal, 0, 4
    )
    both = [journal.records[k].entry for k in (0, 4)]
    assert whole["entries"][0]["score"] == pytest.approx(statistics.score(both), rel=1e-5)


def test_what_cannot_be_compared_is_named_not_ranked(journal):
    board = make_board(journal)
    few, more = board["unranked"]
    assert [few["id"]] == ids(journal, 6) and "at least 20 episodes, got 5" in few["why"]
    assert [more["id"]] == ids(journal, 7) and more["why"] == "other episodes than the rest"
    names = {e["name"] for t in board["tracks"] for g in t["groups"] for e in g["entries"]}
    assert names == {"refined", "straight", "ppo"}


def test_scores_of_different_scales_are_not_pooled(tmp_path, make_entry, noisy_scores):
    path = tmp_path / "entries"
    for problem in ("ves/PumaReach-v0", "ves/BeamLQR-v0"):
        append(path, make_entry(scores=noisy_scores(1.0), problem=problem, track="policies"))
    (track,) = make_board(read(path))["tracks"]
    assert [g["problem"] for g in track["groups"]] == ["ves/BeamLQR-v0", "ves/PumaReach-v0"]


def test_a_share_has_no_profile(tmp_path, make_entry):
    entry = make_entry(scores=[0.0, 1.0] * 60, track="discrepancy", problem="blind-development")
    append(tmp_path / "entries", entry)
    (only,) = make_board(read(tmp_path / "entries"))["tracks"][0]["groups"]
    assert (only["statistic"], only["profiles"]) == ("mean", None)
    assert only["entries"][0]["score"][0] == 0.5


def test_an_older_version_is_history(tmp_path, make_entry, noisy_scores):
    """Not ranked, not among those that count, and still there to be read with its reason."""
    path = tmp_path / "entries"
    append(path, make_entry("old", scores=noisy_scores(0.1), protocol=1))
    # came again in its time
    append(path, make_entry("old", scores=noisy_scores(0.2), protocol=1))
    append(path, make_entry("old", scores=noisy_scores(0.6), protocol=2))
    append(path, make_entry("new", scores=noisy_scores(0.5), protocol=2))

    def history(entry):
        return None if entry["protocol"] == 2 else "rules 1 of the track, today 2"

    board = make_board(read(path), history)
    (track,) = board["tracks"]
    assert track["protocol"] == 2
    assert [e["name"] for e in track["groups"][0]["entries"]] == ["new", "old"]
    (past,) = board["history"]
    assert ([past["id"]], past["name"], past["problem"]) == (
        ids(read(path), 1),
        "old",
        "reach100-2s",
    )
    assert past["why"] == "rules 1 of the track, today 2" and past["level"] == "reproduced"
    assert past["score"] == pytest.approx(
        statistics.score([read(path).records[1].entry]), rel=1e-5
    )
    rows = make_tables(read(path), history)["entries"]
    assert [row["current"] for row in rows] == [False, False, True, True]


def test_training_seeds_are_told_apart(journal):
    (ppo,) = group(make_board(journal), "policies", "ves/PumaReach-v0")["entries"]
    assert (ppo["episodes"], ppo["training_seeds"]) == (60, 3)
    assert len(ppo["by_training_seed"]) == 3


def test_curves_belong_to_who_told_of_them(journal):
    found = group(make_board(journal), "paths", "reach100-1s")["anytime"]
    assert found["curves"][1] is None
    curve = [np.inf if k is None else k for k in found["curves"][0]]
    assert (np.diff(curve) <= 0).all()
    score = group(make_board(journal), "paths", "reach100-1s")["entries"][0]["score"][0]
    assert curve[-1] == pytest.approx(score, rel=1e-5)
    assert curve[0] == pytest.approx(4 * score, rel=1e-5)


def test_an_empty_journal_is_an_empty_board(tmp_path):
    board = make_board(read(tmp_path / "none"))
    assert board["tracks"] == [] and board["newest"] is None


# --------------------------------------------------------------------------- tables


def test_sqlite_holds_every_row(journal, tmp_path):
    path = tmp_path / "board.sqlite"
    write_sqlite(journal, path)
    with closing(sqlite3.connect(path)) as base:
        one = base.execute("SELECT head, entries FROM journal").fetchone()
        assert one == (journal.head, 9)
        rows = base.execute(
            "SELECT count(*), count(score), sum(failed) FROM episodes"
        ).fetchone()
        assert rows == (4 * 30 + 2 * 30 + 5 + 31 + 180, 4 * 30 - 4 + 2 * 30 + 5 + 31 + 180, 4)
        score, low, current = base.execute(
            "SELECT score, score_low, current FROM entries WHERE entry = ?",
            ids(journal, 4),
        ).fetchone()
        assert (score, low) == tuple(statistics.score([journal.records[4].entry]))[:2]
        assert current == 1
        (past,) = base.execute("SELECT entry FROM entries WHERE NOT current").fetchall()
        assert list(past) == ids(journal, 2)
        assert base.execute("SELECT count(*) FROM anytime").fetchone() == (2 * 30 * 2,)
        about = base.execute(
            "SELECT about FROM entries WHERE entry = ?", ids(journal, 0)
        ).fetchone()[0]
        assert json.loads(about) == journal.records[0].entry["about"]


def test_the_same_journal_gives_the_same_files(journal, tmp_path):
    for k in ("a", "b"):
        write_sqlite(journal, tmp_path / k / "board.sqlite")
        write_parquet(journal, tmp_path / k)
    for name in ("board.sqlite", "entries.parquet", "episodes.parquet", "anytime.parquet"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_parquet_and_sqlite_agree(journal, tmp_path):
    pq = pytest.importorskip("pyarrow.parquet")
    write_sqlite(journal, tmp_path / "board.sqlite")
    files = write_parquet(journal, tmp_path)
    base = sqlite3.connect(tmp_path / "board.sqlite")
    for file in files:
        table = pq.read_table(file)
        assert table.schema.metadata[b"journal"].decode() == journal.head
        found = base.execute(f"SELECT * FROM {file.stem}").fetchall()
        assert [tuple(row.values()) for row in table.to_pylist()] == found
    base.close()


def test_names_are_data_not_commands(tmp_path, make_entry):
    """A name that would end a statement, were it put into one."""
    name = "'); DROP TABLE episodes; --"
    append(tmp_path / "entries", make_entry(name, scores=[1.0] * 20))
    write_sqlite(read(tmp_path / "entries"), tmp_path / "board.sqlite")
    base = sqlite3.connect(tmp_path / "board.sqlite")
    assert base.execute("SELECT name FROM entries").fetchall() == [(name,)]
    assert base.execute("SELECT count(*) FROM episodes").fetchone() == (20,)
    base.close()
