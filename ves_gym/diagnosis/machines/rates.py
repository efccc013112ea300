"""Rates of joints as a drive reports them: through a low-pass."""

from __future__ import annotations

import numpy as np
import scipy

from ves_gym._util.params import Array


def low_passed(rate: Array, lag: Array, dt: float, begins: Array | None = None) -> Array:
    """Return rates through a first-order low-pass each, straight from sample to sample.

    Args:
        rate: (..., T, n) [rad/s].
        lag: (n,) time constants [s]; 0: none.
        dt: s between samples.
        begins: (..., n) what comes out at the first sample; None: the first rate, held before.

    Returns:
        (..., T, n).
    """
    out = rate.copy()
    for i in np.flatnonzero(lag):
        low = ([1.0], [float(lag[i]), 1.0])
        b, a, _ = scipy.signal.cont2discrete(low, dt, method="foh")
        b, first = np.ravel(b), rate[..., :1, i]
        start = (first if begins is None else begins[..., None, i]) - b[0] * first
        out[..., i] = scipy.signal.lfilter(b, a, rate[..., i], axis=-1, zi=start)[0]
    return out
