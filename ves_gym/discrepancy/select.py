"""Which effects, together, the data ask for; and which others would do as well.

Forward and backward: a candidate comes in if it explains more than the best of the whole
library would by chance, and goes again if the others do without it; at the end each is
weighed against everything that could take its place.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import scipy

from ves_gym.core.params import Array
from ves_gym.discrepancy.bank import Bank
from ves_gym.discrepancy.candidates import Candidate
from ves_gym.discrepancy.evidence import Evidence
from ves_gym.discrepancy.fit import Fit, fit

FINALISTS = 6
_OTHERS, _EXCHANGES = 3, 4  # tried in a place on the way; exchanges at the end
_HOPELESS = 30.0  # cost by which a screen's runner-up is not worth a full fit
Tell = Callable[[str], None]


@dataclass(frozen=True)
class Thresholds:
    """What it takes; frozen on the development set of the blind benchmark."""

    chance: float = 0.005  # that anything of the library is named where nothing is missing
    gain: float = 12.0  # least gain in deviance beyond the numbers it costs
    most: int = 3  # effects
    alike: float = 6.0  # difference in cost below which two candidates are one class
    remains: float = 1000.0  # unexplained deviance that is more than noise
    explained: float = 0.5  # share left of what was unexplained: more, and no name is given
    imperfect: float = 1.7  # mean square that residuals of a good description may have
    power: float = 5.0  # standard deviations at which an effect of its usual size must show
    temperature: float = 4.0  # of the probabilities


@dataclass(frozen=True)
class Rival:
    """A candidate for one place in the answer."""

    candidate: Candidate
    values: Array
    cost: float
    probability: float


@dataclass(frozen=True)
class Selection:
    """The answer: a fit, and for each of its effects the rivals, itself among them."""

    null: Fit
    fit: Fit
    rivals: tuple[tuple[Rival, ...], ...]
    steps: list[str] = field(default_factory=list)


def cost(f: Fit, evidence: Evidence) -> float:
    """Deviance and what its numbers cost (Bayesian information criterion)."""
    return f.deviance + f.k * float(np.log(evidence.size))


def select(
    evidence: Evidence, bank: Bank, limits: Thresholds, tell: Tell = lambda text: None
) -> Selection:
    """Effects named one by one."""
    null = now = fit(evidence, (), ())
    steps: list[str] = []
    while len(now.candidates) < limits.most:
        tried = _finalists(evidence, bank, now)
        if not tried:
            break
        best = min(tried, key=lambda f: cost(f, evidence))
        gained = now.deviance - best.deviance
        k = best.k - now.k
        needed = float(scipy.stats.chi2.isf(limits.chance / len(bank.candidates), k))
        needed = max(needed, limits.gain + k * float(np.log(evidence.size)) / 2)
        new = best.candidates[-1]
        steps.append(f"{new.name}: gain {gained:.1f} of {needed:.1f} needed")
        tell(steps[-1])
        if gained < needed:
            break
        now = best
        for i in range(len(now.candidates) - 1):  # what came in before may now be another
            now = _in_place(evidence, bank, now, i, _OTHERS)[0]
    now, places = _weighed(evidence, bank, now)
    rivals = tuple(_rivals(fits, i, evidence, limits) for i, fits in enumerate(places))
    return Selection(null, now, rivals, steps)


def unexplained(f: Fit, evidence: Evidence, imperfect: float = 1.0) -> float:
    """Deviance of groups that are larger than noise, above that of noise."""
    n = np.array([g.n for g in evidence.groups], float)
    return float((n * np.log(np.maximum(f.size / imperfect, 1.0))).sum())


def _finalists(evidence: Evidence, bank: Bank, now: Fit) -> list[Fit]:
    """Full fits of the candidates that score best beside what has been found."""
    scores = bank.scores(now.residual, now.tangents, now.size)
    taken = {c.name for c in now.candidates}
    costs = [
        s.deviance + bank.candidates[s.candidate].k * np.log(evidence.size) for s in scores
    ]
    out: list[Fit] = []
    for i in np.argsort(costs):
        candidate = bank.candidates[int(i)]
        if candidate.name in taken:
            continue
        some = (*now.candidates, candidate)
        if out and costs[int(i)] > min(cost(f, evidence) for f in out) + _HOPELESS:
            break
        out.append(fit(evidence, some, (*now.values, scores[int(i)].values)))
        if len(out) == FINALISTS:
            break
    return out


def _weighed(evidence: Evidence, bank: Bank, now: Fit) -> tuple[Fit, list[list[Fit]]]:
    """The cheapest fit that exchanging single members leads to, and all that was tried."""
    places: list[list[Fit]] = []
    for _ in range(_EXCHANGES):
        places = []
        for i in range(len(now.candidates)):
            places.append(_in_place(evidence, bank, now, i, FINALISTS))
            if places[-1][0] is not now:
                now = places[-1][0]
                break
        else:
            break
    else:  # it still changes: weigh what there is
        places = [
            [now, *_replacements(evidence, bank, now, i, FINALISTS)]
            for i in range(len(now.candidates))
        ]
    return now, places


def _in_place(evidence: Evidence, bank: Bank, now: Fit, i: int, count: int) -> list[Fit]:
    """The fit and those with another candidate in place i, cheapest first."""
    fits = [now, *_replacements(evidence, bank, now, i, count)]
    return sorted(fits, key=lambda f: cost(f, evidence))


def _replacements(evidence: Evidence, bank: Bank, now: Fit, i: int, count: int) -> list[Fit]:
    """Fits with another candidate in place i, best first by score."""
    others = [c for j, c in enumerate(now.candidates) if j != i]
    values = [v for j, v in enumerate(now.values) if j != i]
    rest = fit(evidence, others, values)
    scores = bank.scores(rest.residual, rest.tangents, rest.size)
    costs = [
        s.deviance + bank.candidates[s.candidate].k * np.log(evidence.size) for s in scores
    ]
    out: list[Fit] = []
    taken = {c.name for c in now.candidates}
    for j in np.argsort(costs):
        candidate = bank.candidates[int(j)]
        if candidate.name in taken:
            continue
        if out and costs[int(j)] > min(cost(f, evidence) for f in out) + _HOPELESS:
            break
        some = (*others[:i], candidate, *others[i:])
        start = (*values[:i], scores[int(j)].values, *values[i:])
        out.append(fit(evidence, some, start))
        if len(out) == count:
            break
    return out


def _rivals(
    fits: list[Fit], i: int, evidence: Evidence, limits: Thresholds
) -> tuple[Rival, ...]:
    """What could stand in place i, most probable first."""
    costs = np.array([cost(f, evidence) for f in fits])
    weight = np.exp(-(costs - costs.min()) / (2 * limits.temperature))
    weight /= weight.sum()
    return tuple(
        Rival(f.candidates[i], f.values[i], float(c), float(w))
        for f, c, w in zip(fits, costs, weight, strict=True)
    )
