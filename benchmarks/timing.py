"""Time two pieces of work in turn, so that a drifting machine touches both alike."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Pair:
    """Median seconds of ours and of the reference, and their ratio pair by pair."""

    ours: float
    reference: float
    ratio: float  # reference / ours: how many times faster ours is
    low: float
    high: float


def side_by_side(
    ours: Callable[[], object], reference: Callable[[], object], runs: int = 7
) -> Pair:
    """Run each once to warm up, then in turn; the ratio is taken within each pair."""
    ours(), reference()
    times = []
    for _ in range(runs):
        begin = time.perf_counter()
        ours()
        middle = time.perf_counter()
        reference()
        times.append((middle - begin, time.perf_counter() - middle))
    ratios = sorted(b / a for a, b in times)
    return Pair(
        statistics.median(a for a, _ in times),
        statistics.median(b for _, b in times),
        statistics.median(ratios),
        ratios[0],
        ratios[-1],
    )
