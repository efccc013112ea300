"""From a folder of entries to what the page shows: entries ranked, with their statistics.

The board is derived: the same files give the same board, to the last bit. That no file was
changed is what git's history is for.
"""

from __future__ import annotations

import math
import os
import re
from collections import defaultdict
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ves_gym._util.params import ParameterError, write_text
from ves_gym._util.statistics import iqm
from ves_gym.leaderboard import statistics
from ves_gym.leaderboard.entry import MEASURES, Entry, Refused, from_bytes
from ves_gym.leaderboard.files import ENTRY, read_files
from ves_gym.leaderboard.problems import PUBLIC, SCORES, get_problem
from ves_gym.report.pages import page, require_schema

SCHEMA = "ves-board/1"
RANKED = "reproduced"  # level of entries that are compared
BY_SUCCESS = ("tasks",)  # tracks that rank by classes of success before they do by the score
RATIOS = ("paths", "damping")  # tracks whose scores are ratios to something that is done today
PLACE = "docs/leaderboard"  # in a clone: entries, salts that were published, the page
_DIGITS = 6

Plain = dict[str, Any]


def read_board(folder: str | os.PathLike[str]) -> list[Entry]:
    """The entries of a board, in the order of their files' names.

    Raises:
        ParameterError: no such folder, or a file that is no entry of today's problems or has
            another's name.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise ParameterError(f"{folder}: no such board, a folder with a file per entry")
    out = []
    for path in sorted(folder.glob("*.json")):
        try:
            entry = from_bytes(read_files(path)[ENTRY])
        except Refused as error:
            raise ParameterError(f"{path}: {error}") from None
        if entry.file != path.name:
            raise ParameterError(f"{path}: its content belongs to {entry.file}")
        count = get_problem(entry.track, entry.problem).count
        if (results := entry.results["score"].shape[1]) != count:
            raise ParameterError(f"{path}: {results} results, {entry.problem} asks {count}")
        out.append(entry)
    return out


def make_board(entries: Iterable[Entry]) -> Plain:
    """Return plain data of schema ves-board/1.

    Entries of one track, problem and seeds are ranked among each other, by what was
    reproduced; what was only replayed is in `shown`.
    """
    cells: dict[tuple[str, str, str], list[Entry]] = defaultdict(list)
    replayed = []
    for entry in entries:
        if entry.level == RANKED:
            cells[entry.track, entry.problem, entry.seeds].append(entry)
        else:
            replayed.append({"problem": entry.problem, "seeds": entry.seeds, **_of(entry)})
    tracks = [
        {
            "track": track,
            "title": track.capitalize(),
            "groups": [_group(cells[key]) for key in sorted(cells) if key[0] == track],
        }
        for track in SCORES
    ]
    return {
        "schema": SCHEMA,
        "tracks": [track for track in tracks if track["groups"]],
        "shown": replayed,
    }


def _group(entries: Sequence[Entry]) -> Plain:
    """Entries ranked among each other."""
    first = entries[0]
    name, unit = SCORES[first.track]
    by_success = first.track in BY_SUCCESS
    stand = statistics.standings([e.results for e in entries], by_success=by_success)
    order = sorted(range(len(entries)), key=lambda k: (stand[k].rank.value, k))
    return {
        "problem": first.problem,
        "seeds": first.seeds,
        "score": {"name": name, "unit": unit},
        "reference": 1.0 if first.track in RATIOS else None,
        "entries": [
            {
                "rank": _plain(stand[k].rank),
                **({"class": stand[k].level} if by_success else {}),
                **_of(entries[k]),
            }
            for k in order
        ],
    }


def _of(entry: Entry) -> Plain:
    """Return what the page shows of one entry."""
    results = entry.results
    groups, episodes = results["score"].shape
    by_group = [float(k) for k in iqm(results["score"])]
    measures = {name: statistics.middle(results, name) for name in MEASURES}
    return {
        "file": entry.file,
        "name": entry.name,
        "author": entry.author,
        "kind": entry.method.kind,
        "score": _plain(statistics.score(results)),
        "success": _plain(statistics.success(results)),
        "failed": int((~np.isfinite(results["score"])).sum()),
        "episodes": episodes,
        "groups": groups,
        "by_group": _plain(by_group) if groups > 1 else [],
        **{name: _plain(value) for name, value in measures.items() if value is not None},
        "settings": entry.method.settings,
        "about": entry.about,
        "repeat": command(entry),
    }


def command(entry: Entry) -> str:
    """Return the command that repeats an entry of the board, from the root of a clone."""
    words = ["ves-gym leaderboard verify", f"{PLACE}/entries/{entry.file}"]
    peer = re.fullmatch(r"(\w+):\w+", str(entry.about.get("code")))  # of ours has dots
    if peer:
        words.append(f"--import examples/peers/{peer[1]}.py")
    if entry.seeds != PUBLIC:
        words.append(f"--salt {PLACE}/salts/{entry.seeds}")
    return " ".join(words)


def _plain(value: float | Iterable[float]) -> Any:
    """Numbers for JSON: rounded; what is infinite becomes null."""
    if isinstance(value, float):
        return float(f"{value:.{_DIGITS}g}") if math.isfinite(value) else None
    return [_plain(float(k)) for k in value]


def write_page(board: Plain, path: str | os.PathLike[str]) -> None:
    """Write the page of a board, completely or not at all.

    Raises:
        ParameterError: another schema, or a number that JSON has not.
    """
    write_text(path, render_page(board))


def render_page(board: Plain) -> str:
    """One HTML file: no server, no network, nothing beside it."""
    require_schema(board, SCHEMA, "board")
    return page(
        "leaderboard/page.html",
        title="Leaderboard of ves_gym",
        styles=("leaderboard/page.css",),
        scripts=("report/dom.js", "leaderboard/page.js"),
        data=board,
    )
