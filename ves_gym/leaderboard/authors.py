"""Authors and their keys: who has signed under a name has it alone.

The board is the register: a signed entry of an author ties the name to its key (`about.key`,
the fingerprint that `verify` computed), and every entry of that author has the same key.
Unsigned ones of before stay only where a signed entry adopts them by hash, so the order of
files, which a merge or a false clock can change, decides nothing. Names without a key stay free
to all. `names.py` refuses look-alikes.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

from ves_gym._util.params import ParameterError
from ves_gym.leaderboard.record import Record

Plain = Mapping[str, Any]


def key_of(entry: Plain) -> str | None:
    """Return the fingerprint of the key that an entry was signed with, None if of none."""
    key: str | None = entry["about"].get("key")
    return key


def key_faults(records: Sequence[Record]) -> list[str]:
    """Name the files that cannot stand under their author's name.

    Args:
        records: of the whole board.
    """
    of: dict[str, list[Record]] = defaultdict(list)
    for record in records:
        of[str(record.entry["author"])].append(record)
    return [
        f"{record.name}: {why}"
        for author, theirs in of.items()
        for record in theirs
        if (why := _fault(record, author, theirs))
    ]


def _fault(record: Record, author: str, theirs: Sequence[Record]) -> str:
    """Why an entry cannot stand among its author's, empty if it can."""
    signed = [r for r in theirs if key_of(r.entry) is not None]
    if not signed:
        return ""
    first, mine = key_of(signed[0].entry), key_of(record.entry)
    if mine is None:
        if any(record.hash in r.adopts for r in signed):
            return ""
        return f"author {author!a} signs with {first}, and the entry is not signed"
    if not author:
        return f"signed by {mine}, but without an author to whom the key belongs"
    if mine == first:
        return ""
    return f"author {author!a} signs with {first}, and the entry is signed by {mine}"


def require_author(
    entry: Plain, records: Sequence[Record], *, adopt: bool = False
) -> tuple[str, ...]:
    """Return the hashes of the unsigned entries that a new entry takes over.

    Args:
        entry: the new one.
        records: those there are.
        adopt: the maintainer knows that the unsigned entries of that name are the signer's.

    Raises:
        ParameterError: it has another key than the author's entries before, or none; or it is
            signed, and unsigned entries have its author's name.
    """
    author, key = entry["author"], key_of(entry)
    theirs = [r for r in records if r.entry["author"] == author]
    keys = [k for r in theirs if (k := key_of(r.entry)) is not None]
    if key is not None and not author:
        raise ParameterError(f"signed by {key}, but without an author to whom the key belongs")
    if keys and key != keys[0]:
        got = "the entry is not signed" if key is None else f"the entry is signed by {key}"
        raise ParameterError(f"author {author!a} signs with {keys[0]}, and {got}")
    if key is None:
        if adopt:
            raise ParameterError(
                f"nothing to adopt: the entry of author {author!a} is not signed"
            )
        return ()
    unsigned = [r.hash for r in theirs if key_of(r.entry) is None]
    if keys or not unsigned:
        return ()
    if not adopt:
        raise ParameterError(
            f"author {author!a} has {len(unsigned)} unsigned entries on the board, and the"
            f" entry is signed by {key}: take another name, or let the maintainer tie this one"
            " to the key (--adopt)"
        )
    return tuple(sorted(unsigned))
