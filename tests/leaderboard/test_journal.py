"""The board's files: none can be changed unseen, nothing written is lost, git merges them."""

import json
import multiprocessing
import os
import resource
import shutil
import signal
import subprocess

import pytest

from ves_gym._util.params import ParameterError, canonical_json, content_hash
from ves_gym.leaderboard.columnar import to_columns
from ves_gym.leaderboard.history import history_faults
from ves_gym.leaderboard.journal import JournalError, append, check, migrate, read
from ves_gym.leaderboard.record import made_record


@pytest.fixture
def board(tmp_path, make_entry):
    """A board of five entries."""
    path = tmp_path / "entries"
    for k in range(5):
        append(path, make_entry(f"planner {k}"))
    return path


def files_of(folder):
    return {p.name: p.read_bytes() for p in folder.iterdir()}


def test_entries_come_back_as_they_went_in(board, make_entry):
    journal = read(board)
    assert [r.entry for r in journal.records] == [make_entry(f"planner {k}") for k in range(5)]
    assert {r.name for r in journal.records} == set(files_of(board))
    assert check(board, head=journal.head).problems == ()


def test_no_folder_is_an_empty_board(tmp_path):
    assert read(tmp_path / "none").records == ()


def test_an_entry_that_is_none_is_not_written(board, make_entry):
    before = files_of(board)
    bad = make_entry()
    bad["rows"][0]["score"] = float("nan")
    for entry in (bad, make_entry(track="poetry"), make_entry(rows=[])):
        with pytest.raises(ParameterError):
            append(board, entry)
    assert files_of(board) == before


@pytest.mark.parametrize(
    "name", ["CON", "aux.", "a/b\\c", 'x:y*z?"<>|', "Ünïcode", "李雷", "n" * 200, "...", "A b"]
)
def test_files_have_names_that_every_file_system_takes(tmp_path, make_entry, name):
    record = append(tmp_path, make_entry(name))
    assert set(record.name) <= set("abcdefghijklmnopqrstuvwxyz0123456789-.")
    assert record.name.endswith(f"-{record.id}.json") and record.name.count(".") == 1
    assert record.name.startswith("paths-") and len(record.name) < 130  # no device of Windows
    assert read(tmp_path).records[0].entry["name"] == name


def test_line_ends_of_windows_change_nothing(board):
    """As a checkout with autocrlf writes them."""
    head = read(board).head
    for path in board.iterdir():
        path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    assert read(board).head == head


def test_the_mean_of_a_decay_has_a_name_of_its_own(tmp_path, make_entry):
    """Entries of before call it E_mean; their files stay as they are."""
    entry = make_entry("old", track="damping", problem="pped-bent", kind="gains")
    (row, *_) = append(tmp_path, entry).entry["rows"]
    assert (row["E_mean"], row["E_decay"]) == (None, entry["rows"][0]["E_mean"])
    assert read(tmp_path).records[0].entry["rows"][0] == row


# ------------------------------------------------------------------------ tampering


def test_a_changed_byte_is_found_and_its_file_named(board):
    """Bytes all along a file, one at a time."""
    path = sorted(board.iterdir())[2]
    whole = path.read_bytes()
    for at in range(0, len(whole) - 1, 67):
        changed = bytearray(whole)
        changed[at] ^= 1
        path.write_bytes(bytes(changed))
        journal = check(board)
        assert len(journal.problems) == 1 and journal.problems[0].startswith(path.name), at
        assert len(journal.records) == 4
        with pytest.raises(JournalError, match=path.name):
            read(board)


def test_a_forged_entry_takes_another_name_and_the_published_hash_tells(board):
    """Its content, name and hashes fit: the history of git and the hash of all do not."""
    head = read(board).head
    record = read(board).records[1]
    forged, data = made_record({**record.entry, "bundle": "cd" * 32}, record.entered)
    (board / record.name).write_bytes(data)
    assert check(board).problems[0].startswith(f"{record.name}: changed or renamed")
    (board / record.name).rename(board / forged.name)
    assert check(board).problems == ()
    (problem,) = check(board, head=head).problems
    assert "some were added, removed or changed" in problem


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("a.json", b"{}"),
        ("a.json", b"[]"),
        ("a.json", b"\xff\xfe"),
        ("a.json", b"[" * 100_000),
        ("notes.txt", b"hello"),
        ("a.json", b'{"schema":"ves-board-entry/1","entered":"","adopts":[],"entry":{}}'),
        ("a.json", b'{"schema":"ves-board-entry/9","entered":"","adopts":[],"entry":{}}'),
        (
            "a.json",
            b'{"schema":"ves-board-entry/1","entered":"2026-01-01T00:00:00.000000+00:00",'
            b'"adopts":5,"entry":{"a":NaN}}',
        ),
    ],
)
def test_a_file_that_is_no_entry_is_named(board, name, data):
    (board / name).write_bytes(data)
    journal = check(board)
    assert len(journal.records) == 5
    assert journal.problems[0].startswith(f"{name}: ") and len(journal.problems[0]) < 300


