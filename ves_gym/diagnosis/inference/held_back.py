"""Runs held back decide: names that they contradict are withdrawn, silence that they contradict
is no silence.

A name has been chosen among a whole library by its gain on the runs fitted. On runs that no fit
has seen nothing was chosen: an effect that is there gains again, in proportion to the runs'
length, and one that is not there, or has numbers of its own in every run, loses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ves_gym._util.params import Array
from ves_gym.diagnosis.inference.fit import Fit, fit_residual
from ves_gym.diagnosis.inference.intervals import intervals, stretches
from ves_gym.diagnosis.inference.model_selection import Selection, reduced_selection
from ves_gym.diagnosis.inference.variance_groups import (
    deviance,
    deviances,
    likely_sizes,
    limits_of,
    sizes,
)
from ves_gym.diagnosis.inference.whitened_residuals import VarianceGroup, WhitenedResiduals

CLEAR = (
    100.0  # gain on the runs fitted that is no chance, though runs held back have none of it
)
LOSS = 2.0  # of deviance: less is no contradiction, as where a limit is not reached
WORSE = 1.02  # of its gap before, or of noise: a channel that is worse


@dataclass(frozen=True)
class Gap:
    """Disagreement of a channel, in standard deviations of the noise (root mean square)."""

    port: str
    channel: str
    before: float
    after: float
    before_interval: tuple[float, float] = (0.0, np.inf)  # 95 %
    after_interval: tuple[float, float] = (0.0, np.inf)
    ratio_interval: tuple[float, float] = (0.0, np.inf)  # of after over before, or over noise
    noise: float = 1.0  # that is expected after: what the effects pass on of it may be more

    @property
    def ratio(self) -> float:
        """After over before, or over noise where that is more."""
        return self.after / max(self.before, self.noise)

    @property
    def worse(self) -> bool:
        """True where the effects added spoil this channel."""
        return self.ratio > WORSE

    @property
    def surely_worse(self) -> bool:
        """True where it is worse and its interval has no place for being as good."""
        return self.worse and self.ratio_interval[0] > 1.0


def gaps(
    residuals: WhitenedResiduals, after: Fit, before: Fit, fitted: bool = True
) -> tuple[Gap, ...]:
    """Return the gap of every channel, effects and nuisances as they were found.

    Args:
        residuals: of the runs to judge by.
        after: with effects.
        before: the fit of the description as it is.
        fitted: on these runs; else what single runs have of their own is found on them.
    """
    remainders = [fit_residual(residuals, f, fitted) for f in (before, after)]
    out = []
    for port in residuals.ports:
        for i, channel in enumerate(port.channels):
            groups = [g for g in residuals.groups if (g.port, g.channel) == (port.name, i)]
            count = sum(g.n for g in groups)
            sums = [np.concatenate(stretches(residuals, groups, x)) for x in remainders]
            rms = [float(np.sqrt(s.sum() / count)) for s in sums]
            passed_on = float(group_squares(residuals, remainders[1], groups)[2].sum())
            noise = max(float(np.sqrt(passed_on / count)), 1.0)
            old, new, ratio = intervals(count, sums, noise)
            out.append(Gap(port.name, channel, rms[0], rms[1], old, new, ratio, noise))
    return tuple(out)


def drop_refuted_by_holdout(
    selection: Selection, residuals: WhitenedResiduals, last: WhitenedResiduals
) -> Selection:
    """Return the selection less the names that runs held back contradict.

    A name is contradicted where the runs held back are more probable without it, or where its
    port has a channel that is surely worse. One whose course is another in every run (a drift)
    has no numbers to hold, and a limit that is not reached gains and loses nothing.

    Args:
        selection: found on the runs fitted.
        residuals: of those.
        last: of the runs held back.
    """
    while selection.fit.candidates:
        losses = _losses(selection, residuals, last)
        worst = max(range(len(losses)), key=losses.__getitem__)
        spoilt = {
            g.port for g in gaps(last, selection.fit, selection.null, False) if g.surely_worse
        }
        hurt = [i for i, c in enumerate(selection.fit.candidates) if spoilt & set(c.ports)]
        if losses[worst] > LOSS:
            out, why = worst, f"{losses[worst]:.1f} of deviance worse with it"
        elif hurt:
            out = max(hurt, key=losses.__getitem__)
            why = f"worse by more than {100 * (WORSE - 1):.0f} % at {', '.join(sorted(spoilt))}"
        else:
            break
        name = selection.fit.candidates[out].name
        selection = reduced_selection(
            residuals, selection, out, f"{name}: withdrawn, runs held back are {why}"
        )
    return selection


def unexplained_there(last: WhitenedResiduals, fit: Fit, imperfect: float) -> float:
    """Return the deviance above that of noise which a fit leaves on runs held back.

    Args:
        last: of those runs.
        fit: found on others.
        imperfect: mean square that is still taken for noise.
    """
    n, *others = group_squares(last, fit_residual(last, fit, False))
    size = sizes(n, *others)
    return float((n * np.log(np.maximum(size / imperfect, 1.0))).sum())


def losses(last: WhitenedResiduals, full: Fit, reduced: Fit) -> float:
    """Return by how much the runs held back are less probable with one fit than another.

    Args:
        last: of those runs.
        full, reduced: fits found on others.
    """
    return likeliness(last, fit_residual(last, full, False)) - likeliness(
        last, fit_residual(last, reduced, False)
    )


def _losses(
    selection: Selection, residuals: WhitenedResiduals, last: WhitenedResiduals
) -> list[float]:
    """Return by how much the runs held back are less probable with each name than without."""
    out = []
    for i, candidate in enumerate(selection.fit.candidates):
        if candidate.counts is not None:  # a course of its own in every run
            out.append(0.0)
            continue
        without = reduced_selection(residuals, selection, i, "").fit
        out.append(_contradiction(last, selection.fit, without))
    return out


def _contradiction(last: WhitenedResiduals, full: Fit, reduced: Fit) -> float:
    """Return by how much the runs held back contradict what one fit has beyond another.

    A model passes noise of the motion on to one port and takes it from another. How much is
    expected from draws, and these runs have another: a group that grew by no more than it was
    to, or did not shrink by as much, contradicts nothing. So each counts by the noise that it
    was expected to leave or by its squares alone, whichever is less. Here it has no price: that
    a soft gear makes more noise of a torque was weighed on the runs fitted, and a slow run,
    which shows little of the gear, is not likelier without one for being quieter.

    Args:
        last: of those runs.
        full, reduced: fits found on others.
    """
    parts = []
    for f in (full, reduced):
        n, squares, noise = group_squares(last, fit_residual(last, f, False))
        most, least = np.maximum(noise, n), limits_of(last.groups)[1]
        parts.append(
            [deviances(n, likely_sizes(n, squares, k, most, least)) for k in (noise, n)]
        )
    differences = np.subtract(parts[0], parts[1])
    return float(differences.min(axis=0).sum())


def likeliness(last: WhitenedResiduals, remainders: Array) -> float:
    """Return the deviance of what is left of runs held back.

    Args:
        last: residuals of those runs.
        remainders: (N,) what is left of them.
    """
    n, squares, noise = group_squares(last, remainders)
    return deviance(n, likely_sizes(n, squares, noise, *limits_of(last.groups)))


def group_squares(
    last: WhitenedResiduals,
    remainders: Array,
    groups: Sequence[VarianceGroup] | None = None,
) -> tuple[Array, Array, Array]:
    """Return counts, squares and the squares that noise alone would have (G,) of the groups.

    Args:
        last: residuals of runs held back.
        remainders: (N,) what is left of them.
        groups: some of theirs; all by default.
    """
    groups = last.groups if groups is None else groups
    n = np.array([g.n for g in groups], float)
    squares = np.array([remainders[g.part] @ remainders[g.part] for g in groups])
    noise = n.copy()
    for k, g in enumerate(groups):
        for part in g.copies:
            usual = last.null[part]
            noise[k] += float(remainders[part] @ remainders[part] - usual @ usual) / len(
                g.copies
            )
    noise = np.maximum(noise, 0.05 * n)
    return n, squares, noise
