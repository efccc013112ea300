"""The numbers of a law are the same in every run, and from the beginning of a run to its end.

What is not in the library takes the nearest name with the numbers that suit on average: a drive
that weakens as it warms is one that is weak, a joint of a structure that slips is a soft mode,
a cable is a ripple. In each run, and early and late in it, other numbers would suit better. So
every name is fitted once more with a share of its own in each run and in each third of a run
(Chow, Econometrica 28, 1960: tests of equality between sets of coefficients). If that explains
clearly more, the law is another one, and its name is withdrawn.
"""

from __future__ import annotations

import numpy as np
import scipy

from ves_gym._util.params import Array
from ves_gym.diagnosis.inference.fit import Fit
from ves_gym.diagnosis.inference.model_selection import Selection, reduced_selection
from ves_gym.diagnosis.inference.reliability import gain
from ves_gym.diagnosis.inference.variance_groups import products, solve
from ves_gym.diagnosis.inference.whitened_residuals import VarianceGroup, WhitenedResiduals

_THIRDS = 3
_FINER = 4  # times as many instants as frequencies: thirds are cut between samples
_CHANCE = 1e-4  # of a law that holds being called unsteady
_SHARE = 0.1  # of what a name explains: no law holds to the last digit
_SHARE_SETS_IN = 0.35  # and when play closes or a limit is reached a log tells roughly
_ABSENT = 1e-9  # of a whitened residual


def drop_nonstationary(selection: Selection, residuals: WhitenedResiduals) -> Selection:
    """Return the selection less the names whose numbers change from run to run or within one.

    Args:
        selection: found on the runs fitted.
        residuals: of those.
    """
    for i in reversed(range(len(selection.fit.candidates))):
        candidate = selection.fit.candidates[i]
        if candidate.counts is not None:  # a course of its own in every run
            continue
        excess, count = unsteadiness(selection.fit, i, residuals)
        needed = float(scipy.stats.chi2.isf(_CHANCE, max(count, 1)))
        share = _SHARE_SETS_IN if candidate.sets_in else _SHARE
        needed += share * gain(residuals, selection.fit, i)
        if excess > needed:
            why = f"{excess:.1f} of deviance likelier with other numbers in each run and third"
            selection = reduced_selection(
                residuals, selection, i, f"{candidate.name}: withdrawn, {why}"
            )
    return selection


def unsteadiness(f: Fit, i: int, residuals: WhitenedResiduals) -> tuple[float, int]:
    """Return the deviance that numbers of its own in each part gain for an effect.

    The price of noise passed on is left out: numbers are fitted without it, and where those of
    an effect pass on less noise than such as fit best, it would count as a gain of the parts.

    Args:
        f: fit of the runs.
        i: place of the effect.
        residuals: of the runs.

    Returns:
        The gain, and how many numbers there are more.
    """
    first = len(f.forms) + sum(c.k for c in f.candidates[:i])
    mine = f.tangents[:, first : first + f.candidates[i].k]
    parts = [in_run(residuals, mine, k) for k in range(1, len(residuals.runs))]
    parts += [in_third(residuals, mine, k) for k in range(1, _THIRDS)]
    columns = np.hstack(parts)
    columns = columns[:, np.abs(columns).max(axis=0) > _ABSENT]
    fixed = len(residuals.nuisances) + len(f.forms)
    plain = solve(products(residuals, f.residual, f.tangents), fixed)
    wider = np.hstack([f.tangents, columns])
    freed = solve(products(residuals, f.residual, wider), fixed)
    return plain.misfit - freed.misfit, columns.shape[1]


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
    """Where the numbers of one run stand in a group and in its copies."""
    mine = group.runs[run]
    shifts = [part.start - group.part.start for part in (group.part, *group.copies)]
    return [slice(mine.start + s, mine.stop + s) for s in shifts]
