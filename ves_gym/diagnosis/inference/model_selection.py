"""Forward-backward selection of the effects that the data ask for, with their rivals.

A candidate comes in if it explains more than the best of the whole library would by chance,
and goes again if the others do without it; at the end each is weighed against everything
that could take its place.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from ves_gym._util.params import Array
from ves_gym.diagnosis.inference.candidates import Candidate
from ves_gym.diagnosis.inference.causes import single_parts
from ves_gym.diagnosis.inference.fit import Fit, fit
from ves_gym.diagnosis.inference.null_law import NullLaw, null_law
from ves_gym.diagnosis.inference.signatures import Signatures
from ves_gym.diagnosis.inference.whitened_residuals import WhitenedResiduals

FINALISTS = 6
_OTHERS, _EXCHANGES = 3, 4  # tried in a place on the way; exchanges at the end
# What the computer takes in and gives out is known to the last digit, and these have tolerances
_COMPUTED = ("base/stiffness", "base/virtual_mass", "base/damping")
_EVALUATED = ("admittance",)  # ports that compare a computer's law with what it gave out
_HOPELESS = 30.0  # cost by which a screen's runner-up is not worth a full fit
_VALLEYS = 4  # of the starts of a law that its vehicle answers to, the first left out
Report = Callable[[str], None]


@dataclass(frozen=True)
class Thresholds:
    """Thresholds of the verdict, frozen before a sealed set is opened."""

    chance: float = 0.005  # that anything of the library is named where nothing is missing
    gain: float = 30.0  # least gain in deviance beyond the numbers it costs
    echo: float = 0.1  # least gain beside another that may echo there, in parts of its own
    onset: float = 0.5  # the same of one that sets in by a torque
    most: int | None = None  # effects; None: as many as the evidence bears
    usual_count: int = 3  # effects that are named on the usual evidence
    alike: float = 6.0  # difference in cost below which two candidates are one class
    remains: float = 400.0  # unexplained deviance that is more than noise
    sensed: float = 120.0  # the same of ports where no computer's law is compared
    unexplained_named: float = 1000.0  # and beside a name
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
    law: NullLaw = field(
        default_factory=lambda: NullLaw(1)
    )  # of the best gain of the library from noise
    first: tuple[Candidate, float] | None = None  # the best at first, and what it gained
    needed: tuple[float, ...] = ()  # gain that each had to have which was tried


def cost(f: Fit, residuals: WhitenedResiduals) -> float:
    """Return the deviance of a fit plus the cost of its numbers."""
    return f.deviance + sum(f.price(i, residuals.size) for i in range(len(f.candidates)))


def select(
    residuals: WhitenedResiduals,
    signatures: Signatures,
    limits: Thresholds,
    report: Report = lambda text: None,
) -> Selection:
    """Name effects one by one: forward-backward selection.

    Args:
        residuals: whitened, of the runs to fit.
        signatures: of the library on them.
        limits: thresholds.
        report: called with each step in words.
    """
    null = current = usual = fit(residuals, (), ())
    law = null_law(signatures, null.size)
    first: tuple[Candidate, float] | None = None
    steps: list[str] = []
    needs: list[float] = []
    came: list[tuple[Candidate, float]] = []
    while limits.most is None or len(current.candidates) < limits.most:
        at = len(current.candidates)
        tried = _candidate_fits(
            residuals, signatures, current, at, {c.name for c in current.candidates}, FINALISTS
        )
        if not tried:
            break
        best = min(tried, key=lambda f: cost(f, residuals))
        gained, needed = (
            current.deviance - best.deviance,
            max(
                _required_gain(residuals, law, limits, best, at),
                _required_of_many(limits, best.candidates[at], came),
            ),
        )
        new, p = best.candidates[at], law.chance(gained, best.candidates[at])
        first = first or (new, gained)
        needs.append(needed)
        steps.append(f"{new.name}: gain {gained:.1f} of {needed:.1f} needed, {p:.2g} by chance")
        report(steps[-1])
        if gained < needed:
            break
        came.append((best.candidates[at], gained))
        current = best
        for i in range(at):  # what came in before may now be another
            current = _alternatives(residuals, signatures, limits, current, i, _OTHERS)[0]
        if len(current.candidates) <= limits.usual_count:
            usual = current
    many = len(current.candidates) > limits.usual_count
    if many and unexplained(current, residuals, limits.imperfect) > limits.unexplained_named:
        # so many names that do not suffice are a library that imitates something else
        steps.append(
            f"{len(current.candidates)} names leave more: those after {limits.usual_count} go"
        )
        report(steps[-1])
        current = usual
    current = single_parts(residuals, signatures.candidates, current, limits.most)
    for i in reversed(range(len(current.candidates))):  # or none at all
        reduced = _without(residuals, current, i)
        lost, needed = (
            reduced.deviance - current.deviance,
            _required_gain(residuals, law, limits, current, i),
        )
        if lost < needed:
            steps.append(
                f"{current.candidates[i].name}: worth {lost:.1f} of {needed:.1f}, dropped"
            )
            report(steps[-1])
            current = reduced
    current, places = _exchange_members(residuals, signatures, limits, current)
    rivals = tuple(_rivals(fits, i, residuals, limits) for i, fits in enumerate(places))
    return Selection(null, current, rivals, steps, law, first, tuple(needs))


def _required_gain(
    residuals: WhitenedResiduals, law: NullLaw, limits: Thresholds, f: Fit, i: int
) -> float:
    """Return the gain in deviance for which the effect in place i is worth its numbers."""
    candidate = f.candidates[i]
    by_chance = law.gain(limits.chance, candidate)
    # No law is quite the machine's: what one leaves behind is not another effect.
    near = [j for j, c in enumerate(f.candidates) if j != i and _may_echo(c, candidate)]
    echo = 0.0
    if near:
        reduced = _without(residuals, f, i)
        explained = [
            (_without(residuals, reduced, j - (j > i)).deviance - reduced.deviance)
            / max(len({slot for _, slot in f.candidates[j].parts}), 1)
            for j in near
        ]
        echo = (limits.onset if candidate.sets_in else limits.echo) * max(explained)
    guard = 0.0 if is_computed(candidate) else limits.gain
    return max(by_chance, echo, guard + f.price(i, residuals.size) / 2)


def is_computed(candidate: Candidate) -> bool:
    """Return True for numbers of a law that a computer evaluates on what it logs."""
    return candidate.kind in _COMPUTED and "admittance" in candidate.ports


def _may_echo(c: Candidate, candidate: Candidate) -> bool:
    """Return True if what the law of c leaves may be taken for a candidate.

    At its own place, or, if it sets in by a torque that is measured with noise (play, a limit),
    at every joint: the arm couples them, and when it set in is never quite known.
    """
    if c.places & candidate.places:
        return True
    return c.sets_in and "joint" in c.ports and "joint" in candidate.ports


def _required_of_many(
    limits: Thresholds, candidate: Candidate, came: Sequence[tuple[Candidate, float]]
) -> float:
    """Return the gain in deviance that one more of many names needs.

    What the first few leave at their ports of a law that none of them is comes in ever smaller
    pieces; what is really there beside them is about as large as they are.

    Args:
        limits: thresholds.
        candidate: the one more.
        came: names so far, with what each gained.
    """
    gains = [gained for c, gained in came if set(c.ports) & set(candidate.ports)]
    return (
        limits.echo * sum(gains) / len(gains)
        if gains and len(came) >= limits.usual_count
        else 0.0
    )


def unexplained(
    f: Fit, residuals: WhitenedResiduals, imperfect: float = 1.0, but: Sequence[str] = ()
) -> float:
    """Return the deviance of groups that are larger than noise, above that of noise.

    Args:
        f: fit.
        residuals: that were fitted.
        imperfect: mean square that is still taken for noise.
        but: ports that are left out.
    """
    n = np.array([g.n for g in residuals.groups if g.port not in but], float)
    size = np.array(
        [s for s, g in zip(f.size, residuals.groups, strict=True) if g.port not in but]
    )
    return float((n * np.log(np.maximum(size / imperfect, 1.0))).sum())


def allowed(f: Fit, residuals: WhitenedResiduals, limits: Thresholds) -> float:
    """Return the unexplained deviance from which it is more than noise.

    What a computer evaluates from what it logs has no noise, and rounding and the time between
    samples leave more than what is told of it; what sensors read is told well.

    Args:
        f: fit.
        residuals: that were fitted.
        limits: thresholds.
    """
    every = unexplained(f, residuals, limits.imperfect)
    sensed = unexplained(f, residuals, limits.imperfect, _EVALUATED)
    return every - max(every - limits.remains, sensed - limits.sensed)


def _without(residuals: WhitenedResiduals, full: Fit, i: int) -> Fit:
    """Return the fit of all but the effect in place i."""
    return reduced_fit(residuals, full, [i])


def reduced_fit(residuals: WhitenedResiduals, full: Fit, places: Sequence[int]) -> Fit:
    """Return the fit of all but the effects in some places.

    Args:
        residuals: of the runs fitted.
        full: fit.
        places: of effects that go.
    """
    remaining = [j for j in range(len(full.candidates)) if j not in places]
    return fit(
        residuals, [full.candidates[j] for j in remaining], [full.values[j] for j in remaining]
    )


def reduced_selection(
    residuals: WhitenedResiduals, selection: Selection, i: int, step: str
) -> Selection:
    """Return the selection without the effect in place i, the others fitted again.

    Args:
        residuals: of the runs fitted.
        selection: the answer.
        i: place.
        step: what to tell of it.
    """
    return Selection(
        selection.null,
        _without(residuals, selection.fit, i),
        selection.rivals[:i] + selection.rivals[i + 1 :],
        [*selection.steps, step],
        selection.law,
        selection.first,
        selection.needed,
    )


def drop_unidentified(selection: Selection, residuals: WhitenedResiduals) -> Selection:
    """Return the selection less the names whose numbers the runs cannot tell.

    One that came in with others may have other numbers once those are withdrawn.

    Args:
        selection: found on the runs fitted.
        residuals: of those.
    """
    i = 0
    while i < len(selection.fit.candidates):
        if _is_told(residuals, selection.fit, i):
            i += 1
            continue
        name = selection.fit.candidates[i].name
        selection = reduced_selection(
            residuals, selection, i, f"{name}: withdrawn, at the edge of what can be told"
        )
        i = 0
    return selection


def _candidate_fits(
    residuals: WhitenedResiduals,
    signatures: Signatures,
    reduced: Fit,
    i: int,
    taken: set[str],
    count: int,
) -> list[Fit]:
    """Return full fits of the best scores beside `reduced`, in place i, best score first.

    Of the best of them also what it is a case of, and what is a case of it: a score knows no
    other forms of a law (how a friction builds up, where a mass sits), and laws that differ in
    that alone may have very different ones.
    """
    price = float(np.log(residuals.size))
    scores = signatures.scores(reduced.residual, reduced.tangents, reduced.size)
    costs = [s.deviance + signatures.candidates[s.candidate].price * price for s in scores]
    out: list[Fit] = []
    free = [j for j in np.argsort(costs).tolist() if signatures.candidates[j].name not in taken]

    def try_out(j: int, begin: Array) -> None:
        candidate = signatures.candidates[j]
        extended = (*reduced.candidates[:i], candidate, *reduced.candidates[i:])
        start = (*reduced.values[:i], begin, *reduced.values[i:])
        tried = fit(residuals, extended, start)
        for other in _other_valleys(candidate, tried.values[i]):
            refit = fit(residuals, extended, (*tried.values[:i], other, *tried.values[i + 1 :]))
            tried = min(tried, refit, key=lambda f: f.deviance)
        if _is_told(residuals, tried, i) and _acts_long_enough(residuals, tried, i):
            out.append(tried)

    attempts = 0
    for j in free[:count]:
        if out and costs[j] > min(cost(f, residuals) for f in out) + _HOPELESS:
            break
        try_out(j, scores[j].values)
        attempts += 1
    if out:
        best = min(out, key=lambda f: cost(f, residuals))
        for j in free[attempts:]:
            other, winner = signatures.candidates[j], best.candidates[i]
            if _is_case_of(winner, other) or _is_case_of(other, winner):
                begin = scores[j].values.copy()
                begin[other.factors[0]] = best.values[i][winner.factors[0]]
                try_out(j, begin)
    return [f for f in out if not _is_strange_case(f, out, i)]


def _other_valleys(candidate: Candidate, values: Array) -> list[Array]:
    """Return other numbers from which a law whose vehicle answers to it is to be fitted.

    A heavy mode splits a vehicle's own in two, and either half may be taken for the new one:
    which it is a score of a light one does not tell.
    """
    if "base" not in candidate.ports or len(candidate.starts) < _VALLEYS:
        return []
    every = np.array(candidate.starts)
    out = every[np.linspace(0, len(every) - 1, _VALLEYS).round().astype(int)[1:]]
    out[:, candidate.factors] = values[list(candidate.factors)]
    return list(out)


def _is_strange_case(f: Fit, fits: list[Fit], i: int) -> bool:
    """Return True if a law in place i has an unusual form, and a wider one a usual form."""
    return not f.is_usual(i) and any(
        _is_case_of(f.candidates[i], g.candidates[i]) and g.is_usual(i) for g in fits
    )


def _is_case_of(simple: Candidate, candidate: Candidate) -> bool:
    """Return True if a candidate is a wider law in the same place."""
    return candidate.within == simple.kind and candidate.slot == simple.slot


def _is_told(residuals: WhitenedResiduals, f: Fit, i: int) -> bool:
    """Return True if the runs can tell the effect in place i: its numbers, and from noise."""
    return f.is_told(i) and not _is_noise_stated(residuals, f, i)


def _is_noise_stated(residuals: WhitenedResiduals, f: Fit, i: int) -> bool:
    """Return True for a drift that is less than the noise which the log states of its sensor.

    Such noise is all that a signal has beside the truth, and part of it may wander.
    """
    candidate = f.candidates[i]
    if candidate.counts is None or "wrench" not in candidate.ports:
        return False
    model, parts = residuals.machine.model([candidate.effect(f.values[i])]), []
    for run in residuals.runs:
        if "w" not in run.meta.get("noise_std", {}):
            return False
        moved, plain = residuals.machine.residuals(
            run, [model, residuals.machine.nominal], ["wrench"]
        )["wrench"]
        parts.append(np.square((moved - plain) / run.noise["w"].std).mean(axis=0))
    return bool(np.mean(parts, axis=0).max() < 1)


def _acts_long_enough(residuals: WhitenedResiduals, f: Fit, i: int) -> bool:
    """Return True if the effect in place i acts for half a period of the band's top or longer.

    A step between two samples looks like a limit that cuts a few of them.
    """
    candidate = f.candidates[i]
    if not candidate.sets_in:
        return True
    model = residuals.machine.model([candidate.effect(f.values[i])])
    return residuals.acts(model, candidate.ports) > 0.5 / residuals.runs[0].band


def _exchange_members(
    residuals: WhitenedResiduals, signatures: Signatures, limits: Thresholds, best: Fit
) -> tuple[Fit, list[list[Fit]]]:
    """Return the cheapest fit that exchanging single members leads to, and all alternatives."""
    places: list[list[Fit]] = []
    for _ in range(_EXCHANGES):
        places = []
        for i in range(len(best.candidates)):
            places.append(_alternatives(residuals, signatures, limits, best, i, FINALISTS))
            if places[-1][0] is not best:
                best = places[-1][0]
                break
        else:
            break
    else:  # it still changes: weigh what there is
        places = [
            [best, *(f for f in fits if f is not best)]
            for i in range(len(best.candidates))
            for fits in [_alternatives(residuals, signatures, limits, best, i, FINALISTS)]
        ]
    return best, places


def _alternatives(
    residuals: WhitenedResiduals,
    signatures: Signatures,
    limits: Thresholds,
    current: Fit,
    i: int,
    count: int,
) -> list[Fit]:
    """Return the fit and those with another candidate in place i, cheapest first."""
    reduced = _without(residuals, current, i)
    tried = _candidate_fits(
        residuals, signatures, reduced, i, {c.name for c in current.candidates}, count
    )
    fits = sorted([current, *tried], key=lambda f: cost(f, residuals))
    return [f for f in fits if not _is_overelaborate(f, fits, reduced, i, limits)]


def _is_overelaborate(
    f: Fit, fits: list[Fit], reduced: Fit, i: int, limits: Thresholds
) -> bool:
    """Return True if a simpler kind in place i explains about as much as this one."""
    candidate = f.candidates[i]
    simpler = [g.deviance for g in fits if _is_case_of(g.candidates[i], candidate)]
    least = 1 + limits.echo
    return any(reduced.deviance - f.deviance < least * (reduced.deviance - d) for d in simpler)


def _rivals(
    fits: list[Fit], i: int, residuals: WhitenedResiduals, limits: Thresholds
) -> tuple[Rival, ...]:
    """Return the candidates for place i, most probable first."""
    costs = np.array([cost(f, residuals) for f in fits])
    weight = np.exp(-(costs - costs.min()) / (2 * limits.temperature))
    weight /= weight.sum()
    return tuple(
        Rival(f.candidates[i], f.values[i], float(c), float(w))
        for f, c, w in zip(fits, costs, weight, strict=True)
    )
