"""`selected_with_tolerances`: how far off a description is, weighed against what it may lack.

A description says how exactly its numbers are known, and may be wrong in that. Errors ten
times as large as stated look like effects that nobody hid: a rotor that is 8 % heavier, a
sensor's gain. One size of all tolerances is therefore an unknown, too. Answers under wider ones
are compared with that under those stated by their evidence (Laplace: the deviance, the price of
the numbers named and of the choice of each name from the library, and the log-determinant by
which wider priors are less probable). A single error far off stays a name, since all others
would have to be wide for nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ves_gym.diagnosis.inference.fit import Fit, fit
from ves_gym.diagnosis.inference.model_selection import Selection, cost
from ves_gym.diagnosis.inference.signatures import Signatures
from ves_gym.diagnosis.inference.whitened_residuals import WhitenedResiduals

FACTORS = (3.0, 10.0)  # of the tolerances stated
MARGIN = 10.0  # of evidence (twice its logarithm) in favour of what is stated
_OFF = 3.0  # stated standard deviations from which an error is told
_TOLD = 4  # errors in a sentence


@dataclass(frozen=True)
class ToleranceExcess:
    """An error of the description larger than it says."""

    name: str
    size: float  # in the unit of its tolerance
    sigma: float  # the same in stated standard deviations


@dataclass(frozen=True)
class ToleranceFit:
    """The answer under the most probable size of the tolerances."""

    selection: Selection
    residuals: WhitenedResiduals
    signatures: Signatures
    factor: float  # of the tolerances stated
    gained: float  # twice the log of the evidence for it, over that for those stated


def selected_with_tolerances(
    residuals: WhitenedResiduals,
    signatures: Signatures,
    select: Callable[[WhitenedResiduals, Signatures], Selection],
    doubtful: Callable[[Selection], bool],
) -> ToleranceFit:
    """Return the most probable answer over sizes of the tolerances.

    Args:
        residuals: with the tolerances stated.
        signatures: of the library on them.
        select: names effects.
        doubtful: whether an answer says that anything is missing; else the tolerances stated
            suffice.
    """
    first = select(residuals, signatures)
    library = len(signatures.candidates)
    stated = unlikeliness(first.fit, residuals, library)
    best = ToleranceFit(first, residuals, signatures, 1.0, 0.0)
    if not doubtful(first):
        return best
    names = len(first.fit.candidates)
    prices = cost(first.fit, residuals) - first.fit.deviance + _choice(names, library)
    for factor in FACTORS:
        wide = residuals.with_tolerances(factor)
        same = fit(wide, first.fit.candidates, first.fit.values)
        near = min(unlikeliness(k, wide, library) for k in (same, fit(wide, (), ())))
        if near - prices > stated - max(best.gained, MARGIN):
            continue
        widened = signatures.with_tolerances(wide)
        answer = select(wide, widened)
        gained = stated - unlikeliness(answer.fit, wide, library)
        if gained > max(best.gained, MARGIN):
            best = ToleranceFit(answer, wide, widened, factor, gained)
    return best


def unlikeliness(f: Fit, residuals: WhitenedResiduals, library: int = 1) -> float:
    """Return minus twice the log evidence of a fit, up to a constant.

    Args:
        f: fit.
        residuals: that it fits.
        library: candidates that each of its names was chosen from.
    """
    weight = 1 / np.maximum(f.size, 1.0)
    curvature = np.einsum("g,gij->ij", weight, residuals.gram)
    determinant = np.linalg.slogdet(np.eye(len(curvature)) + curvature)[1]
    return cost(f, residuals) + _choice(len(f.candidates), library) + float(determinant)


def _choice(names: int, library: int) -> float:
    """Return what names cost that any of a library could be: minus twice the log odds."""
    return 2 * names * float(np.log(max(library, 1)))


def errors_told(
    f: Fit, residuals: WhitenedResiduals, factor: float
) -> tuple[ToleranceExcess, ...]:
    """Return the errors that are larger than the description says, the farthest first.

    Args:
        f: fit.
        residuals: that it fits, with tolerances `factor` times those stated.
        factor: of the tolerances stated.
    """
    shared = residuals.nuisances[: residuals.shared]
    every = (
        ToleranceExcess(k.name, float(x * k.std), float(x * factor))
        for k, x in zip(shared, f.nuisances, strict=False)
    )
    return tuple(sorted((e for e in every if abs(e.sigma) > _OFF), key=lambda e: -abs(e.sigma)))


def sentence(factor: float, off: tuple[ToleranceExcess, ...]) -> str:
    """Return in words that errors are larger than the description says."""
    if factor == 1.0:
        return ""
    listing = ", ".join(f"{e.name} {e.size:+.2g}" for e in off[:_TOLD])
    return (
        f" The description's errors are about {factor:g} times as large as it says"
        + (f" ({listing})" if listing else "")
        + "."
    )
