"""Boards of before: one file of lines in a hash chain, read to be migrated (`journal.migrate`).

A line is one JSON object: `index` (0, 1, ...), `previous` (the `hash` of the line before, 64
zeros in the first), `entry` with its rows as columns (`columnar.py`), and `hash`, the SHA-256
of the canonical JSON of the other three.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from ves_gym._util.params import ParameterError, canonical_json, content_hash
from ves_gym.leaderboard.columnar import from_columns
from ves_gym.leaderboard.entry import check_entry

FIRST = "0" * 64  # what the first line follows
_KEYS = {"index", "previous", "entry", "hash"}


def read_chained(path: str | os.PathLike[str]) -> list[dict[str, Any]]:
    """Read the entries of an older board, its whole chain checked.

    Args:
        path: the file.

    Raises:
        ParameterError: it cannot be read, or a line breaks the chain; says which.
    """
    try:
        lines = Path(path).read_bytes().splitlines(keepends=True)
    except OSError as error:
        raise ParameterError(f"{path}: cannot be read: {error.strerror}") from None
    out: list[dict[str, Any]] = []
    previous = FIRST
    for index, line in enumerate(lines):
        try:
            previous, entry = _parsed(line, index, previous)
        except ParameterError as error:
            raise ParameterError(f"{path}: line {index + 1}: {error}") from None
        out.append(entry)
    return out


def _parsed(line: bytes, index: int, previous: str) -> tuple[str, dict[str, Any]]:
    """Hash and entry of a line."""
    try:
        plain = json.loads(line)
        same = isinstance(plain, dict) and (canonical_json(plain) + "\n").encode() == line
    except (ValueError, RecursionError):
        raise ParameterError("not JSON") from None
    if not same or plain.keys() != _KEYS:
        raise ParameterError(f"expected canonical JSON of {', '.join(sorted(_KEYS))}")
    computed = content_hash({k: plain[k] for k in ("index", "previous", "entry")})
    if (plain["index"], plain["previous"], plain["hash"]) != (index, previous, computed):
        raise ParameterError("does not follow the line before, or was changed")
    entry = plain["entry"]
    if not isinstance(entry, dict):
        raise ParameterError("entry must be an object")
    entry = {**entry, "rows": from_columns(entry.get("rows"))}
    check_entry(entry)
    return computed, entry
