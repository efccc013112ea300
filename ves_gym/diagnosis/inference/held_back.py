"""What a fit leaves of runs, those that it was fitted to or others, channel by channel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ves_gym._util.params import Array
from ves_gym.diagnosis.constants import NOISE_POWER, QUIETEST
from ves_gym.diagnosis.inference.fit import Fit, fit_residual
from ves_gym.diagnosis.inference.intervals import intervals, stretches
from ves_gym.diagnosis.inference.variance_groups import (
    deviance,
    likely_sizes,
    limits_of,
    sizes,
)
from ves_gym.diagnosis.inference.whitened_residuals import VarianceGroup, WhitenedResiduals

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
    noise = np.maximum(noise, QUIETEST * n)
    return n, squares, noise


def excess(residuals: WhitenedResiduals, remainders: Array) -> float:
    """Return the evidence for power beyond any noise that was stated [deviance].

    Args:
        residuals: of runs.
        remainders: (N,) what is left of them.
    """
    n, *others = group_squares(residuals, remainders)
    return float((n * np.log(np.maximum(sizes(n, *others) / NOISE_POWER, 1.0))).sum())
