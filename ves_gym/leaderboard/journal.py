"""The truth of the leaderboard: a file that is only appended to, and whose lines are chained.

A line is one JSON object: `index` (0, 1, ...), `previous` (the `hash` of the line before, 64
zeros in the first), `entry` with its rows as columns (`columns.py`), and `hash`, the SHA-256 of
the canonical JSON of the other three. A change, a removal or an insertion anywhere breaks the
chain at a line that can be named.

The chain does not keep anybody from writing all of it anew, nor from cutting off its end: the
hash of the last line, published elsewhere, does (`check(path, head=...)`).

An append that was cut short (power, full disk) leaves a last line that is no whole one. It was
never acknowledged: readers leave it out and say so, and the next append sets it aside in a
file of its own before it goes on.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from io import FileIO
from pathlib import Path
from typing import Any

from ves_gym._util.params import ParameterError, canonical_json, content_hash, write_bytes
from ves_gym.leaderboard.authors import key_of, misfit, require_author
from ves_gym.leaderboard.columnar import from_columns, to_columns
from ves_gym.leaderboard.entry import check_entry
from ves_gym.leaderboard.names import require_unlike

FIRST = "0" * 64  # what the first line follows
_KEYS = {"index", "previous", "entry", "hash"}

Path_ = str | os.PathLike[str]


class JournalError(ParameterError):
    """A journal whose chain is broken; says at which lines."""


@dataclass(frozen=True)
class Record:
    """A line of the journal."""

    index: int
    previous: str
    entry: Mapping[str, Any]
    hash: str

    def to_line(self) -> bytes:
        """The line as it stands in the file, newline included."""
        plain = {**_body(self.index, self.previous, self.entry), "hash": self.hash}
        return (canonical_json(plain) + "\n").encode("utf-8")


@dataclass(frozen=True)
class Journal:
    """Records of a journal, and the faults in its file."""

    records: tuple[Record, ...]
    problems: tuple[str, ...] = ()
    torn: bytes = b""

    @property
    def head(self) -> str:
        """Hash of the last line: it stands for everything before it."""
        return self.records[-1].hash if self.records else FIRST


def check(path: Path_, *, head: str | None = None) -> Journal:
    """Go through the whole chain and name every line that breaks it.

    Args:
        path: the journal; a file that does not exist is an empty one.
        head: hash that the last line must have, as it was published.

    Raises:
        ParameterError: the file cannot be read.
    """
    try:
        data = Path(path).read_bytes()
    except FileNotFoundError:
        data = b""
    except OSError as error:
        raise ParameterError(f"{path}: cannot be read: {error}") from None
    return _checked(data, head)


def read(path: Path_) -> Journal:
    """A journal whose chain holds; a torn last line is in `torn`, not in the records.

    Raises:
        JournalError: the chain is broken; says where.
    """
    return _sound(path, check(path))


def append(path: Path_, entry: Mapping[str, Any], *, adopt: bool = False) -> Record:
    """Add an entry at the end; when this returns, it is on the disk.

    Writers wait for each other. Where the write fails (full disk), the file is as it was.

    Args:
        path: the journal.
        entry: plain data of an `Entry`.
        adopt: the author's unsigned entries are the signer's, says the maintainer.

    Raises:
        ParameterError: the entry is not one (see `check_entry`), its name or author looks
            like another's, or its author's name is of another key (see `require_author`).
        JournalError: the chain is broken; nothing is added to it.
    """
    check_entry(entry)
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with _locked(path) as file:
        data = file.read()
        journal = _sound(path, _checked(data, None))
        for key in ("author", "name"):
            others = (str(r.entry[key]) for r in journal.records)
            require_unlike(str(entry[key]), others, key)
        require_author(entry, (r.entry for r in journal.records), adopt=adopt)
        end = len(data) - len(journal.torn)
        if journal.torn:
            write_bytes(_aside(path), journal.torn)
            file.truncate(end)
        index, previous = len(journal.records), journal.head
        body = _body(index, previous, entry)
        record = Record(index, previous, dict(entry), content_hash(body))
        try:
            _write(file, end, record.to_line())
        except BaseException:
            file.truncate(end)
            raise
        _sync_folder(path.parent)
    return record


def _body(index: int, previous: str, entry: Mapping[str, Any]) -> dict[str, Any]:
    """A line without its hash."""
    rows = {"rows": to_columns(entry["rows"])} if entry.get("rows") else {}
    return {"index": index, "previous": previous, "entry": {**entry, **rows}}


def _sound(path: Path_, journal: Journal) -> Journal:
    if journal.problems:
        others = len(journal.problems) - 1
        suffix = f" (and {others} more)" if others else ""
        raise JournalError(f"{path}: {journal.problems[0]}{suffix}")
    return journal


def _checked(data: bytes, head: str | None) -> Journal:
    *lines, torn = data.split(b"\n")
    records: list[Record] = []
    problems: list[str] = []
    keys: dict[str, str] = {}  # of authors
    previous, index = FIRST, 0
    for number, raw in enumerate(lines, 1):
        record = _parse(raw)
        if isinstance(record, str):
            problems.append(f"line {number}: {record}")
            previous, index = "", index + 1
            continue
        problem = _problem(record, index, previous) or misfit(record.entry, keys)
        if problem:
            problems.append(f"line {number}: {problem}")
        elif not problems:
            records.append(record)
            if (key := key_of(record.entry)) is not None:
                keys.setdefault(record.entry["author"], key)
        previous, index = record.hash, record.index + 1
    if head is not None and previous != head:
        problems.append(
            f"line {len(lines)}: the last hash is {previous[:12] or 'unknown'}, expected"
            f" {head[:12]}: the end was cut off, or the journal was written anew"
        )
    return Journal(tuple(records), tuple(problems), torn)


def _parse(raw: bytes) -> Record | str:
    """The record of a line, or what is wrong with it."""
    try:
        plain = json.loads(raw)
    except (ValueError, RecursionError):
        return "not JSON"
    if not isinstance(plain, dict) or plain.keys() != _KEYS:
        return f"expected an object of {', '.join(sorted(_KEYS))}"
    record = Record(**plain)
    strings = isinstance(record.previous, str) and isinstance(record.hash, str)
    if type(record.index) is not int or not strings or not isinstance(record.entry, dict):
        return "expected a whole index, text in previous and hash, an object in entry"
    try:
        if "rows" in record.entry:
            rows = from_columns(record.entry["rows"])
            record = replace(record, entry={**record.entry, "rows": rows})
    except ParameterError as error:
        return str(error)
    try:
        if record.to_line() != raw + b"\n":
            return "changed: not in the form it was written in"
    except ValueError:  # NaN, or a lone surrogate
        return "changed: holds what JSON has not"
    return record


def _problem(record: Record, index: int, previous: str) -> str:
    """Why a record cannot stand at a place of the chain, or nothing."""
    body = _body(record.index, record.previous, record.entry)
    if content_hash(body) != record.hash:
        return "changed: its content has another hash than it says"
    try:
        check_entry(record.entry)
    except ParameterError as error:
        return str(error)
    if previous and record.previous != previous:
        return "does not follow the line before: one was changed, removed or put in there"
    if record.index != index:
        return f"has index {record.index}, expected {index}"
    return ""


def _aside(path: Path) -> Path:
    """A free name beside the journal for a torn line."""
    k = 0
    while (aside := path.with_name(f"{path.name}.torn-{k}")).exists():
        k += 1
    return aside


@contextmanager
def _locked(path: Path) -> Iterator[FileIO]:
    """The file, open for reading and writing, for one writer at a time."""
    handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    with FileIO(handle, "r+") as file:
        fcntl.flock(file, fcntl.LOCK_EX)  # ends when the file is closed, or its process dies
        yield file


def _write(file: FileIO, at: int, data: bytes) -> None:
    file.seek(at)
    while data:  # one call may take less than all
        data = data[file.write(data) or 0 :]
    os.fsync(file.fileno())


def _sync_folder(folder: Path) -> None:
    """Make the name of a new file last as well."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
