"""Intervals of a gap: block bootstrap over stretches of the runs.

What is left of a residual comes in bursts (reversals, contacts), so neighbouring samples are
no independent witnesses. Runs are cut into stretches of a second; stretches are drawn with
replacement (Kuensch, Ann. Statist. 17, 1989), the same for before and after. Intervals are
Student's, of the logarithm: percentiles of so few stretches are too narrow.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy

from ves_gym._util.params import Array, Index
from ves_gym.diagnosis.inference.whitened_residuals import VarianceGroup, WhitenedResiduals

_BLOCK = 1.0  # s
_DRAWS = 1000
_SURE = 0.95
_MOST = 30.0  # of the logarithm of an interval's end


def stretches(
    residuals: WhitenedResiduals, groups: Sequence[VarianceGroup], z: Array
) -> list[Array]:
    """Return (b,) sums of squares of a channel's whitened numbers in each stretch, run by run.

    Args:
        residuals: of all runs.
        groups: the channel's, from low to high frequencies.
        z: (N,) whitened residual.
    """
    out = []
    for i, run in enumerate(residuals.runs):
        parts = [z[g.runs[i]].reshape(2, -1) for g in groups]
        spectrum = np.concatenate([real + 1j * imag for real, imag in parts])
        power = np.fft.irfft(spectrum, 4 * len(spectrum)) ** 2
        seconds = (run.length - 2 * run.window.skip) * run.dt
        pieces = np.array_split(power, max(2, round(seconds / _BLOCK)))
        sums = np.array([p.sum() for p in pieces])
        energy = float(sum(np.sum(p**2) for p in parts))
        out.append(sums * (energy / max(sums.sum(), 1e-300)))
    return out


def intervals(
    count: int, sums: Sequence[Array], least: float = 1.0, seed: int = 0
) -> tuple[tuple[float, float], ...]:
    """Return 95 % intervals of root mean squares, and of the last over the first.

    Args:
        count: numbers in all.
        sums: (b,) sums of squares of the same stretches, of each quantity.
        least: that the last is compared with, be the first as small as it may.
        seed: of the draws.

    Returns:
        Low and high, k + 1 times.
    """
    b = len(sums[0])
    draws = np.random.default_rng(seed).integers(0, b, (_DRAWS, b))
    identity = np.arange(b)[None]
    estimates, resampled = (_sizes(count, sums, rows, least) for rows in (identity, draws))
    wide = scipy.stats.t.ppf((1 + _SURE) / 2, b - 1) * np.sqrt(b / (b - 1))
    out = []
    for size, replicates in zip(estimates, resampled, strict=True):
        reach = wide * float(np.std(np.log(np.maximum(replicates, 1e-300))))
        x = float(size[0])
        out.append((x * float(np.exp(-reach)), x * float(np.exp(min(reach, _MOST)))))
    return tuple(out)


def _sizes(count: int, sums: Sequence[Array], rows: Index, least: float) -> list[Array]:
    """(d,) root mean squares of stretches drawn (d, b), and the last over the first."""
    sizes = [np.sqrt(s[rows].sum(axis=1) / count) for s in sums]
    return [*sizes, sizes[-1] / np.maximum(sizes[0], least)]
