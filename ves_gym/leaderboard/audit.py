"""Checks of a committed board: its page is of today, its bundles give its rows."""

from __future__ import annotations

import json
import math
import os
import random
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ves_gym._util.params import ParameterError
from ves_gym.leaderboard.board import RANKED, History
from ves_gym.leaderboard.evaluators import history_reason
from ves_gym.leaderboard.journal import Journal
from ves_gym.leaderboard.published import bundle_of

_DATA = re.compile(r'<script type="application/json"[^>]*>(.*?)</script>', re.S)


def page_data(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return the data of a written page.

    Raises:
        ParameterError: it cannot be read, or holds none.
    """
    try:
        text = Path(path).read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ParameterError(f"{path}: cannot be read: {error}") from None
    found = _DATA.search(text)
    if found is None:
        raise ParameterError(f"{path}: is no page of a board")
    data: dict[str, Any] = json.loads(found[1])
    return data


def stale_ranked(
    page: Mapping[str, Any], journal: Journal, history: History = history_reason
) -> list[str]:
    """Name the entries that a page ranks and should not, and say where it is of other entries.

    Args:
        page: data of the page, schema ves-board/2.
        journal: the entries.
        history: why an entry is not of today's version, None where it is.
    """
    there = {r.id: r for r in journal.records}
    out = []
    if page["head"] != journal.head:
        out.append("the page is of other entries: write it again (ves-gym leaderboard render)")
    ranked = {
        id
        for track in page["tracks"]
        for group in track["groups"]
        for entry in group["entries"]
        for id in entry["ids"]
    }
    for id in sorted(ranked):
        if id not in there:
            out.append(f"{id}: ranked, and there is no such entry")
            continue
        entry = there[id].entry
        if (why := history(entry)) is not None:
            out.append(f"{there[id].name}: ranked, and stale: {why}")
        if entry["level"] != RANKED:
            out.append(f"{there[id].name}: ranked, and only {entry['level']}")
    return out


def drawn(folder: str | os.PathLike[str], share: float, seed: int) -> list[Path]:
    """Draw entries that have a published bundle, at least one where there is any.

    Args:
        folder: of the entries.
        share: of those with a bundle, in (0, 1].
        seed: of the draw.
    """
    with_bundle = sorted(p for p in Path(folder).glob("*.json") if bundle_of(p).exists())
    count = math.ceil(share * len(with_bundle))
    return random.Random(seed).sample(with_bundle, count)
