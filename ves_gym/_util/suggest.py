"""The closest of the known names to one that is not among them."""

from __future__ import annotations

import difflib
import os
from collections.abc import Iterable
from pathlib import Path

_ALIKE = 0.6  # difflib's ratio: a slip or two in a short name, an ending left out
_LONGEST = 80  # characters: what is longer comes from a file that is no name at all


def did_you_mean(name: object, choices: Iterable[str]) -> str:
    """Return the end of an error message that offers the closest known name, or '' where none
    is.

    Capitals and the kind of dash do not count. A part of a name between slashes stands for the
    whole name where only one has it: "coulomb" for "joint/coulomb".
    """
    if not isinstance(name, str) or not 0 < len(name) <= _LONGEST:
        return ""
    names = {_plain(k): k for k in reversed([str(k) for k in choices])}  # the first of equals
    word = _plain(name)
    parts = [k for k in names if word in k.split("/")]
    if len(parts) == 1:
        closest = parts
    else:
        closest = difflib.get_close_matches(word, names, n=1, cutoff=_ALIKE)
    if not closest and "/" not in word:  # a slip in the part after the slash
        ends: dict[str, list[str]] = {}
        for k in names:
            ends.setdefault(k.rpartition("/")[2], []).append(k)
        match = difflib.get_close_matches(word, ends, n=1, cutoff=_ALIKE)
        closest = ends[match[0]] if match and len(ends[match[0]]) == 1 else []
    return f'; did you mean "{names[closest[0]]}"?' if closest else ""


def why_unread(path: str | os.PathLike[str], error: Exception) -> str:
    """Return why a file cannot be read; if it is not there, with the closest name beside it."""
    why, path = str(getattr(error, "strerror", None) or error), Path(path)
    if not isinstance(error, FileNotFoundError) or not os.path.isdir(path.parent):
        return why
    beside = {Path(k).stem: k for k in os.listdir(path.parent) if Path(k).suffix == path.suffix}
    closest = difflib.get_close_matches(path.stem, beside, n=1, cutoff=_ALIKE)
    return f'{why}; did you mean "{beside[closest[0]]}"?' if closest else why


def _plain(name: str) -> str:
    return name.lower().replace("_", "-")
