"""Weighting by frequency: one linear filter on the motion of the base.

H(s) = g_n + sum_k (g_k - g_k+1) w_k / (s + w_k), w_k = 2 pi times a corner: the gain is g_1 far
below the first corner, g_n far above the last, and passes from one to the next by first order
at each. The filter acts on every coordinate of the base alike, and on its rate; it begins at
rest on the base's position.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ves_gym._util.params import Array, ParameterError, Vector, finite, unit


@dataclass(frozen=True, kw_only=True)
class FrequencyWeight:
    """Gains of slow and fast motion, with the corners between them."""

    corners: Vector = unit("Hz")  # (k,) ascending
    gains: Vector = unit("1")  # (k + 1,) of amplitudes: an energy takes their square

    def __post_init__(self) -> None:
        corners = finite(self.corners, (len(self.corners),), "FrequencyWeight.corners")
        if not ((corners > 0).all() and (np.diff(corners) > 0).all()):
            raise ParameterError(
                f"FrequencyWeight.corners must be > 0 Hz and ascend, got {self.corners}"
            )
        gains = finite(self.gains, (len(corners) + 1,), "FrequencyWeight.gains")
        if not ((gains >= 0).all() and gains.any()):
            raise ParameterError(
                f"FrequencyWeight.gains must be >= 0, not all zero, got {self.gains}"
            )

    @classmethod
    def through(cls, points: Sequence[tuple[float, float]]) -> FrequencyWeight:
        """Gains at frequencies (Hz, gain), the corners half-way between on a logarithmic scale.

        Args:
            points: one or more, in the order of their frequencies > 0.
        """
        if not points:
            raise ParameterError("a frequency weight needs at least one pair (Hz, gain)")
        hz, gains = np.array(points, float).T
        if not ((hz > 0).all() and (np.diff(hz) > 0).all()):
            raise ParameterError(
                f"frequencies must be > 0 Hz and ascend, got {', '.join(f'{k:g}' for k in hz)}"
            )
        corners = tuple(np.sqrt(hz[1:] * hz[:-1]).tolist())
        return cls(corners=corners, gains=tuple(gains.tolist()))

    @classmethod
    def parse(cls, text: str) -> FrequencyWeight:
        """Read pairs like 0.5:0,2:1 (gain 0 at 0.5 Hz, 1 at 2 Hz)."""
        try:
            pairs = [tuple(map(float, part.split(":"))) for part in text.split(",")]
            points = [(hz, gain) for hz, gain in pairs]
        except ValueError:
            raise ParameterError(
                f"a frequency weight must be pairs HZ:GAIN like 0.5:0,2:1, got {text!r}"
            ) from None
        return cls.through(points)

    def __str__(self) -> str:
        parts = [f"{self.gains[0]:g}"]
        for corner, gain in zip(self.corners, self.gains[1:], strict=True):
            parts.append(f"{gain:g} above {corner:.3g} Hz")
        return ", ".join(parts)

    @property
    def rates(self) -> Array:
        """(k,) w of the low-passes [rad/s]."""
        return 2 * np.pi * np.array(self.corners, dtype=np.float64)

    @property
    def steps(self) -> Array:
        """(k,) what the output takes of each low-pass: g_k - g_k+1."""
        return -np.diff(np.array(self.gains, dtype=np.float64))

    def response(self, hz: float) -> complex:
        """H(2 pi i f) at a frequency f [Hz]."""
        s = 2j * math.pi * hz
        return complex(self.gains[-1] + np.sum(self.steps * self.rates / (s + self.rates)))

    def apply(self, step: float, z: Array, zd: Array) -> tuple[Array, Array]:
        """Filter samples and their rates, exactly where z is linear between samples.

        Args:
            step: between samples [s].
            z: (N, k) coordinates.
            zd: (N, k) their rates.

        Returns:
            The filtered coordinates and their rates, (N, k) each.
        """
        from scipy.signal import lfilter  # heavy, and few energies are weighted

        out, rate = self.gains[-1] * z, self.gains[-1] * zd
        for w, share in zip(self.rates, self.steps, strict=True):
            decay = math.exp(-w * step)
            mean = (1 - decay) / (w * step)
            parts = [1 - mean, mean - decay], [1.0, -decay]
            low, _ = lfilter(*parts, z, axis=0, zi=mean * z[:1])  # from z[0] on
            out = out + share * low
            rate = rate + share * w * (z - low)
        return out, rate


# what slow attitude control leaves: above 1 Hz
FAST = FrequencyWeight(corners=(1.0,), gains=(0.0, 1.0))
