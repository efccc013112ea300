"""Slow noise: what sensors wander by beside the noise that shows above the motion.

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
from ves_gym.diagnosis.inference.whitened_residuals import WhitenedResiduals
from ves_gym.diagnosis.machines.base import Port

MOST = 0.25  # of a sensor's variance; more is a drift, which is an effect
_GRID = np.linspace(0.0, MOST, 26)
_LEAST = 0.01  # that is worth allowing for
_FEWEST = 3  # channels of which one may have an effect


def slow_shares(residuals: WhitenedResiduals) -> Mapping[str, float]:
    """Return the share of the noise's variance that wanders, port by port; those above zero.

    Args:
        residuals: whitened without slow noise.
    """
    null = fit(residuals, (), ())
    z = residuals.less_nuisances(residuals.null, null.nuisances, True)
    out: dict[str, float] = {}
    for port in residuals.ports:
        if len(port.channels) < _FEWEST:
            out[port.name] = 0.0
            continue
        power, visible = residuals.wander_shown(port.name, z)
        share = float(
            np.median([_share(p, w) for p, w in zip(power.T, visible.T, strict=True)])
        )
        out[port.name] = share
    for port in residuals.ports:  # what one of them lacks is no wander of the same readings
        alike = [k.name for k in residuals.ports if _reads_as(port, k)]
        out[port.name] = min(out[name] for name in [port.name, *alike])
    return {name: share for name, share in out.items() if share >= _LEAST}


def _reads_as(a: Port, b: Port) -> bool:
    """Return True if the channels of two ports are the same readings: motor torques, say."""
    signal = a.channels[0].rpartition("_")[0]
    return a.channels == b.channels and signal in a.needs and signal in b.needs


def _share(power: Array, visible: Array) -> float:
    """Return the most probable share of a channel, its level in this range of frequencies free.

    Whittle's likelihood: power v (1 + share * shown), v at least that of noise.

    Args:
        power: (m,) in mean squares of the noise.
        shown: (m,) what slow noise of the same variance has.
    """
    model = 1 + _GRID[:, None] * visible
    level = np.maximum((power / model).mean(axis=1), 1.0)
    misfit = np.log(level) + (np.log(model) + power / model / level[:, None]).mean(axis=1)
    return float(_GRID[np.argmin(misfit)])
