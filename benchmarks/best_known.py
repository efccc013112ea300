"""Least simulated E_mean that was found for queries of reach100: best_known.json."""

import functools
import json
from pathlib import Path

from ves_gym.planners.query import Query

FILE = Path(__file__).with_suffix(".json")


@functools.cache
def _entries() -> dict[str, dict[str, float]]:
    entries: dict[str, dict[str, float]] = json.loads(FILE.read_text("utf-8"))["entries"]
    return entries


def best_known(query: Query) -> float:
    """E_mean [J] of a query on its ideal system.

    Raises:
        KeyError: nothing is known of it.
    """
    return _entries()[f"{query.system.ideal().hash[:12]} {query.name}"]["E_mean"]
