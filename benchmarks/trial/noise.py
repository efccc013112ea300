"""Three families of noise; each has the standard deviation that the log states."""

import numpy as np

from benchmarks.trial.arm import Array

FAMILIES = ("white", "slow", "heavy")
SLOW = ((0.02, 0.9), (3.0, 0.1))  # time constants [s] of slow noise, shares of its variance


def draw(family: str, std: Array, samples: int, dt: float, rng: np.random.Generator) -> Array:
    """Return noise (samples, len(std)).

    Args:
        family: `white`; `slow`, a correlated part of 20 ms and a slow one of 3 s that holds a
            tenth of the variance; `heavy`, Student's t with five degrees of freedom.
        std: of each channel.
        samples: number of them; dt: between two [s].
        rng: random generator.
    """
    shape = (samples, len(std))
    if family == "white":
        return rng.standard_normal(shape) * std
    if family == "heavy":
        return rng.standard_t(5, shape) * np.sqrt(3 / 5) * std
    if family != "slow":
        raise ValueError(f"noise: got {family!r}, expected one of {FAMILIES}")
    out = np.zeros(shape)
    for time, share in SLOW:
        keep = np.exp(-dt / time)
        kicks = rng.standard_normal(shape) * np.sqrt(share)
        x = kicks[0]
        out[0] += x
        for k in range(1, samples):
            x = keep * x + np.sqrt(1 - keep**2) * kicks[k]
            out[k] += x
    return out * std


def quantised(family: str, values: Array, std: Array) -> Array:
    """Return readings (N, m) rounded to steps of half the noise (m,), in family `slow` only."""
    return np.round(values / (std / 2)) * (std / 2) if family == "slow" else values
