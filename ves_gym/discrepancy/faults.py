"""Faults of a recording that no part of a machine makes: lost samples, and a pure tone.

Both may lie outside the band that is compared, or look like some effect inside it. A fault is
told from what is there in any log: nothing moves at the same high frequency in every run, and
all coordinates of a noisy signal do not stand still together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from ves_gym.discrepancy.runs import MEASURED, Run

_SHARE = 0.01  # of samples that repeat, above what chance has: lost
_TONE = 30.0  # power over that of its neighbours; the highest of 10^5 in noise have 12
_NEIGHBOURS = 61  # frequencies
_LOW = 0.06  # of the sampling rate: below it there is motion
_GRID = 2000  # frequencies at which runs are compared


@dataclass(frozen=True)
class Fault:
    """A fault of one signal."""

    signal: str
    kind: str  # "repeats" or "tone"
    size: float  # share of samples; power over its neighbours
    frequency: float | None  # Hz

    @property
    def sentence(self) -> str:
        """In words."""
        if self.kind == "repeats":
            return (
                f"{self.signal} repeats itself in {100 * self.size:.2g} % of its samples"
                " (is a link losing packets?)"
            )
        return f"{self.signal} holds a tone of {self.frequency:.4g} Hz"


def faults(runs: Sequence[Run]) -> tuple[Fault, ...]:
    """Faults of measured signals that all runs hold, lost samples first."""
    names = [k for k in MEASURED if all(k in run for run in runs)]
    lost = {k: max(run.repeats.get(k, 0.0) for run in runs) for k in names}
    out = [Fault(k, "repeats", share, None) for k, share in lost.items() if share > _SHARE]
    for name in names:
        height, frequency = _tone(runs, name)
        if height > _TONE:
            out.append(Fault(name, "tone", height, frequency))
    return tuple(out)


def _tone(runs: Sequence[Run], name: str) -> tuple[float, float]:
    """The largest power over its neighbours that half of the runs show, and where [Hz]."""
    grid = np.linspace(_LOW, 0.5, _GRID)
    heights = []
    for run in runs:
        x = run[name]
        f, power = scipy.signal.periodogram(x, window="hann", detrend="linear", axis=0)
        around = scipy.ndimage.median_filter(power, size=(_NEIGHBOURS, 1)) / np.log(2)
        ratio = scipy.ndimage.maximum_filter(
            power / np.maximum(around, 1e-30 + 1e-12 * power.max(axis=0)), size=(3, 1)
        )
        heights.append(
            np.stack([np.interp(grid, f, ratio[:, i]) for i in range(x.shape[1])], axis=1)
        )
    common = np.median(heights, axis=0).max(axis=1)
    at = int(np.argmax(common))
    return float(common[at]), float(grid[at] / runs[0].dt)
