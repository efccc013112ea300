"""A file of the board: one entry, its name made from its content.

Canonical JSON of `schema`, `entered` (when the verifier put it on the board, UTC), `adopts`
(hashes of unsigned entries that the author's key takes over, see `authors.py`) and `entry`,
its rows as columns (`columnar.py`). The name ends with the beginning of the content's SHA-256,
so a changed byte shows in the file alone. It holds lower-case ASCII letters, digits and hyphens
only, and begins with the track, so that every file system takes it.
"""

from __future__ import annotations

import json
import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ves_gym._util.params import ParameterError, canonical_json, content_hash
from ves_gym.leaderboard.columnar import from_columns, to_columns
from ves_gym.leaderboard.entry import DIGEST, check_entry, instant, with_named_measures

SCHEMA = "ves-board-entry/1"
_KEYS = {"schema", "entered", "adopts", "entry"}
_IN_NAME = 16  # digits of the hash in the name of a file
_WORDS = 40  # characters of a problem's or an entry's name in it
_MOST_ADOPTED = 10_000

Plain = Mapping[str, Any]


@dataclass(frozen=True)
class Record:
    """An entry of the board, as its file holds it.

    Attributes:
        entry: plain data, rows as rows.
        entered: ISO 8601 with microseconds, UTC.
        hash: SHA-256 of the content.
        adopts: hashes of the unsigned entries that belong to the entry's key.
        name: of the file.
    """

    entry: Plain
    entered: str
    hash: str
    adopts: tuple[str, ...]
    name: str

    @property
    def id(self) -> str:
        """Beginning of the hash, as the file's name has it."""
        return self.hash[:_IN_NAME]

    @property
    def order(self) -> tuple[str, str]:
        """Sort key: by time, then hash."""
        return self.entered, self.hash


def made_record(
    entry: Plain, entered: str, adopts: tuple[str, ...] = ()
) -> tuple[Record, bytes]:
    """Return the record of an entry, and the bytes of its file.

    Args:
        entry: plain data of an `Entry`.
        entered: when it was put on the board.
        adopts: see `Record`.
    """
    content = _content(entry, entered, adopts)
    computed = content_hash(content)
    record = Record(
        with_named_measures(entry), entered, computed, adopts, _name(entry, computed)
    )
    return record, (canonical_json(content) + "\n").encode("utf-8")


def parse(name: str, data: bytes) -> Record:
    """Read a file of the board.

    Line ends as Windows writes them, from a checkout that turns them round, are taken.

    Args:
        name: of the file, without its folder.
        data: its content.

    Raises:
        ParameterError: what is wrong with it.
    """
    data = data.replace(b"\r\n", b"\n")
    try:
        plain = json.loads(data)
    except (ValueError, RecursionError):
        raise ParameterError("not JSON") from None
    if not isinstance(plain, dict) or plain.keys() != _KEYS:
        raise ParameterError(f"expected an object of {', '.join(sorted(_KEYS))}")
    if plain["schema"] != SCHEMA:
        raise ParameterError(f"schema must be {SCHEMA!r}, got {str(plain['schema'])[:80]!r}")
    entered, adopts, entry = plain["entered"], plain["adopts"], plain["entry"]
    if instant(entered, "entered").isoformat(timespec="microseconds") != entered:
        raise ParameterError("entered must have microseconds")
    if not entered.endswith("+00:00"):
        raise ParameterError(f"entered must be in UTC (+00:00), got {entered}")
    hashes = isinstance(adopts, list) and all(
        isinstance(k, str) and DIGEST.fullmatch(k) for k in adopts
    )
    if not hashes or len(adopts) > _MOST_ADOPTED:
        raise ParameterError("adopts must be a list of hashes")
    if not isinstance(entry, dict):
        raise ParameterError("entry must be an object")
    if "rows" in entry:
        entry = {**entry, "rows": from_columns(entry["rows"])}
    check_entry(entry)
    try:
        record, written = made_record(entry, entered, tuple(adopts))
    except ValueError:  # NaN, or a lone surrogate
        raise ParameterError("changed: holds what JSON has not") from None
    if written != data:
        raise ParameterError("changed: not in the form it was written in")
    if record.name != name:
        raise ParameterError(f"changed or renamed: its content belongs to {record.name}")
    return record


def _content(entry: Plain, entered: str, adopts: tuple[str, ...]) -> dict[str, Any]:
    rows = {"rows": to_columns(entry["rows"])} if entry.get("rows") else {}
    return {
        "schema": SCHEMA,
        "entered": entered,
        "adopts": list(adopts),
        "entry": {**entry, **rows},
    }


def _name(entry: Plain, computed: str) -> str:
    words = (entry["track"], str(entry["problem"]).removeprefix("ves/"), entry["name"])
    return "-".join([*filter(None, map(_word, words)), computed[:_IN_NAME]]) + ".json"


def _word(text: str) -> str:
    """Lower-case letters, digits and hyphens of a text."""
    ascii_only = unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode()
    return re.sub(r"[^a-z0-9]+", "-", ascii_only.lower()).strip("-")[:_WORDS].strip("-")
