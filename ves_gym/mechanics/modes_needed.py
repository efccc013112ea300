"""The number of internal modes that a structure needs, by an error of its frequencies.

The measure of `scripts/modes_needed.py`: every frequency of the structure with the arm on it,
below a band, against the most modes that there are.
"""

from __future__ import annotations

import numpy as np

from ves_gym._util.params import Array
from ves_gym.mechanics.craig_bampton import Reduction
from ves_gym.mechanics.modes import natural_modes

BAND = 20.0  # Hz
ERROR = 0.01  # of a frequency
FINE = 40  # modes that stand for all of them


def modes_needed(
    fine: Reduction, inertia: Array, *, band: float = BAND, error: float = ERROR
) -> int:
    """Return the fewest internal modes with which every frequency in the band is right.

    Args:
        fine: with all modes that are considered, in SI units.
        inertia: (poses, 6, 6) of what stands on the interface, joints locked.
        band: up to which frequencies count [Hz].
        error: of a frequency, relative.
    """
    wanted = [frequencies(fine, H) for H in inertia]
    for m in range(fine.m):
        coarse = [frequencies(fine.truncated(m), H) for H in inertia]
        pairs = zip(coarse, wanted, strict=True)
        if all(_agree(a, b, band, error) for a, b in pairs):
            return m
    return fine.m


def frequencies(reduction: Reduction, inertia: Array) -> Array:
    """Natural frequencies (6 + m,) [Hz] with a mass on the interface, slowest first.

    Args:
        reduction: in SI units.
        inertia: (6, 6) of what stands on the interface; zeros: nothing does.
    """
    mass, stiffness = reduction.matrices()
    mass = mass.copy()
    mass[:6, :6] += inertia
    out: Array = natural_modes(stiffness, mass).omega / (2 * np.pi)
    return out


def _agree(given: Array, wanted: Array, band: float, error: float) -> bool:
    inside = wanted[wanted < band]
    if len(given) < len(inside):
        return False
    gap = np.abs(given[: len(inside)] - inside)
    return bool((gap <= error * np.maximum(inside, 1e-9)).all())