def test_links_and_folders_are_no_entries(board):
    (board / "b.json").symlink_to("/etc/hostname")
    (board / "c").mkdir()
    assert [p.partition(":")[0] for p in check(board).problems] == ["b.json", "c"]


# ------------------------------------------------------------------------------ git


@pytest.fixture
def repository(tmp_path, board):
    """The board in a git repository, committed."""
    if shutil.which("git") is None:
        pytest.skip("git is not installed")
    environment = {
        **{k: v for k, v in os.environ.items() if not k.startswith("GIT_")},
        **{f"GIT_{who}_{what}": "a@example.org" for who in ("AUTHOR", "COMMITTER")
           for what in ("NAME", "EMAIL")},
        "GIT_CONFIG_GLOBAL": os.devnull, "GIT_CONFIG_NOSYSTEM": "1",
    }  # fmt: skip

    def git(*words):
        done = subprocess.run(
            ["git", "-C", str(tmp_path), *words],
            env=environment, check=True, capture_output=True, text=True,
        )  # fmt: skip
        return done.stdout.strip()

    git("init", "-q", "-b", "main")
    git("add", "entries")
    git("commit", "-qm", "Five entries")
    return git


def test_two_contributors_entries_are_merged_by_git_alone(repository, board, make_entry):
    """Each on a branch of the same commit; neither sees the other's."""
    for branch in ("one", "two"):
        repository("checkout", "-qb", branch, "main")
        for k in range(2):
            append(board, make_entry(f"{branch} {k}", author=f"author {branch}"))
        repository("add", "entries")
        repository("commit", "-qm", f"Entries of {branch}")
    repository("checkout", "-q", "main")
    for branch in ("one", "two"):
        repository("merge", "-q", "--no-edit", "--no-ff", branch)
    names = {r.entry["name"] for r in read(board).records}
    assert len(read(board).records) == 9 and {"one 1", "two 1", "planner 4"} <= names
    assert history_faults(board) == []
    assert history_faults(board, since="main~1") == []


def test_what_git_merges_is_checked_as_a_whole(repository, board, make_entry):
    """Two authors who look alike, and two keys of one name, each sound on its own branch."""
    keys = {"one": "SHA256:" + "a" * 43, "two": "SHA256:" + "b" * 43}
    for branch, author in (("one", "A. Name"), ("two", "A. Nаme")):  # a Cyrillic letter
        repository("checkout", "-qb", branch, "main")
        append(board, make_entry(f"{branch} 1", author=author))
        signed = make_entry(f"{branch} 2", author="Shared")
        signed["about"] = {**signed["about"], "key": keys[branch]}
        append(board, signed)
        repository("add", "entries")
        repository("commit", "-qm", f"Entries of {branch}")
        assert check(board).problems == ()
    repository("merge", "-q", "--no-edit", "one")
    alike, key = check(board).problems
    assert "looks like 'A. Name'" in alike and f"signs with {keys['one']}" in key


def test_commits_that_change_or_remove_an_entry_are_named(repository, board, make_entry):
    first, second, *_ = sorted(board.iterdir())
    good = repository("rev-parse", "HEAD")
    record = append(board, make_entry("new"))
    assert history_faults(board) == []  # added, not committed yet
    repository("add", "entries")
    repository("commit", "-qm", "A new one")
    first.write_bytes(first.read_bytes()[:-1])
    (fault,) = history_faults(board)
    assert fault == f"{first.name} was changed, not committed"
    repository("commit", "-qam", "Changed")
    repository("rm", "-q", f"entries/{second.name}")
    repository("commit", "-qm", "Removed")
    repository("checkout", "-q", good, "--", "entries")  # as if nothing had been
    repository("commit", "-qm", "There again")
    faults = history_faults(board, since=good)
    assert len(faults) == 3 and not any(record.name in fault for fault in faults)
    assert any(f.startswith(f"{second.name} was removed by commit") for f in faults)
    for bad in ("nothing", "--all"):
        with pytest.raises(ParameterError, match="git says"):
            history_faults(board, since=bad)


