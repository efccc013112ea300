"""The common scale of a description's errors, told by the data.

A description says how exactly its numbers are known, and may be wrong in that. Errors ten times
as large as stated look like effects that nobody hid: a rotor that is 8 % heavier, a sensor's
gain. So one scale of all tolerances, and of the jitter of clocks, which is noise, is an unknown
with a prior about 1 (`constants.py`), and answers under two scales are compared by their
evidence. A single error far off stays a name, since all others would have to be wide for
nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from ves_gym.diagnosis.constants import CLEAR, SCALE_MOST, SCALE_SPREAD
from ves_gym.diagnosis.inference.fit import Fit
from ves_gym.diagnosis.inference.variance_groups import products, solve
from ves_gym.diagnosis.inference.whitened_residuals import WhitenedResiduals

_TOLD = 4  # errors in a sentence


@dataclass(frozen=True)
class ToleranceExcess:
    """An error of the description larger than it says."""

    name: str
    size: float  # in the unit of its tolerance
    sigma: float  # the same in stated standard deviations


def likeliest_scale(f: Fit, residuals: WhitenedResiduals) -> float:
    """Return the most probable scale of the tolerances beside a fit, 1 to `SCALE_MOST`.

    Args:
        f: fit.
        residuals: that it fits, with the tolerances stated.
    """
    fixed = len(residuals.nuisances) + len(f.forms)
    columns = np.column_stack([f.residual, f.tangents])

    def unlikeliness(log_scale: float) -> float:
        wide = residuals.with_tolerances(float(np.exp(log_scale)))
        z, *tangents = wide.rewhitened(columns, residuals).T
        X = np.reshape(tangents, (-1, residuals.length)).T
        solution = solve(products(wide, z, X), fixed)
        determinant = float(np.linalg.slogdet(solution.covariance)[1])
        likely = solution.deviance + wide.density - residuals.density
        return likely - determinant + scale_price(float(np.exp(log_scale)))

    minimum = scipy.optimize.minimize_scalar(
        unlikeliness, bounds=(0.0, np.log(SCALE_MOST)), method="bounded", options={"xatol": 0.1}
    )
    return float(np.exp(minimum.x)) if minimum.fun < unlikeliness(0.0) else 1.0


def scale_price(scale: float) -> float:
    """Return -2 log of the prior of a scale, over that of 1."""
    return float((np.log(scale) / np.log(SCALE_SPREAD)) ** 2)


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
    return tuple(
        sorted((e for e in every if abs(e.sigma) > CLEAR), key=lambda e: -abs(e.sigma))
    )


def sentence(factor: float, off: tuple[ToleranceExcess, ...]) -> str:
    """Return in words that errors are larger than the description says."""
    if factor == 1.0:
        return ""
    listing = ", ".join(f"{e.name} {e.size:+.2g}" for e in off[:_TOLD])
    return (
        f" The description's errors are about {factor:.2g} times as large as it says"
        + (f" ({listing})" if listing else "")
        + "."
    )
