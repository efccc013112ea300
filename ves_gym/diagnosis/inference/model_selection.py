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

from ves_gym._util.params import Array
from ves_gym.diagnosis.inference.candidates import Candidate
from ves_gym.diagnosis.inference.fit import Fit, fit
from ves_gym.diagnosis.inference.signatures import Bank
from ves_gym.diagnosis.inference.variance_groups import products, solve
from ves_gym.diagnosis.inference.whitened_residuals import Evidence

FINALISTS = 6
_OTHERS, _EXCHANGES = 3, 4  # tried in a place on the way; exchanges at the end
# What the computer takes in and gives out is known to the last digit, and these have tolerances
_COMPUTED = ("base/stiffness", "base/virtual_mass", "base/damping")
_HOPELESS = 30.0  # cost by which a screen's runner-up is not worth a full fit
Tell = Callable[[str], None]


@dataclass(frozen=True)
class Thresholds:
    """What it takes. To be frozen on the development set before a sealed one is opened."""

    chance: float = 0.005  # that anything of the library is named where nothing is missing
    gain: float = 30.0  # least gain in deviance beyond the numbers it costs
    echo: float = 0.1  # least gain beside another effect of the same joint, in parts of its own
    most: int = 3  # effects
    alike: float = 6.0  # difference in cost below which two candidates are one class
    remains: float = 400.0  # unexplained deviance that is more than noise
    more: float = 1000.0  # and beside a name
    held_back: float = 0.5  # of the gap on runs held back, its mean square, that names leave
    explained: float = 0.6  # share left of what was unexplained: more, and no name is given
    imperfect: float = 1.7  # mean square that residuals of a good description may have
    power: float = 5.0  # standard deviations at which an effect of its usual size must show
    temperature: float = 4.0  # of the probabilities
    spread: float = 2.0  # standard deviations of numbers, over those of a perfect description


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
    """Deviance and what its numbers cost."""
    return f.deviance + sum(f.price(i, evidence.size) for i in range(len(f.candidates)))


def select(
    evidence: Evidence, bank: Bank, limits: Thresholds, tell: Tell = lambda text: None
) -> Selection:
    """Effects named one by one."""
    null = now = fit(evidence, (), ())
    steps: list[str] = []
    while (at := len(now.candidates)) < limits.most:
        tried = _tried(evidence, bank, now, at, {c.name for c in now.candidates}, FINALISTS)
        if not tried:
            break
        best = min(tried, key=lambda f: cost(f, evidence))
        gained, needed = now.deviance - best.deviance, _needed(evidence, bank, limits, best, at)
        new = best.candidates[at].name
        steps.append(f"{new}: gain {gained:.1f} of {needed:.1f} needed")
        tell(steps[-1])
        if gained < needed:
            break
        now = best
        for i in range(at):  # what came in before may now be another
            now = _in_place(evidence, bank, limits, now, i, _OTHERS)[0]
    for i in reversed(range(len(now.candidates))):  # or none at all
        rest = _without(evidence, now, i)
        lost, needed = rest.deviance - now.deviance, _needed(evidence, bank, limits, now, i)
        if lost < needed:
            steps.append(f"{now.candidates[i].name}: worth {lost:.1f} of {needed:.1f}, dropped")
            tell(steps[-1])
            now = rest
    now, places = _weighed(evidence, bank, limits, now)
    rivals = tuple(_rivals(fits, i, evidence, limits) for i, fits in enumerate(places))
    return Selection(null, now, rivals, steps)


def _needed(evidence: Evidence, bank: Bank, limits: Thresholds, f: Fit, i: int) -> float:
    """Gain in deviance for which the effect in place i is worth its numbers."""
    one = f.candidates[i]
    by_chance = float(scipy.stats.chi2.isf(limits.chance / len(bank.candidates), one.k))
    # No law is quite the machine's: what one leaves behind is not another effect.
    near = [j for j, c in enumerate(f.candidates) if j != i and c.slot == one.slot != ""]
    echo = 0.0
    if near:
        rest = _without(evidence, f, i)
        alone = [_without(evidence, rest, j - (j > i)).deviance for j in near]
        echo = limits.echo * (max(alone) - rest.deviance)
    guard = 0.0 if one.kind in _COMPUTED and "admittance" in one.ports else limits.gain
    return max(by_chance, echo, guard + f.price(i, evidence.size) / 2)


