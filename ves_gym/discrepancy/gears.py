"""How a gear gives: the one part of a port that has to be integrated in small steps."""

from __future__ import annotations

import numpy as np
from numba import njit

from ves_gym.core.params import Array

_PARTS = 4  # steps between two samples


def deflection(
    own: Array, load: Array, stiffness: float, damping: float, half: float, dt: float
) -> Array:
    """Angle x (..., T) of a link against its rotor: H x'' + d x' + k free(x) = load.

    free(x) is what x has beyond half the gap on either side. The other joints move as
    measured (derived in docs/discrepancy.md).

    Args:
        own: (..., T) inertia H of the link and what it carries [kg m^2].
        load: (..., T) torque that a rigid link would take [N m].
        stiffness, damping, half: k [N m/rad], d [N m s/rad], half the gap [rad].
        dt: between samples [s].
    """
    rows = _deflection(
        own.reshape(-1, own.shape[-1]),
        load.reshape(-1, load.shape[-1]),
        stiffness,
        damping,
        half,
        dt / _PARTS,
    )
    return np.asarray(rows).reshape(load.shape)


@njit(cache=True)
def _deflection(own: Array, load: Array, k: float, d: float, half: float, h: float) -> Array:
    out = np.empty_like(load)
    for row in range(load.shape[0]):
        first = load[row, 0]
        x, v = first / k + half * np.sign(first), 0.0
        for t in range(load.shape[1]):
            out[row, t] = x
            for _ in range(_PARTS):  # implicit in the teeth that touch
                beyond = x - min(max(x, -half), half)
                stiff = k if beyond != 0.0 else 0.0
                push = own[row, t] * v + h * (load[row, t] - k * beyond)
                v = push / (own[row, t] + h * d + h * h * stiff)
                x += h * v
    return out
