"""Authors and their keys: who has signed under a name has it alone.

The journal is the register: the first signed entry of an author ties the name to its key
(`about.key`, the fingerprint that `verify` computed). From then on every entry of that author
has the same key. Names without a key stay free to all. `names.py` refuses look-alikes.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from ves_gym._util.params import ParameterError

Plain = Mapping[str, Any]


def key_of(entry: Plain) -> str | None:
    """Return the fingerprint of the key that an entry was signed with, None if of none."""
    key: str | None = entry["about"].get("key")
    return key


def registered(entries: Iterable[Plain]) -> dict[str, str]:
    """Return the key of each author who has one.

    Args:
        entries: in the order of the journal.
    """
    keys: dict[str, str] = {}
    for entry in entries:
        if (key := key_of(entry)) is not None:
            keys.setdefault(entry["author"], key)
    return keys


def misfit(entry: Plain, keys: Mapping[str, str]) -> str:
    """Return why an entry cannot stand under its author's name, empty if it can.

    Args:
        entry: the entry.
        keys: of the authors, as of the entries before it.
    """
    author, key = entry["author"], key_of(entry)
    if key is not None and not author:
        return f"signed by {key}, but without an author to whom the key belongs"
    expected = keys.get(author)
    if expected is None or key == expected:
        return ""
    got = "the entry is not signed" if key is None else f"the entry is signed by {key}"
    return f"author {author!a} signs with {expected}, and {got}"


def require_author(entry: Plain, entries: Iterable[Plain], *, adopt: bool = False) -> None:
    """Do nothing if an entry may stand under its author's name.

    Args:
        entry: a new one.
        entries: those there are, in order.
        adopt: the maintainer knows that the unsigned entries of that name are the signer's.

    Raises:
        ParameterError: it has another key than the author's entries before, or none; or it is
            signed, and unsigned entries have its author's name.
    """
    before = list(entries)
    keys = registered(before)
    if why := misfit(entry, keys):
        raise ParameterError(why)
    author, key = entry["author"], key_of(entry)
    if key is None:
        if adopt:
            raise ParameterError(
                f"nothing to adopt: the entry of author {author!a} is not signed"
            )
        return
    unsigned = sum(other["author"] == author for other in before)
    if author not in keys and unsigned and not adopt:
        raise ParameterError(
            f"author {author!a} has {unsigned} unsigned entries on the board, and the entry is"
            f" signed by {key}: take another name, or let the maintainer tie this one to the"
            " key (--adopt)"
        )
