"""Joint motions with exact rates and accelerations."""

from dataclasses import dataclass

import numpy as np

from benchmarks.trial.arm import Array


@dataclass(frozen=True)
class Quintics:
    """From point to point, at rest at each, with pauses between.

    `points` (k, n) [rad], `times` (k - 1, 2): begin and end of each move [s].
    """

    points: Array
    times: Array

    def __call__(self, t: Array) -> tuple[Array, Array, Array]:
        """Angles, rates and accelerations (len(t), n)."""
        q = np.repeat(self.points[:1], len(t), axis=0)
        v, a = np.zeros_like(q), np.zeros_like(q)
        for move, (begin, end) in zip(np.diff(self.points, axis=0), self.times, strict=True):
            T = end - begin
            s = np.clip((t - begin) / T, 0.0, 1.0)[:, None]
            q = q + move * s**3 * (10 - 15 * s + 6 * s**2)
            v = v + move * 30 * s**2 * (1 - s) ** 2 / T
            a = a + move * 60 * s * (1 - s) * (1 - 2 * s) / T**2
        return q, v, a


@dataclass(frozen=True)
class Sines:
    """Sums of sines about a centre, which grow from rest within `rise` seconds.

    `centre` (n,); `amplitude`, `frequency` [Hz] and `phase`: (n, k).
    """

    centre: Array
    amplitude: Array
    frequency: Array
    phase: Array
    rise: float = 1.5

    def __call__(self, t: Array) -> tuple[Array, Array, Array]:
        """Angles, rates and accelerations (len(t), n)."""
        w = 2 * np.pi * self.frequency
        angle = w * t[:, None, None] + self.phase
        f = (self.amplitude * np.sin(angle)).sum(-1)
        g = (self.amplitude * w * np.cos(angle)).sum(-1)
        h = -(self.amplitude * w**2 * np.sin(angle)).sum(-1)
        s = np.clip(t / self.rise, 0.0, 1.0)[:, None]
        b = s**3 * (10 - 15 * s + 6 * s**2)
        c = 30 * s**2 * (1 - s) ** 2 / self.rise
        d = 60 * s * (1 - s) * (1 - 2 * s) / self.rise**2
        return self.centre + b * f, c * f + b * g, d * f + 2 * c * g + b * h
