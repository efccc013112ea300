"""`single_parts`: a cause of which only a few parts are there is said by those parts.

Friction of a whole arm takes in whatever two of its joints have, and comes first because it
explains more than either. It is the shorter description only where most of its parts are
there: every name costs its numbers and the choice among the library.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ves_gym.diagnosis.inference.candidates import Candidate
from ves_gym.diagnosis.inference.fit import Fit, fit
from ves_gym.diagnosis.inference.whitened_residuals import WhitenedResiduals


def single_parts(
    residuals: WhitenedResiduals,
    library: Sequence[Candidate],
    current: Fit,
    most: int | None = None,
) -> Fit:
    """Return a fit with causes replaced by their parts where that is the shorter description.

    Args:
        residuals: that were fitted.
        library: all candidates.
        current: fit.
        most: effects to name at most.
    """
    by_name = {(c.kind, c.slot): c for c in library}
    choice = 2 * float(np.log(len(library)))  # of a name
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
        before, after = (f.evidence + choice * len(f.candidates) for f in (current, single))
        if after < before and all(single.is_told(i + j) for j in range(len(parts))):
            return single_parts(residuals, library, single, most)
    return current
