"""Clocks of recorders that are not in step: what a log stamps t was read a little later.

A robot's controller, a tracker of the base and the amplifier of a force sensor each have a
clock of their own. Its error against the commands' is an offset and a rate, other ones in every
run; they are tolerances like any other. Jitter from sample to sample is noise, proportional to
how fast a signal changes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ves_gym._util.params import require_positive, unit
from ves_gym.diagnosis.data.measured_run import NEAR, Run

ROBOT, TRACKER, AMPLIFIER = ("q", "v", "tau"), ("y", "yd"), ("w",)


@dataclass(frozen=True)
class ClockTolerance:
    """Usual errors of the clocks of a laboratory's recorders, standard deviations."""

    offset: float = unit("s", default=1e-4)  # between recorders
    rate: float = unit("1", default=2e-5)
    jitter: float = unit("s", default=0.0)  # of single samples

    def __post_init__(self) -> None:
        require_positive(self, "offset", "rate")


@dataclass(frozen=True)
class ClockError:
    """Signals of one run that were read `offset` + `rate` t later than stamped."""

    run: str
    signals: tuple[str, ...]
    offset: float = 0.0  # s
    rate: float = 0.0

    def undone(self, run: Run) -> Run:
        """Return the run as its stamps have it; others as they are."""
        if run.name != self.run:
            return run
        late = self.offset + self.rate * run.dt * np.arange(run.length)[:, None]
        moved = {k: run[k] - late * run.rate_of(k) for k in self.signals if k in run}
        return replace(run, signals={**run.signals, **moved}, memory={NEAR: run.memory})


def clock_errors(
    run: Run, tolerance: ClockTolerance, emulated: bool
) -> Iterator[tuple[str, ClockError, float]]:
    """Yield name, error and usual size of each, in units of the error itself.

    On Earth (`emulated`) the force sensor's amplifier is the loop's own.
    """
    recorders = {"robot": ROBOT, "tracker": TRACKER}
    if not emulated:
        recorders["amplifier"] = AMPLIFIER
    for name, signals in recorders.items():
        if not any(k in run for k in signals):
            continue
        if name != "robot":  # whose clock the commands have
            yield (
                f"time of the {name}",
                ClockError(run.name, signals, offset=1e-3),
                (tolerance.offset / 1e-3),
            )
        yield (
            f"clock rate of the {name}",
            ClockError(run.name, signals, rate=1e-4),
            (tolerance.rate / 1e-4),
        )


def with_jitter(run: Run, jitter: float, emulated: bool) -> Run:
    """Return the run with the jitter [s] of its recorders' samples, as in `clock_errors`."""
    shaken = (ROBOT, TRACKER) if emulated else (ROBOT, TRACKER, AMPLIFIER)
    return replace(run, jitter=dict.fromkeys(shaken, jitter)) if jitter else run
