"""The truth of the leaderboard: a folder of files, one per entry, that are only added.

Two contributors' entries are two files, so git merges them. What a file holds gives it its name
(`record.py`): a changed one shows without anything else. That none is changed or removed is
what git's history is for, a chain of hashes over the whole folder: `history.py` asks it. The
hash of all entries (`Journal.head`), published elsewhere, does the same without git.

Whatever a merge puts together is checked as a whole: look-alike names, and keys of authors.
Order is by the time at which entries were put on the board.
"""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from ves_gym._util.params import ParameterError, content_hash, write_bytes
from ves_gym.leaderboard.authors import key_faults, require_author
from ves_gym.leaderboard.chained_journal import read_chained
from ves_gym.leaderboard.entry import check_entry
from ves_gym.leaderboard.names import require_unlike, skeleton
from ves_gym.leaderboard.record import Record, made_record, parse
from ves_gym.leaderboard.seasons import season_names

_MOST = 2**24  # bytes of a file

Path_ = str | os.PathLike[str]


class JournalError(ParameterError):
    """A board with files that cannot be believed; says which."""


@dataclass(frozen=True)
class Journal:
    """Records of a board, in the order in which they were entered, and the faults in it.

    `seasons` has the names of its seasons, by the marks of their salts.
    """

    records: tuple[Record, ...]
    problems: tuple[str, ...] = ()
    seasons: Mapping[str, str] = field(default_factory=dict)

    @property
    def head(self) -> str:
        """Hash of all entries, whatever their order."""
        return content_hash(sorted(r.hash for r in self.records))


def check(folder: Path_, *, head: str | None = None) -> Journal:
    """Read every file of a board and name each that cannot be believed.

    Args:
        folder: of the entries; one that does not exist is an empty board.
        head: hash that the board must have, as it was published.

    Raises:
        ParameterError: the folder cannot be read, or is a file.
    """
    records: list[Record] = []
    problems: list[str] = []
    for path in _files(Path(folder)):
        try:
            records.append(parse(path.name, _read(path)))
        except ParameterError as error:
            problems.append(f"{path.name}: {error}")
    records.sort(key=lambda r: r.order)
    problems += [*_look_alikes(records), *key_faults(records)]
    try:
        seasons = season_names(folder)
    except ParameterError as error:
        seasons = {}
        problems.append(str(error))
    journal = Journal(tuple(records), tuple(problems), seasons)
    if head is not None and journal.head != head:
        problems.append(
            f"{len(records)} entries have the hash {journal.head[:12]}, expected {head[:12]}:"
            " some were added, removed or changed"
        )
    return Journal(tuple(records), tuple(problems), seasons)


def read(folder: Path_) -> Journal:
    """A board in which every file holds.

    Raises:
        JournalError: one does not; says which.
    """
    return _sound(folder, check(folder))


def append(folder: Path_, entry: Mapping[str, Any], *, adopt: bool = False) -> Record:
    """Add an entry as a file of its own; when this returns, it is on the disk.

    The file is there completely or not at all. Where two are added in the same moment, neither
    sees the other: names that look alike are then named by `check`, as after a merge.

    Args:
        folder: of the entries; made if need be.
        entry: plain data of an `Entry`.
        adopt: the author's unsigned entries are the signer's, says the maintainer.

    Raises:
        ParameterError: the entry is not one (see `check_entry`), its name or author looks
            like another's, or its author's name is of another key (see `require_author`).
        JournalError: the board has faults; nothing is added to it.
    """
    check_entry(entry)
    folder = Path(folder)
    journal = read(folder)
    for key in ("author", "name"):
        require_unlike(str(entry[key]), (str(r.entry[key]) for r in journal.records), key)
    adopts = require_author(entry, journal.records, adopt=adopt)
    return _write(folder, entry, _after(journal.records, datetime.now(UTC)), adopts)


def migrate(chained: Path_, folder: Path_) -> int:
    """Write the entries of an older board, one file of chained lines, as files of their own.

    Each is entered when its bundle was made, in the order of the lines.

    Args:
        chained: the older board.
        folder: of the entries, without any so far.

    Returns:
        The number of entries.

    Raises:
        ParameterError: the chain is broken, or the folder has entries.
    """
    if next(_files(Path(folder)), None) is not None:
        raise ParameterError(f"{folder}: has entries already")
    entries = read_chained(chained)
    records: list[Record] = []
    for entry in entries:
        made = datetime.fromisoformat(entry["about"]["ended"]).astimezone(UTC)
        records.append(_write(Path(folder), entry, _after(records, made), ()))
    read(folder)
    return len(records)


def _write(
    folder: Path, entry: Mapping[str, Any], entered: str, adopts: tuple[str, ...]
) -> Record:
    record, data = made_record(entry, entered, adopts)
    write_bytes(folder / record.name, data)
    return record


def _after(records: Sequence[Record], moment: datetime) -> str:
    """The moment, or the first one after all records."""
    if records:
        newest = datetime.fromisoformat(records[-1].entered)
        moment = max(moment, newest + timedelta(microseconds=1))
    return moment.isoformat(timespec="microseconds")


def _files(folder: Path) -> Iterator[Path]:
    """Files of the folder; those that begin with a dot are writes that were cut short."""
    try:
        names = sorted(os.listdir(folder))
    except FileNotFoundError:
        return
    except NotADirectoryError:
        raise ParameterError(
            f"{folder}: is a file; a board is a folder with a file per entry (ves-gym"
            " leaderboard migrate makes one of an older board)"
        ) from None
    except OSError as error:
        raise ParameterError(f"{folder}: cannot be read: {error.strerror}") from None
    if "entries" in names and (folder / "entries").is_dir():
        raise ParameterError(f"{folder}: has no entries itself; they are in {folder}/entries")
    yield from (folder / name for name in names if not name.startswith("."))


def _read(path: Path) -> bytes:
    if path.is_symlink() or not path.is_file():
        raise ParameterError("is no plain file")
    try:
        with open(path, "rb") as file:
            data = file.read(_MOST + 1)
    except OSError as error:
        raise ParameterError(f"cannot be read: {error.strerror}") from None
    if len(data) > _MOST:
        raise ParameterError(f"is larger than {_MOST} bytes")
    return data


def _look_alikes(records: Sequence[Record]) -> list[str]:
    """Names and authors that look like one that was on the board before."""
    out = []
    for key in ("author", "name"):
        first: dict[str, str] = {}
        others: dict[str, list[str]] = defaultdict(list)
        for record in records:
            name = str(record.entry[key])
            if not name:
                continue
            there = first.setdefault(skeleton(name), name)
            if name != there and name not in others[there]:
                others[there].append(name)
                out.append(f"{record.name}: {key} {name!a} looks like {there!a}")
    return out


def _sound(folder: Path_, journal: Journal) -> Journal:
    if journal.problems:
        others = len(journal.problems) - 1
        suffix = f" (and {others} more)" if others else ""
        raise JournalError(f"{folder}: {journal.problems[0]}{suffix}")
    return journal
