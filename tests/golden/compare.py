"""Compare two results of a probe: plain data, whose numbers may differ by rounding."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

# Permitted between a stored number and one measured, over the largest of its series. Between
# AVX-512, AVX2 and neither, rounding moves what is simulated by 2e-11 at most and predicted
# energies by 2e-10 (docs/decisions/0015); probes are calm enough that it grows no further.
RELATIVE = 1e-9
# The same where the series itself is about zero: 1e-12 m, rad, J or N m is four decimal places
# below what any sensor of the machine resolves.
ABSOLUTE = 1e-12
DIGITS = 11  # stored of every number


class Deviation(NamedTuple):
    """The largest difference between two results."""

    where: str  # place in the results, "" if none differs
    size: float  # over the largest of its series; infinite where kind or number differs
    permitted: bool


def rounded(plain: Any) -> Any:
    """Return plain data with `DIGITS` of every number; infinities and NaN become text."""
    if isinstance(plain, dict):
        return {k: rounded(v) for k, v in plain.items()}
    if isinstance(plain, (list, tuple)):
        return [rounded(v) for v in plain]
    if isinstance(plain, np.ndarray):
        return rounded(plain.tolist())
    if isinstance(plain, np.generic):
        return rounded(plain.item())
    if isinstance(plain, float):
        return float(f"{plain:.{DIGITS}g}") if math.isfinite(plain) else str(plain)
    return plain


def compare(stored: Any, measured: Any, relative: float, where: str = "") -> Deviation:
    """Return the largest difference between two results of a probe.

    A list of numbers, or of lists of numbers of one length, is a series: each of its columns
    is compared over the column's largest size, to which the rounding of the whole series is
    added. Numbers in a table are a series each. Everything else must be equal.

    Args:
        stored, measured: plain data, as JSON gives it back.
        relative: permitted difference over the largest of a series.
        where: place of the two, for the answer.
    """
    series = _array(stored)
    if series is not None:
        other = _array(measured)
        if other is None or other.shape != series.shape:
            return Deviation(where, math.inf, False)
        size = np.abs(series).max(axis=0) if series.ndim else np.abs(series)
        gap = np.abs(other - series)
        excess = gap - relative * size - ABSOLUTE * max(1.0, float(np.max(size)))
        worst = float((gap / np.where(size > 0, size, 1.0)).max())
        return Deviation(where if worst else "", worst, bool((excess <= 0).all()))
    if isinstance(stored, dict) and isinstance(measured, dict):
        if missing := sorted(stored.keys() ^ measured.keys()):
            return Deviation(f"{where}.{missing[0]}".lstrip("."), math.inf, False)
        pairs = [(f"{where}.{k}".lstrip("."), stored[k], measured[k]) for k in stored]
    elif isinstance(stored, list) and isinstance(measured, list):
        if len(stored) != len(measured):
            return Deviation(where, math.inf, False)
        pairs = [
            (f"{where}[{k}]", a, b)
            for k, (a, b) in enumerate(zip(stored, measured, strict=True))
        ]
    else:
        same = type(stored) is type(measured) and stored == measured
        return Deviation("" if same else where, 0.0 if same else math.inf, same)
    parts = [compare(a, b, relative, place) for place, a, b in pairs]
    return max(parts, key=lambda d: (not d.permitted, d.size), default=Deviation("", 0.0, True))


def _array(value: Any) -> np.ndarray | None:
    """Return floats as an array, None where they are others or of several lengths."""
    if isinstance(value, float):
        return np.array(value)
    if not isinstance(value, list) or not value:
        return None
    inner = [k for part in value for k in (part if isinstance(part, list) else [part])]
    if not inner or not all(isinstance(k, float) for k in inner):
        return None
    if len({len(k) if isinstance(k, list) else -1 for k in value}) != 1:
        return None
    return np.asarray(value, dtype=np.float64)
