"""Noise that wanders: what sensors do beside the noise that shows above the motion.

In a log it lies under the motion. In residuals the motion is gone: where most channels of a
port have more and more towards zero frequency, as a wander has, its sensors wander. An effect
that shows in a few channels leaves their median alone, and tolerances are fitted along. The
median of one channel or two is the effect itself: nothing is told of such a port.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ves_gym._util.params import Array
from ves_gym.diagnosis.inference.fit import fit
from ves_gym.diagnosis.inference.whitened_residuals import (
    Wander,
    WhitenedResiduals,
    wander_shape,
)
from ves_gym.diagnosis.machines.base import Port

MOST = 0.5  # of a sensor's variance; more is a drift, which is an effect
MEMORIES = (0.5, 2.0, 8.0)  # s
_GRID = np.linspace(0.0, MOST, 26)
_LEAST = 0.01  # that is worth allowing for
_FEWEST = 3  # channels of which one may have an effect


def slow_noise(residuals: WhitenedResiduals) -> Mapping[str, Wander]:
    """Return how much the noise of each port wanders, of those where it does.

    Args:
        residuals: whitened without slow noise.
    """
    null = fit(residuals, (), ())
    z = residuals.less_nuisances(residuals.null, null.nuisances, True)
    out: dict[str, Wander] = {}
    for port in residuals.ports:
        out[port.name] = Wander(0.0, MEMORIES[0])
        if len(port.channels) >= _FEWEST:
            out[port.name] = _wander(residuals, port.name, z)
    for port in residuals.ports:  # what one of them lacks is no wander of the same readings
        alike = [k.name for k in residuals.ports if _reads_as(port, k)]
        out[port.name] = min((out[k] for k in [port.name, *alike]), key=lambda w: w.share)
    return {name: w for name, w in out.items() if w.share >= _LEAST}


def _reads_as(a: Port, b: Port) -> bool:
    """Return True if the channels of two ports are the same readings: motor torques, say."""
    signal = a.channels[0].rpartition("_")[0]
    return a.channels == b.channels and signal in a.needs and signal in b.needs


def _wander(residuals: WhitenedResiduals, port: str, z: Array) -> Wander:
    """Return the most probable share and memory: the median of the channels' likelihoods.

    Whittle's likelihood: power v (1 + share * shape), v at least that of noise.
    """
    lowest = residuals.lowest(port, z)
    power = np.concatenate([p for _, p in lowest])  # (m, c)
    misfits = []
    for memory in MEMORIES:
        shape = np.concatenate(
            [
                wander_shape(run.window, memory)[take]
                for run, (take, _) in zip(residuals.runs, lowest, strict=True)
            ]
        )
        model = 1 + _GRID[:, None, None] * shape[:, None]
        level = np.maximum((power / model).mean(axis=1), 1.0)  # (grid, c)
        misfits.append(
            np.log(level) + (np.log(model) + power / model / level[:, None]).mean(axis=1)
        )
    shares = np.array([[_GRID[np.argmin(m)] for m in of.T] for of in misfits])  # (memories, c)
    k = int(np.argmin([np.median(of.min(axis=0)) for of in misfits]))
    return Wander(float(np.median(shares[k])), MEMORIES[k])
