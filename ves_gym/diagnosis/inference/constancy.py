"""The numbers of a law are the same in every run, and from the beginning of a run to its end.

What is not in the library takes the nearest name with the numbers that suit on average: a drive
that weakens as it warms is one that is weak, a joint of a structure that slips is a soft mode.
So every number may have a share of its own in each run and in each third of a run, a random
effect in parts of the number, whose size is the one of the largest evidence. No law of a
library holds to the last digit; where the size is about a third, it is another law.
"""

from __future__ import annotations

import numpy as np

from ves_gym._util.params import Array
from ves_gym.diagnosis.constants import CHANGES, SHARES
from ves_gym.diagnosis.inference.fit import Fit
from ves_gym.diagnosis.inference.prior_sizes import likeliest_sizes
from ves_gym.diagnosis.inference.variance_groups import products
from ves_gym.diagnosis.inference.whitened_residuals import VarianceGroup, WhitenedResiduals

_THIRDS = 3
_FINER = 4  # times as many instants as frequencies: thirds are cut between samples


def changes(f: Fit, i: int, residuals: WhitenedResiduals) -> bool:
    """Return True if the numbers of the name in place i change from run to run or within one.

    Args:
        f: fit of the runs.
        i: place of the effect.
        residuals: of the runs.
    """
    candidate = f.candidates[i]
    if candidate.counts is not None:  # a course of its own in every run
        return False
    first = len(f.forms) + sum(c.k for c in f.candidates[:i])
    sizes = list(candidate.factors)  # shapes, such as a damping, are told less well by a part
    mine = f.tangents[:, [first + k for k in sizes]] * np.abs(f.values[i][sizes])
    runs, p = len(residuals.runs), len(residuals.nuisances)
    parts = [in_run(residuals, mine, k) for k in range(runs if runs > 1 else 0)]
    parts += [in_third(residuals, mine, k) for k in range(_THIRDS)]
    inner = products(residuals, f.residual, np.hstack([*parts, f.tangents]))
    width = sum(x.shape[1] for x in parts)
    return likeliest_sizes(inner, f.size, [width], p, SHARES)[0] >= CHANGES


def in_run(residuals: WhitenedResiduals, x: Array, run: int) -> Array:
    """Return columns (N, k) where they are of one run, else zero.

    Args:
        residuals: whose numbers they are of.
        x: (N, k).
        run: from 0.
    """
    out = np.zeros_like(x)
    for g in residuals.groups:
        for place in _places(g, run):
            out[place] = x[place]
    return out


def in_third(residuals: WhitenedResiduals, x: Array, third: int) -> Array:
    """Return columns (N, k) of which each run has what falls in a third of its time.

    Args:
        residuals: whose numbers they are of.
        x: (N, k).
        third: from 0.
    """
    out = np.zeros_like(x)
    channels = dict.fromkeys((g.port, g.channel) for g in residuals.groups)
    for key in channels:
        ranges = [g for g in residuals.groups if (g.port, g.channel) == key]
        for run in range(len(residuals.runs)):
            for places in zip(*(_places(g, run) for g in ranges), strict=True):
                pairs = [x[p].reshape(2, -1, x.shape[1]) for p in places]
                spectrum = np.concatenate([real + 1j * imag for real, imag in pairs])
                count = len(spectrum)
                course = np.fft.ifft(spectrum, _FINER * count, axis=0)
                cuts = np.linspace(0, len(course), _THIRDS + 1).round().astype(int)
                course[: cuts[third]] = course[cuts[third + 1] :] = 0.0
                low_terms = np.fft.fft(course, axis=0)[:count]
                ends = np.cumsum([len(real) for real, _ in pairs])[:-1]
                for p, part in zip(places, np.split(low_terms, ends), strict=True):
                    out[p] = np.concatenate([part.real, part.imag])
    return out


def _places(group: VarianceGroup, run: int) -> list[slice]:
    """Return the slices of one run's numbers in a group and in its copies."""
    mine = group.runs[run]
    shifts = [part.start - group.part.start for part in (group.part, *group.copies)]
    return [slice(mine.start + s, mine.stop + s) for s in shifts]