def test_a_merge_that_drops_an_entry_is_named(repository, board, make_entry):
    repository("checkout", "-qb", "one")
    record = append(board, make_entry("good one"))
    repository("add", "entries")
    repository("commit", "-qm", "One")
    repository("checkout", "-q", "main")
    append(board, make_entry("another"))
    repository("add", "entries")
    repository("commit", "-qm", "Another")
    repository("merge", "-q", "--no-commit", "--no-ff", "one")
    repository("rm", "-qf", f"entries/{record.name}")
    repository("commit", "-qm", "Merge one")
    (fault,) = history_faults(board)
    assert fault.startswith(f"{record.name} was removed by commit")


# ---------------------------------------------------------------------- older boards


def chained(path, entries):
    """Write an older board: lines in a hash chain."""
    previous, lines = "0" * 64, []
    for index, entry in enumerate(entries):
        entry = {**entry, "rows": to_columns(entry["rows"])}
        body = {"index": index, "previous": previous, "entry": entry}
        previous = content_hash(body)
        lines.append(canonical_json({**body, "hash": previous}) + "\n")
    path.write_text("".join(lines), "utf-8")


def test_an_older_board_is_migrated_once(tmp_path, make_entry):
    old, new = tmp_path / "board.jsonl", tmp_path / "entries"
    entries = [make_entry(name) for name in ("b", "a", "b")]
    chained(old, entries)
    assert migrate(old, new) == 3
    assert [r.entry for r in read(new).records] == entries
    assert read(new).records[0].entered == "2026-01-01T00:10:00.000000+00:00"
    with pytest.raises(ParameterError, match="has entries already"):
        migrate(old, new)
    with pytest.raises(ParameterError, match="a board is a folder"):
        read(old)


@pytest.mark.parametrize("fault", ["changed", "removed", "doubled", "cut", "alien"])
def test_an_older_board_that_was_changed_is_not_migrated(tmp_path, make_entry, fault):
    old = tmp_path / "board.jsonl"
    chained(old, [make_entry(name) for name in "abc"])
    a, b, c = old.read_bytes().splitlines(keepends=True)
    lines = {
        "changed": [a, b.replace(b"0.3", b"0.1"), c],
        "removed": [a, c],
        "doubled": [a, b, b, c],
        "cut": [a, b, c[:-5]],
        "alien": [a, b"null\n", c],
    }[fault]
    old.write_bytes(b"".join(lines))
    with pytest.raises(ParameterError, match=f"line {3 if fault in ('doubled', 'cut') else 2}"):
        migrate(old, tmp_path / "entries")
    assert not (tmp_path / "entries").exists()
    assert json.loads(a)["index"] == 0


# --------------------------------------------------------------------------- faults


def _fill(path, entry, limit, answer):
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # then a write past the limit is an OSError
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
    try:
        append(path, entry)
    except OSError as error:
        answer.send(type(error).__name__)
    else:
        answer.send("written")


def test_a_full_disk_leaves_the_board_as_it_was(board, make_entry):
    """The kernel refuses to let a file grow past half of the entry."""
    before = files_of(board)
    spawn = multiprocessing.get_context("spawn")
    ours, theirs = spawn.Pipe()
    child = spawn.Process(target=_fill, args=(board, make_entry("late"), 500, theirs))
    child.start()
    assert ours.recv() == "OSError"
    child.join()
    assert files_of(board) == before
    append(board, make_entry("late"))
    assert len(read(board).records) == 6


def _many(path, entry, count):
    for k in range(count):
        append(path, {**entry, "name": f"{os.getpid()}-{k}"})


def test_writers_at_once_lose_and_double_nothing(tmp_path, make_entry):
    path, spawn = tmp_path / "entries", multiprocessing.get_context("spawn")
    writers = [spawn.Process(target=_many, args=(path, make_entry(), 8)) for _ in range(3)]
    for one in writers:
        one.start()
    for one in writers:
        one.join()
    names = [r.entry["name"] for r in read(path).records]
    assert len(names) == len(set(names)) == 24


def test_a_killed_writer_costs_at_most_its_own_entry(tmp_path, make_entry):
    """SIGKILL while it writes: what it had not finished is a file that nobody reads."""
    path, spawn = tmp_path / "entries", multiprocessing.get_context("spawn")
    child = spawn.Process(target=_many, args=(path, make_entry(), 10_000))
    child.start()
    while not path.exists() or len(list(path.iterdir())) < 10:
        assert child.is_alive()
    child.kill()
    child.join()
    before = len(read(path).records)
    assert before >= 9
    append(path, make_entry("after"))
    assert len(read(path).records) == before + 1
