"""Drift as a diagnosis sees it: the course that a sensor signal took in each run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ves_gym._util.params import Array
from ves_gym.diagnosis.data.measured_run import Run
from ves_gym.system.candidate import Scope
from ves_gym.system.effect import EFFECTS, Effect

WAVES = 8  # a level and slow cosines
_INSTANTS = 256  # of a run, where the covariance of a drift is taken


@dataclass(frozen=True)
class SlowPath:
    """One course that a drifting sensor signal took: per run, a level and slow cosines."""

    channel: int
    weights: tuple[tuple[str, tuple[float, ...]], ...]  # run -> weight of each
    kind: str = "sensor/drift"

    def of(self, run: Run) -> Array:
        """Return the path (T,) in this run; zero in a run without weights."""
        weights = dict(self.weights).get(run.name, ())
        t = (np.arange(run.length) + 0.5) / run.length
        waves = (w * np.cos(np.pi * k * t) for k, w in enumerate(weights))
        return np.asarray(sum(waves, np.zeros(run.length)))

    @property
    def size(self) -> float:
        """Root mean square over the runs."""
        power = [
            series[0] ** 2 + sum(w * w for w in series[1:]) / 2 for _, series in self.weights
        ]
        return float(np.sqrt(np.mean(power)))

    @property
    def effect(self) -> Effect:
        """A drift of this size."""
        signals = list(EFFECTS[self.kind].candidates(Scope(joints=0)))
        return signals[self.channel].effect(np.array([self.size]))


def courses(run: Run, drift: Array, time: float) -> list[tuple[SlowPath, float]]:
    """Return independent courses of a drift in a run, of unit size, and their deviations.

    The axes of its covariance (Karhunen and Loeve): any course of the drift is a sum of them,
    each by a normal number of its own. The sensor may be warm, so that the level is as unknown
    as at any other time. `drift` (6,) is the standard deviation of the sensor's signals
    [N, N m], `time` its correlation time [s].
    """
    t = (np.arange(_INSTANTS) + 0.5) / _INSTANTS
    waves = np.cos(np.pi * np.arange(WAVES) * t[:, None])
    distance = run.length * run.dt * np.abs(t[:, None] - t)
    back = np.linalg.pinv(waves)
    variance, axes = np.linalg.eigh(back @ np.exp(-distance / time) @ back.T)
    return [
        (SlowPath(channel, ((run.name, tuple(axis)),)), float(drift[channel] * size))
        for channel in np.flatnonzero(drift).tolist()
        for axis, size in zip(axes.T.tolist(), np.sqrt(np.maximum(variance, 0.0)), strict=True)
    ]
