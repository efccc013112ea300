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

from ves_gym._util.params import Array
from ves_gym.diagnosis.data.measured_run import COMMANDED, MEASURED, Run

_SHARE = 0.01  # of samples that repeat, above what chance has: lost
_TONE = 30.0  # power over that of its neighbours; the highest of 10^5 in noise have 12
_NEIGHBOURS = 61  # frequencies
_LINE = 1.5  # of a line's variance is what its highest frequency has under a Hann window
_SEEN = 8.0  # the same, of a tone that is known from another signal
_GRID = np.linspace(0.06, 0.5, 2000)  # frequencies, of the sampling rate; below is motion


@dataclass(frozen=True)
class Fault:
    """A fault of one signal."""

    signal: str
    kind: str  # "repeats" or "tone"
    size: float  # share of samples; power over its neighbours
    frequency: float | None  # Hz
    shared: bool = False  # other signals show the tone, too: the machine itself may oscillate

    @property
    def sentence(self) -> str:
        """In words."""
        if self.kind == "repeats":
            return (
                f"{self.signal} repeats itself in {100 * self.size:.2g} % of its samples"
                " (is a link losing packets?)"
            )
        cause = "does the loop ring" if self.shared else "is it picked up"
        return f"{self.signal} holds a tone of {self.frequency:.4g} Hz ({cause}?)"


def faults(runs: Sequence[Run]) -> tuple[Fault, ...]:
    """Return faults of measured signals that all runs hold, lost samples first."""
    names = [k for k in MEASURED if all(k in run for run in runs)]
    lost = {k: max(run.repeats.get(k, 0.0) for run in runs) for k in names}
    out = [Fault(k, "repeats", share, None) for k, share in lost.items() if share > _SHARE]
    spectra = {name: _tones(runs, name) for name in names}
    commands = [k for k in COMMANDED if all(k in run for run in runs)]
    commanded = np.max([_tones(runs, k) for k in commands], axis=0) if commands else 0 * _GRID
    for name, heights in spectra.items():
        at = int(np.argmax(heights))
        if heights[at] > _TONE and commanded[at] < _SEEN:  # what joints are told is motion
            elsewhere = max((x[at] for k, x in spectra.items() if k != name), default=0.0)
            hertz = float(_GRID[at] / runs[0].dt)
            out.append(Fault(name, "tone", float(heights[at]), hertz, bool(elsewhere > _SEEN)))
    return tuple(out)


def _tones(runs: Sequence[Run], name: str) -> Array:
    """(F,) power over its neighbours that half of the runs show, the highest coordinate's."""
    heights = []
    for run in runs:
        x = run[name]
        f, power = scipy.signal.periodogram(x, window="hann", detrend="linear", axis=0)
        around = scipy.ndimage.median_filter(power, size=(_NEIGHBOURS, 1)) / np.log(2)
        ratio = power / np.maximum(around, 1e-30 + 1e-12 * power.max(axis=0))
        if name in run.meta.get("noise_std", {}):  # a line within the noise stated is none
            ratio[_LINE * power * f[1] < run.noise[name].std ** 2] = 1.0
        ratio = scipy.ndimage.maximum_filter(ratio, size=(3, 1))
        heights.append(
            np.stack([np.interp(_GRID, f, ratio[:, i]) for i in range(x.shape[1])], axis=1)
        )
    return np.asarray(np.median(heights, axis=0).max(axis=1))
