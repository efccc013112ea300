"""The journal: nothing in it can be changed unseen, and nothing that was written is lost."""

import json
import multiprocessing
import os
import resource
import signal

import pytest

from ves_gym._util.params import ParameterError, content_hash
from ves_gym.leaderboard.journal import FIRST, JournalError, append, check, read


@pytest.fixture
def board(tmp_path, make_entry):
    """A journal of five entries."""
    path = tmp_path / "board.jsonl"
    for k in range(5):
        append(path, make_entry(f"planner {k}"))
    return path


def lines_of(path):
    return path.read_bytes().splitlines(keepends=True)


def test_entries_come_back_as_they_went_in(board, make_entry):
    journal = read(board)
    assert [r.entry for r in journal.records] == [make_entry(f"planner {k}") for k in range(5)]
    assert [r.index for r in journal.records] == [0, 1, 2, 3, 4]
    assert journal.records[0].previous == FIRST
    assert journal.head == journal.records[-1].hash and not journal.torn
    assert check(board, head=journal.head).problems == ()


def test_no_file_is_an_empty_journal(tmp_path):
    assert read(tmp_path / "none.jsonl").records == ()
    assert read(tmp_path / "none.jsonl").head == FIRST


def test_an_entry_that_is_none_is_not_written(board, make_entry):
    before = board.read_bytes()
    bad = make_entry()
    bad["rows"][0]["score"] = float("nan")
    for entry in (bad, make_entry(track="poetry"), make_entry(rows=[])):
        with pytest.raises(ParameterError):
            append(board, entry)
    assert board.read_bytes() == before


# ------------------------------------------------------------------------ tampering


def test_a_changed_byte_is_found_and_its_line_named(board):
    """Bytes all along the middle line, one at a time: named at that line or the next."""
    lines = lines_of(board)
    for at in range(0, len(lines[2]) - 1, 17):
        changed = bytearray(lines[2])
        changed[at] ^= 1
        board.write_bytes(b"".join([*lines[:2], bytes(changed), *lines[3:]]))
        journal = check(board)
        assert journal.problems, at
        assert journal.problems[0].startswith(("line 3:", "line 4:"))
        assert len(journal.records) <= 3
        with pytest.raises(JournalError, match=r"line [34]"):
            read(board)


def test_a_line_with_a_new_hash_of_its_own_breaks_the_next(board):
    lines = lines_of(board)
    plain = json.loads(lines[1])
    plain["entry"]["rows"]["columns"]["score"][0] = 0.01
    plain["hash"] = content_hash({k: plain[k] for k in ("index", "previous", "entry")})
    forged = json.dumps(plain, sort_keys=True, separators=(",", ":")).encode() + b"\n"
    board.write_bytes(b"".join([lines[0], forged, *lines[2:]]))
    (problem,) = check(board).problems
    assert problem.startswith("line 3: does not follow")


@pytest.mark.parametrize("gone", [0, 1, 3])
def test_a_removed_line_is_found(board, gone, make_entry):
    lines = lines_of(board)
    del lines[gone]
    board.write_bytes(b"".join(lines))
    (problem,) = check(board).problems
    assert problem.startswith(f"line {gone + 1}: does not follow")
    with pytest.raises(JournalError):
        append(board, make_entry())


def test_lines_that_changed_places_or_came_twice_are_found(board):
    a, b, c, d, e = lines_of(board)
    for lines in ([a, c, b, d, e], [a, b, b, c, d, e], [b"\n", a, b, c, d, e]):
        board.write_bytes(b"".join(lines))
        assert check(board).problems


def test_a_cut_end_needs_the_published_hash(board):
    head = read(board).head
    board.write_bytes(b"".join(lines_of(board)[:-1]))
    assert check(board).problems == ()  # a chain cannot know what came after
    (problem,) = check(board, head=head).problems
    assert "cut off" in problem


