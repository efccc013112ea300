"""`DecisionClock`: how long a controller that plans while it acts takes to decide."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


class DecisionClock:
    """Number of decisions and their mean duration on the wall clock [s]."""

    def __init__(self) -> None:
        self._decisions, self._seconds = 0, 0.0

    @contextmanager
    def running(self) -> Iterator[None]:
        """Time one decision."""
        begin = time.perf_counter()
        yield
        self._seconds += time.perf_counter() - begin
        self._decisions += 1

    @property
    def about(self) -> dict[str, Any]:
        """Decisions so far and their mean duration [s], as plain data."""
        mean = self._seconds / max(self._decisions, 1)
        return {"decisions": self._decisions, "seconds_per_decision": round(mean, 4)}
