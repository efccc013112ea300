"""`reliability`: how often a name with such evidence is right.

Probabilities among members of a library hold if one of them is the truth, and the
description's errors are as large as it says. Neither is sure: a law that the library does not
have takes the nearest name, and an error larger than stated takes that of an effect. Such names
gain less than true ones, and leave the description's errors strained. So right and wrong names
were counted where the truth is known, on machines of the trial, and a logistic curve
through them is the reliability (docs/diagnosis.md, "How often a name is right";
`python -m benchmarks.trial.reliability fit`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ves_gym.diagnosis.inference.fit import Fit
from ves_gym.diagnosis.inference.model_selection import (
    Selection,
    reduced_fit,
    reduced_selection,
)
from ves_gym.diagnosis.inference.whitened_residuals import WhitenedResiduals

NEEDED = 35.0  # deviance at which names begin to be given
COMPUTED = 20 / 21  # of names of what a computer evaluates: 19 of 19 (rule of succession)
DOUBT = 0.8  # reliability below which a name is withheld
USUAL = 20.0  # strain of a description that is right
EVEN, GAIN, STRAIN = 0.99, 0.86, -0.65  # log odds: there; per e-fold of either


def gain(residuals: WhitenedResiduals, f: Fit, i: int) -> float:
    """Return the deviance that the name in place i explains beside the others.

    Args:
        residuals: that were fitted.
        f: fit of all names.
        i: place.
    """
    return reduced_fit(residuals, f, [i]).deviance - f.deviance


def strain(residuals: WhitenedResiduals, f: Fit) -> float:
    """Return the sum of squares of the description's errors, in stated standard deviations.

    Args:
        residuals: that were fitted.
        f: fit of all names.
    """
    errors = f.nuisances[: residuals.shared]
    return float(errors @ errors)


def reliability(gained: float, strained: float) -> float:
    """Return the share of names that are right, of those with such evidence.

    Args:
        gained: deviance that the name explains beside the others.
        strained: `strain` of the description beside all names.
    """
    odds = EVEN + GAIN * np.log(max(gained, 1.0) / NEEDED)
    odds += STRAIN * np.log(max(strained, 1.0) / USUAL)
    return float(1 / (1 + np.exp(-odds)))


def without(
    selection: Selection,
    residuals: WhitenedResiduals,
    places: Sequence[int],
    trust: Sequence[float],
) -> Selection:
    """Return the selection less the names in some places, and why in its steps.

    Args:
        selection: the answer.
        residuals: of the runs fitted.
        places: of names that are not right often enough.
        right: reliability of the name in every place.
    """
    for i in sorted(places, reverse=True):
        name = selection.fit.candidates[i].name
        why = f"{name}: withheld, of names with such evidence {100 * trust[i]:.0f} % are right"
        selection = reduced_selection(residuals, selection, i, why)
    return selection
