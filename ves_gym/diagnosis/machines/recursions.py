"""The parts of a port that go from sample to sample: how a gear gives, how friction grows."""

from __future__ import annotations

import numpy as np
from numba import njit

from ves_gym._util.params import Array


def deflection(
    torque: Array, stiffness: float, damping: float, half: float, dt: float
) -> Array:
    """Return the angle x by which a rotor leads its link: d x' + k free(x) = torque.

    free(x) is what x has beyond half the gap on either side. The torque is the one that goes
    through the gear, which the log holds; driven by the motion instead, a light link would
    ring, and make much of noise (derived in docs/diagnosis.md).

    Args:
        torque: (..., T) through the gear [N m].
        stiffness, damping, half: k [N m/rad], d [N m s/rad], half the gap [rad].
        dt: between samples [s].

    Returns:
        (..., T) rad.
    """
    rows = _deflection(
        np.ascontiguousarray(torque).reshape(-1, torque.shape[-1]),
        stiffness,
        damping / dt,
        half,
    )
    return np.asarray(rows).reshape(torque.shape)


@njit(cache=True)
def _deflection(torque: Array, k: float, c: float, half: float) -> Array:
    out = np.empty_like(torque)
    for row in range(torque.shape[0]):
        first = torque[row, 0]
        x = first / k + half * np.sign(first)
        for t in range(torque.shape[1]):
            push = torque[row, t] + c * x
            x = push / c if c > 0.0 else 0.0  # between the teeth, unless it is beyond them
            above, below = (push + k * half) / (c + k), (push - k * half) / (c + k)
            if above > half:
                x = above
            elif below < -half:
                x = below
            out[row, t] = x
    return out


@njit(cache=True)
def follow(law: Array, part: Array) -> Array:
    """Return rows that go a part of the way to their law in every sample.

    Args:
        law: (m, T, n).
        part: (m, T, n) of the way, 0 to 1.
    """
    out = law.copy()
    for row in range(law.shape[0]):
        for t in range(1, law.shape[1]):
            for j in range(law.shape[2]):
                before = out[row, t - 1, j]
                out[row, t, j] = before + part[row, t, j] * (law[row, t, j] - before)
    return out
