"""Arrays of a bundle: plain .npy of float64 or int16 in C order, read without NumPy's loader.

`numpy.load` makes room for whatever shape a header claims before it looks at the data; here
header and length must agree first. No pickle is ever read.
"""

from __future__ import annotations

import ast
import io
import math
import struct
from typing import Any

import numpy as np

from ves_gym._util.params import Array
from ves_gym.leaderboard.errors import BundleError, Code

_MAGIC = b"\x93NUMPY\x01\x00"
_LONGEST = 1024  # bytes of a header


def pack(values: Array) -> bytes:
    """An array as the bytes of a .npy file."""
    file = io.BytesIO()
    np.lib.format.write_array(
        file, np.ascontiguousarray(values, dtype="<f8"), version=(1, 0), allow_pickle=False
    )
    return file.getvalue()


def pack_levels(values: Array, levels: int) -> bytes:
    """Numbers that are multiples of 1/levels as the bytes of a .npy file of int16.

    Each column as a row of the steps from one number to the next: small numbers, and the same
    ones again and again, of which a .zip file makes little.

    Args:
        values: (n, k) in [-1, 1].
        levels: 8192 at most, so that a step from -1 to 1 has its place.
    """
    steps = np.diff(np.rint(values * levels), axis=0, prepend=0.0)
    file = io.BytesIO()
    np.lib.format.write_array(
        file, np.ascontiguousarray(steps.T, dtype="<i2"), version=(1, 0), allow_pickle=False
    )
    return file.getvalue()


def unpack_levels(data: bytes, name: str, width: int, levels: int) -> Array:
    """The numbers (n, width) of `pack_levels`, float64; they may be beyond +-1.

    Raises:
        BundleError: BAD_ACTION, it is no such array.
    """
    steps = _array(data, name, (width, None), "<i2")
    values: Array = np.cumsum(steps.astype(np.int64), axis=1).T / levels
    return np.ascontiguousarray(values)


def unpack(data: bytes, name: str, shape: tuple[int | None, ...]) -> Array:
    """The array of a .npy file.

    Args:
        shape: None where any length will do.

    Raises:
        BundleError: BAD_ACTION, it is no such array or not finite.
    """
    values: Array = _array(data, name, shape, "<f8").astype(np.float64)
    if not np.isfinite(values).all():
        raise _bad(f"{name} is not finite at {np.argwhere(~np.isfinite(values))[0].tolist()}")
    return values


def _array(data: bytes, name: str, shape: tuple[int | None, ...], kind: str) -> Any:
    stored_shape, body = _header(data, name, kind)
    good = len(stored_shape) == len(shape) and all(
        want is None or have == want for have, want in zip(stored_shape, shape, strict=True)
    )
    if not good:
        expected = tuple("any" if k is None else k for k in shape)
        raise _bad(f"{name} must have the shape {expected}, got {stored_shape}")
    if len(body) != np.dtype(kind).itemsize * math.prod(stored_shape):
        raise _bad(f"{name}: {len(body)} bytes are no array of shape {stored_shape}")
    return np.frombuffer(body, kind).reshape(stored_shape)


def _header(data: bytes, name: str, kind: str) -> tuple[tuple[int, ...], bytes]:
    if data[: len(_MAGIC)] != _MAGIC or len(data) < len(_MAGIC) + 2:
        raise _bad(f"{name} is no .npy file of version 1.0")
    start = len(_MAGIC) + 2
    size = struct.unpack("<H", data[start - 2 : start])[0]
    if size > _LONGEST or len(data) < start + size:
        raise _bad(f"{name}: a header of {size} bytes")
    try:
        header = ast.literal_eval(data[start : start + size].decode("latin-1").strip())
    except (ValueError, SyntaxError, MemoryError, RecursionError, TypeError):
        header = None
    expected = {"descr", "fortran_order", "shape"}
    if not isinstance(header, dict) or set(header) != expected:
        raise _bad(f"{name}: not the header of a .npy file")
    if header["descr"] != kind or header["fortran_order"] is not False:
        held = np.dtype(kind).name
        raise _bad(f"{name} must hold {held}, little endian, in C order")
    shape = header["shape"]
    integral = isinstance(shape, tuple) and all(
        isinstance(k, int) and not isinstance(k, bool) and 0 <= k < 2**40 for k in shape
    )
    if not integral:
        raise _bad(f"{name}: no shape: {str(shape)[:80]}")
    return shape, data[start + size :]


def _bad(why: str) -> BundleError:
    return BundleError(Code.BAD_ACTION, why)