def unexplained(f: Fit, evidence: Evidence, imperfect: float = 1.0) -> float:
    """Deviance of groups that are larger than noise, above that of noise."""
    n = np.array([g.n for g in evidence.groups], float)
    return float((n * np.log(np.maximum(f.size / imperfect, 1.0))).sum())


def _without(evidence: Evidence, now: Fit, i: int) -> Fit:
    """The fit of all but the effect in place i."""
    others = [c for j, c in enumerate(now.candidates) if j != i]
    return fit(evidence, others, [v for j, v in enumerate(now.values) if j != i])


def _tried(
    evidence: Evidence, bank: Bank, rest: Fit, i: int, taken: set[str], count: int
) -> list[Fit]:
    """Full fits of what scores best beside `rest`, put in place i, best first by score."""
    price = float(np.log(evidence.size))
    scores = bank.scores(rest.residual, rest.tangents, rest.size)
    ahead = rest.deviance - _screened(evidence, rest)  # full fits know noise passed on
    costs = [s.deviance + ahead + bank.candidates[s.candidate].price * price for s in scores]
    out: list[Fit] = []
    free = [j for j in np.argsort(costs).tolist() if bank.candidates[j].name not in taken]
    for j in free[:count]:
        candidate = bank.candidates[j]
        if out and costs[j] > min(cost(f, evidence) for f in out) + _HOPELESS:
            break
        some = (*rest.candidates[:i], candidate, *rest.candidates[i:])
        start = (*rest.values[:i], scores[j].values, *rest.values[i:])
        tried = fit(evidence, some, start)
        if not tried.on_bound(i) and _lasts(evidence, tried, i):
            out.append(tried)
    return out


def _screened(evidence: Evidence, f: Fit) -> float:
    """Deviance of a fit by the measure of the bank's scores."""
    if not any(c.filters for c in f.candidates):
        return f.deviance
    some = products(evidence, f.residual, f.tangents)
    return solve(some, len(evidence.nuisances)).deviance


def _lasts(evidence: Evidence, f: Fit, i: int) -> bool:
    """Whether the effect in place i acts for as long as the band resolves: half a period.

    A step between two samples looks like a limit that cuts a few of them.
    """
    one = f.candidates[i]
    if not one.sets_in:
        return True
    model = evidence.machine.model([one.effect(f.values[i])])
    return evidence.acts(model, one.ports) > 0.5 / evidence.runs[0].band


def _weighed(
    evidence: Evidence, bank: Bank, limits: Thresholds, now: Fit
) -> tuple[Fit, list[list[Fit]]]:
    """The cheapest fit that exchanging single members leads to, and all that was tried."""
    places: list[list[Fit]] = []
    for _ in range(_EXCHANGES):
        places = []
        for i in range(len(now.candidates)):
            places.append(_in_place(evidence, bank, limits, now, i, FINALISTS))
            if places[-1][0] is not now:
                now = places[-1][0]
                break
        else:
            break
    else:  # it still changes: weigh what there is
        places = [
            [now, *(f for f in some if f is not now)]
            for i in range(len(now.candidates))
            for some in [_in_place(evidence, bank, limits, now, i, FINALISTS)]
        ]
    return now, places


def _in_place(
    evidence: Evidence, bank: Bank, limits: Thresholds, now: Fit, i: int, count: int
) -> list[Fit]:
    """The fit and those with another candidate in place i, cheapest first."""
    rest = _without(evidence, now, i)
    tried = _tried(evidence, bank, rest, i, {c.name for c in now.candidates}, count)
    fits = sorted([now, *tried], key=lambda f: cost(f, evidence))
    return [f for f in fits if not _elaborate(f, fits, rest, i, limits)]


def _elaborate(f: Fit, fits: list[Fit], rest: Fit, i: int, limits: Thresholds) -> bool:
    """Whether a simpler kind in place i explains about as much as this one."""
    own = f.candidates[i]
    simpler = [
        g.deviance
        for g in fits
        if own.within == g.candidates[i].kind and own.slot == g.candidates[i].slot
    ]
    least = 1 + limits.echo
    return any(rest.deviance - f.deviance < least * (rest.deviance - d) for d in simpler)


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