@pytest.mark.parametrize(
    "line",
    [
        b"{}",
        b"[]",
        b"null",
        b"\xff\xfe",
        b'{"index":5,"previous":"","entry":{},"hash":""}',
        b'{"index":5,"previous":"","entry":{"a":NaN},"hash":""}',
        b'{"index":true,"previous":"","entry":{},"hash":""}',
        b'{"entry":{},"hash":"","index":5,"previous":"","previous":""}',
        b"[" * 100_000,
    ],
)
def test_a_line_that_is_none_is_named(board, line):
    with open(board, "ab") as file:
        file.write(line + b"\n")
    journal = check(board)
    assert len(journal.records) == 5
    assert journal.problems[0].startswith("line 6: ")


def test_a_chained_line_that_is_no_entry_is_named(board):
    """Written past `append`, with hashes that hold."""
    body = {"index": 5, "previous": read(board).head, "entry": {"score": 0}}
    line = json.dumps(
        {**body, "hash": content_hash(body)}, sort_keys=True, separators=(",", ":")
    )
    with open(board, "a") as file:
        file.write(line + "\n")
    (problem,) = check(board).problems
    assert problem.startswith("line 6: ") and "entry" in problem


# --------------------------------------------------------------------------- faults


def test_a_torn_last_line_is_left_out_then_set_aside(board, make_entry):
    """Whatever part of a line a crash left: five entries remain, and the sixth goes on."""
    whole = board.read_bytes()
    append(board, make_entry("torn"))
    line = board.read_bytes()[len(whole) :]
    for k, kept in enumerate((1, len(line) // 2, len(line) - 1)):
        board.write_bytes(whole + line[:kept])
        assert len(read(board).records) == 5
        assert read(board).torn == line[:kept]
        append(board, make_entry("after"))
        assert [r.entry["name"] for r in read(board).records][4:] == ["planner 4", "after"]
        assert not read(board).torn
        assert board.with_name(f"board.jsonl.torn-{k}").read_bytes() == line[:kept]


def _fill(path, entry, limit, answer):
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # then a write past the limit is an OSError
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
    try:
        append(path, entry)
    except OSError as error:
        answer.send(type(error).__name__)
    else:
        answer.send("written")


def test_a_full_disk_leaves_the_journal_as_it_was(board, make_entry):
    """The kernel refuses to let the file grow past half of the next line."""
    before = board.read_bytes()
    spawn = multiprocessing.get_context("spawn")
    ours, theirs = spawn.Pipe()
    limit = len(before) + 500
    child = spawn.Process(target=_fill, args=(board, make_entry("late"), limit, theirs))
    child.start()
    assert ours.recv() == "OSError"
    child.join()
    assert board.read_bytes() == before
    append(board, make_entry("late"))
    assert len(read(board).records) == 6


def _many(path, entry, count):
    for k in range(count):
        append(path, {**entry, "name": f"{os.getpid()}-{k}"})


def test_writers_at_once_lose_and_double_nothing(tmp_path, make_entry):
    path, spawn = tmp_path / "board.jsonl", multiprocessing.get_context("spawn")
    writers = [spawn.Process(target=_many, args=(path, make_entry(), 8)) for _ in range(3)]
    for one in writers:
        one.start()
    for one in writers:
        one.join()
    names = [r.entry["name"] for r in read(path).records]
    assert len(names) == len(set(names)) == 24


def test_a_killed_writer_costs_at_most_its_own_line(tmp_path, make_entry):
    """SIGKILL while it writes; the lock goes with the process."""
    path, spawn = tmp_path / "board.jsonl", multiprocessing.get_context("spawn")
    child = spawn.Process(target=_many, args=(path, make_entry(), 10_000))
    child.start()
    while not path.exists() or path.stat().st_size < 20_000:
        assert child.is_alive()
    child.kill()
    child.join()
    before = len(read(path).records)
    assert before >= 5
    append(path, make_entry("after"))
    assert len(read(path).records) == before + 1
