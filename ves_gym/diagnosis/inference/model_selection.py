"""Search for the names that the data ask for, with their rivals.

A candidate comes in if its evidence pays for the choice from the library, and if the best of
the whole library would seldom explain as much by chance. It goes again if the others do without
it; at the end each is weighed against everything that could take its
place.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy

from ves_gym._util.params import Array
from ves_gym.diagnosis.constants import CHANCE, TEMPERATURE
from ves_gym.diagnosis.inference.candidates import Candidate
from ves_gym.diagnosis.inference.fit import Fit, fit
from ves_gym.diagnosis.inference.null_law import NullLaw, null_law
from ves_gym.diagnosis.inference.signatures import Signatures
from ves_gym.diagnosis.inference.whitened_residuals import WhitenedResiduals

FINALISTS = 6
_OTHERS = 3  # tried in a place on the way
_HOPELESS = 30.0  # cost by which a screen's runner-up is not worth a full fit
_VALLEYS = 4  # of the starts of a law that its vehicle answers to, the first left out
Report = Callable[[str], None]


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


def cost(f: Fit, library: int) -> float:
    """Return minus twice the log evidence of a fit, the choice of its names counted.

    Args:
        f: fit.
        library: candidates that each name was chosen from.
    """
    return f.evidence + 2 * len(f.candidates) * float(np.log(max(library, 1)))


def select(
    residuals: WhitenedResiduals,
    signatures: Signatures,
    most: int | None = None,
    report: Report = lambda text: None,
) -> Selection:
    """Name effects one by one: forward-backward selection.

    Args:
        residuals: whitened, of the runs to fit.
        signatures: of the library on them.
        most: names at most; None: as many as the evidence bears.
        report: called with each step in words.
    """
    null = current = fit(residuals, (), ())
    law, library = null_law(signatures, null.size), len(signatures.candidates)
    first: tuple[Candidate, float] | None = None
    steps: list[str] = []

    def tell(text: str) -> None:
        steps.append(text)
        report(text)

    while most is None or len(current.candidates) < most:
        at = len(current.candidates)
        taken = {c.name for c in current.candidates}
        tried = _candidate_fits(residuals, signatures, current, at, taken, FINALISTS)
        if not tried:
            break
        best = min(tried, key=lambda f: cost(f, library))
        gained = current.deviance - best.deviance
        worth = cost(current, library) - cost(best, library)
        new, p = best.candidates[at], law.chance(gained / TEMPERATURE, best.candidates[at])
        tell(f"{new.name}: gain {gained:.1f}, evidence {worth:.1f}, {p:.2g} by chance")
        first = first or (new, gained)
        if worth < 0 or p > CHANCE:
            break
        current = best
        for i in range(at):  # what came in before may now be another
            current = _alternatives(residuals, signatures, current, i, _OTHERS)[0]
    current = _single_parts(residuals, signatures.candidates, current, most)
    current = pruned(residuals, current, library, tell)
    current, places = _exchange_members(residuals, signatures, current)
    rivals = tuple(_rivals(fits, i, library) for i, fits in enumerate(places))
    return Selection(null, current, rivals, steps, law, first)


def pruned(
    residuals: WhitenedResiduals, full: Fit, library: int, report: Report = lambda text: None
) -> Fit:
    """Return the fit without the effects that the others do without; one stays.

    Args:
        residuals: that it fits.
        full: fit.
        library: candidates that each name was chosen from.
        report: called with each effect that goes, in words.
    """
    for i in reversed(range(len(full.candidates))):
        reduced = without(residuals, full, i)
        if len(reduced.candidates) and cost(reduced, library) < cost(full, library):
            report(f"{full.candidates[i].name}: the others do without it")
            full = reduced
    return full


def without(residuals: WhitenedResiduals, full: Fit, i: int) -> Fit:
    """Return the fit of all but the effect in place i."""
    remaining = [j for j in range(len(full.candidates)) if j != i]
    return fit(
        residuals, [full.candidates[j] for j in remaining], [full.values[j] for j in remaining]
    )


def _single_parts(
    residuals: WhitenedResiduals,
    library: Sequence[Candidate],
    current: Fit,
    most: int | None = None,
) -> Fit:
    """Return a fit with causes replaced by their parts where that is the shorter description.

    Friction of a whole arm takes in whatever two of its joints have, and comes first because it
    explains more than either; it is the shorter one only where most of its parts are there.
    """
    by_name = {(c.kind, c.slot): c for c in library}
    for i, cause in enumerate(current.candidates):
        there = [k for k in np.flatnonzero(current.clear(i)) if cause.parts]
        parts = [by_name[cause.parts[k]] for k in there if cause.parts[k] in by_name]
        names = len(current.candidates) - 1 + len(parts)
        if not parts or len(parts) < len(there) or (most is not None and names > most):
            continue
        single = fit(
            residuals,
            (*current.candidates[:i], *parts, *current.candidates[i + 1 :]),
            (
                *current.values[:i],
                *(current.values[i][[k]] for k in there),
                *current.values[i + 1 :],
            ),
        )
        if cost(single, len(library)) < cost(current, len(library)) and all(
            single.is_told(i + j) for j in range(len(parts))
        ):
            return _single_parts(residuals, library, single, most)
    return current


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
    price, library = float(np.log(residuals.size)), len(signatures.candidates)
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
        if tried.is_told(i):
            out.append(tried)

    attempts = 0
    for j in free[:count]:
        if out and costs[j] > min(costs[k] for k in free[:attempts]) + _HOPELESS:
            break
        try_out(j, scores[j].values)
        attempts += 1
    if out:
        best = min(out, key=lambda f: cost(f, library))
        for j in free[attempts:]:
            other, winner = signatures.candidates[j], best.candidates[i]
            if _is_case_of(winner, other) or _is_case_of(other, winner):
                begin = scores[j].values.copy()
                begin[other.factors[0]] = best.values[i][winner.factors[0]]
                try_out(j, begin)
    return out


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


def _is_case_of(simple: Candidate, candidate: Candidate) -> bool:
    """Return True if a candidate is a wider law in the same place."""
    return candidate.within == simple.kind and candidate.slot == simple.slot


def _exchange_members(
    residuals: WhitenedResiduals, signatures: Signatures, best: Fit
) -> tuple[Fit, list[list[Fit]]]:
    """Return the cheapest fit that exchanging single members leads to, and all alternatives."""
    while True:  # every exchange is cheaper
        places: list[list[Fit]] = []
        for i in range(len(best.candidates)):
            places.append(_alternatives(residuals, signatures, best, i, FINALISTS))
            if places[-1][0] is not best:
                best = places[-1][0]
                break
        else:
            return best, places


def _alternatives(
    residuals: WhitenedResiduals,
    signatures: Signatures,
    current: Fit,
    i: int,
    count: int,
) -> list[Fit]:
    """Return the fit and those with another candidate in place i, cheapest first."""
    reduced = without(residuals, current, i)
    tried = _candidate_fits(
        residuals, signatures, reduced, i, {c.name for c in current.candidates}, count
    )
    library = len(signatures.candidates)
    return sorted([current, *tried], key=lambda f: cost(f, library))


def _rivals(fits: list[Fit], i: int, library: int) -> tuple[Rival, ...]:
    """Return the candidates for place i, most probable first."""
    costs = np.array([cost(f, library) for f in fits])
    weight = scipy.special.softmax(-costs / 2)
    return tuple(
        Rival(f.candidates[i], f.values[i], float(c), float(w))
        for f, c, w in zip(fits, costs, weight, strict=True)
    )
