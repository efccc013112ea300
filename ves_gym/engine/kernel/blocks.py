"""Memory as the compiled code wants it: blocks of LANES simulations, a row per quantity."""

from __future__ import annotations

import math

import numpy as np

from ves_gym._util.params import Array, Rows
from ves_gym.engine.kernel.emit import LANES


def aligned(*shape: int) -> Array:
    """Zeros whose first element lies on a cache line."""
    size = math.prod(shape)
    raw = np.zeros(size + 8)
    start = (-raw.ctypes.data // 8) % 8
    return raw[start : start + size].reshape(shape)


def fill(rows: Array, values: Array) -> None:
    """Write values into lanes, zeros behind them.

    Args:
        rows: (blocks, k, LANES), written.
        values: (m, k).
    """
    full, remainder = divmod(len(values), LANES)
    if full:
        complete = values[: full * LANES].reshape(full, LANES, values.shape[1])
        rows[:full] = complete.swapaxes(1, 2)
    if full < len(rows):
        rows[full:] = 0.0
        if remainder:
            rows[full, :, :remainder] = values[full * LANES :].T


def put_rows(rows: Array, which: Rows, values: Array) -> None:
    """Write the values of some simulations into lanes.

    Args:
        rows: (blocks, k, LANES), written.
        which: m simulations; a slice stands for all of them.
        values: (m, k).
    """
    if isinstance(which, slice):
        fill(rows, values)
    else:
        rows[which // LANES, :, which % LANES] = values


def lanes(values: Array) -> Array:
    """(n, k) -> (blocks, k, LANES), the last block filled up with zeros."""
    n, k = values.shape
    out = aligned(-(-n // LANES), k, LANES)
    fill(out, values)
    return out


def unlane(rows: Array, n: int) -> Array:
    """Return lanes in plain order, a copy whatever n.

    Args:
        rows: (blocks, k, LANES).
        n: number of points.

    Returns:
        (n, k).
    """
    if n <= LANES:
        return rows[0, :, :n].T.copy()
    plain = rows.swapaxes(1, 2).reshape(len(rows) * LANES, rows.shape[1])
    return plain[:n].copy()


def numbers(rows: Array, n: int) -> Array:
    """Return lanes as a row per quantity, a copy.

    Args:
        rows: (blocks, k, LANES).
        n: number of simulations.

    Returns:
        (k, n).
    """
    if len(rows) == 1:
        return rows[0, :, :n].copy()
    return rows.swapaxes(0, 1).reshape(rows.shape[1], -1)[:, :n]
