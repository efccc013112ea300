"""Arguments of a batch: which simulations, and numbers that broadcast to one shape."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, Index, ParameterError


def simulation_ids(ids: npt.ArrayLike | None, n: int) -> Index:
    """(k,) whole numbers of simulations, given so, by a mask (n,), or None for all n."""
    if ids is None:
        return np.arange(n)
    index = np.asarray(ids)
    if index.dtype == bool and index.shape == (n,):
        return np.flatnonzero(index)
    valid = index.ndim == 1 and (np.issubdtype(index.dtype, np.integer) or not index.size)
    if not valid or (index < 0).any() or (index >= n).any():
        raise ParameterError(f"ids must be whole numbers in [0, {n}), got {ids!r}")
    rising = (index[1:] > index[:-1]).all()
    if not rising and (np.diff(np.sort(index)) == 0).any():  # `np.unique` loads numpy.ma
        raise ParameterError(f"ids must name each simulation once, got {ids!r}")
    return index.astype(np.intp)


def broadcast(value: npt.ArrayLike, name: str, shape: tuple[int, ...]) -> Array:
    """`value` as finite float64 numbers of a shape; `name` is what an error calls it."""
    expected = f"{name} must be numbers of shape {shape}, got"
    array = numbers(value, expected)
    if array.shape != shape:
        try:
            array = np.broadcast_to(array, shape)
        except ValueError:
            raise ParameterError(f"{expected} {array.shape}") from None
    if not np.isfinite(array).all():
        where = np.argwhere(~np.isfinite(array))[0].tolist()
        raise ParameterError(f"{name} must be finite, got {array[tuple(where)]} at {where}")
    return array


def numbers(value: npt.ArrayLike, expected: str) -> Array:
    """`value` as a float64 array; text, truth values, None and ragged rows are errors."""
    try:
        array = np.asarray(value)
    except ValueError:
        raise ParameterError(f"{expected} ragged rows") from None
    if array.dtype.kind not in "fiu":
        raise ParameterError(f"{expected} {value!r}")
    return array.astype(np.float64)


def whole(value: int, name: str, least: int = 0) -> int:
    """`value` as a whole number from `least` up; `name` is what an error calls it."""
    if not isinstance(value, (int, np.integer)) or isinstance(value, bool) or value < least:
        raise ParameterError(f"{name} must be a whole number >= {least}, got {value!r}")
    return int(value)
