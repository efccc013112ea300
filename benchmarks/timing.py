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
    processor: float  # the same ratio of processor time, threads included, children not


def side_by_side(
    ours: Callable[[], object], reference: Callable[[], object], runs: int = 7
) -> Pair:
    """Run each once to warm up, then in turn; the ratio is taken within each pair."""
    ours(), reference()
    times, busy = [], []
    for _ in range(runs):
        begin, used = time.perf_counter(), time.process_time()
        ours()
        middle, half = time.perf_counter(), time.process_time()
        reference()
        times.append((middle - begin, time.perf_counter() - middle))
        busy.append((half - used, time.process_time() - half))
    ratios = sorted(b / a for a, b in times)
    return Pair(
        statistics.median(a for a, _ in times),
        statistics.median(b for _, b in times),
        statistics.median(ratios),
        ratios[0],
        ratios[-1],
        statistics.median(b / max(a, 1e-9) for a, b in busy),
    )
