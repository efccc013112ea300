"""What the emulation loop reports: its signals at an instant, and stops of the platform."""

from __future__ import annotations

from typing import NamedTuple

from ves_gym._util.params import Array


class Event(NamedTuple):
    """A safety check that froze the platform (thesis 2.4.2)."""

    simulation: int
    time: float  # s
    reason: str

    def __str__(self) -> str:
        return f"platform frozen at t = {self.time:.4f} s: {self.reason}"


class Readings(NamedTuple):
    """Signals of the controller at one instant. Leading axis n."""

    wrench: Array  # (n, 6) sensor reading, platform frame [N, N m]
    gravity: Array  # (n, 6) estimate of its static part
    y: Array  # (n, 6) measured pose
    y_cmd: Array  # (n, 6) commanded pose
