"""The table of hypotheses from which a verdict is read.

Rows are the names found, fewer and fewer of them down to none, each alone and with laws that
have no name, and the best with power that is no law's. A row's evidence is that of all runs: of
those fitted (`evidence.py`), and of those held back given them,

    p(fitted, held back | M) = p(fitted | M) p(held back | fitted, M),

where the second takes the numbers fitted (the errors of single runs are found on them). So runs
held back are no gate, they count like any other: a name that they contradict loses by them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import scipy

from ves_gym.diagnosis.constants import EXCESS, TEMPERATURE
from ves_gym.diagnosis.inference.constancy import changes
from ves_gym.diagnosis.inference.fit import Fit, fit_residual
from ves_gym.diagnosis.inference.held_back import likeliness
from ves_gym.diagnosis.inference.model_selection import Selection, cost, without
from ves_gym.diagnosis.inference.open_set import OpenSet
from ves_gym.diagnosis.inference.whitened_residuals import WhitenedResiduals

NOTHING, NONE_OF_THESE = "nothing", "none of these"
UNEXPLAINED = "power that no law explains"


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A row: names, with laws that have no name or without."""

    names: tuple[str, ...]
    unnamed: tuple[str, ...]
    named: Fit  # the fit of the names
    fit: Fit  # with laws without a name beside them
    fitted: float  # -2 log p of the runs fitted, choices counted
    held_back: float  # -2 log p of the runs held back, given those
    probability: float = 0.0

    @property
    def total(self) -> float:
        """-2 log p of all runs."""
        return self.fitted + self.held_back

    @property
    def label(self) -> str:
        """Names in words."""
        if not self.names:
            return NONE_OF_THESE if self.unnamed else NOTHING
        return " + ".join((*self.names, *((NONE_OF_THESE,) if self.unnamed else ())))


def table(
    selection: Selection,
    residuals: WhitenedResiduals,
    last: WhitenedResiduals | None,
    library: int,
) -> list[Hypothesis]:
    """Return all hypotheses, the most probable first.

    Args:
        selection: names found.
        residuals: of the runs fitted.
        last: of those held back.
        library: candidates that each name was chosen from.
    """
    fits = [selection.fit]
    while fits[-1].candidates:
        fewer = [without(residuals, fits[-1], i) for i in range(len(fits[-1].candidates))]
        fits.append(min(fewer, key=lambda f: cost(f, library)))
    unnamed = OpenSet(residuals, fits[-1])
    rows: list[Hypothesis] = []
    for f in fits:
        names = tuple(c.name for c in f.candidates)
        chosen = cost(f, library) - f.evidence
        full = unnamed.fit(f)
        for k in (f,) if full is f else (f, full):
            laws = tuple(c.name for c in k.candidates[len(names) :])
            predicted = 0.0 if last is None else _predicted(last, k)
            rows.append(Hypothesis(names, laws, f, k, k.evidence + chosen, predicted))
    best, *others = _weighted(rows)
    return [_of_constant_names(best, residuals), *others]


def with_excess(rows: Sequence[Hypothesis], evidence: float) -> list[Hypothesis]:
    """Return the rows of a table, and the first with power that no law explains beside it.

    Args:
        rows: the most probable first.
        evidence: for power beyond any noise stated in what the first leaves [deviance].
    """
    fitted, unnamed = rows[0].fitted + EXCESS - evidence, (*rows[0].unnamed, UNEXPLAINED)
    return _weighted([*rows, replace(rows[0], unnamed=unnamed, fitted=fitted)])


def _of_constant_names(row: Hypothesis, residuals: WhitenedResiduals) -> Hypothesis:
    """Return a row less the names whose numbers change: each is a law without a name."""
    f = row.named
    lost = [i for i, c in enumerate(f.candidates) if changes(f, i, residuals)]
    if not lost:
        return row
    changing = tuple(f"{f.candidates[i].name}, changing" for i in lost)
    for i in reversed(lost):
        f = without(residuals, f, i)
    names = tuple(c.name for c in f.candidates)
    return replace(row, names=names, unnamed=(*row.unnamed, *changing), named=f)


def _predicted(last: WhitenedResiduals, f: Fit) -> float:
    """Return -2 log p of runs held back under the numbers of a fit."""
    return likeliness(last, fit_residual(last, f, False)) / TEMPERATURE


def _weighted(rows: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Return hypotheses with their probabilities, the most probable first."""
    weight = scipy.special.softmax([-r.total / 2 for r in rows])
    out = [replace(r, probability=float(p)) for r, p in zip(rows, weight, strict=True)]
    return sorted(out, key=lambda r: r.total)


def beliefs(rows: Sequence[Hypothesis]) -> dict[str, float]:
    """Return the probability of every set of names; their sum is 1.

    Args:
        rows: of the table.
    """
    out = dict.fromkeys((NOTHING, NONE_OF_THESE), 0.0)
    for row in rows:
        out[row.label] = out.get(row.label, 0.0) + row.probability
    return out
