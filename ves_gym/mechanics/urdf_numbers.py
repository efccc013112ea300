"""Numbers, vectors and poses of a URDF's elements; what is wrong with one names its place."""

from __future__ import annotations

import math
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from ves_gym._util.params import Array, ParameterError


class Pose(NamedTuple):
    """A frame in another."""

    R: Array  # (3, 3)
    p: Array  # (3,) [m]

    def __matmul__(self, other: Pose) -> Pose:
        return Pose(self.R @ other.R, self.R @ other.p + self.p)


HERE = Pose(np.eye(3), np.zeros(3))


def about(axis: Array, angle: float) -> Array:
    """(3, 3) rotation about an axis (3,) of length 1."""
    x, y, z = axis
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0.0]])
    out: Array = np.eye(3) + math.sin(angle) * K + (1 - math.cos(angle)) * K @ K
    return out


def origin_of(origin: ElementTree.Element | None, where: str) -> Pose:
    """Return the pose that an <origin> gives; none: the parent's own frame.

    Args:
        origin: the element.
        where: what it belongs to, for the message.
    """
    if origin is None:
        return HERE
    p = vector(origin, "xyz", f"{where}: its origin", (0.0, 0.0, 0.0))
    roll, pitch, yaw = vector(origin, "rpy", f"{where}: its origin", (0.0, 0.0, 0.0))
    ez, ey, ex = np.eye(3)[::-1]
    return Pose(about(ez, yaw) @ about(ey, pitch) @ about(ex, roll), p)


def vector(
    element: ElementTree.Element | None,
    key: str,
    where: str,
    default: tuple[float, float, float] | None = None,
) -> Array:
    """Return three numbers of an element.

    Args:
        element, key, where, default: see `number`.

    Returns:
        (3,).

    Raises:
        ParameterError: missing without a default, or no three finite numbers.
    """
    text = None if element is None else element.get(key)
    if text is None:
        if default is None:
            raise ParameterError(f"{where} has no {key}")
        return np.array(default)
    try:
        values = np.array([float(k) for k in text.split()])
    except ValueError:
        values = np.array([])
    if values.shape != (3,) or not np.isfinite(values).all():
        raise ParameterError(f"{where}: {key} must be three numbers, got {text!r}")
    return values


def number(
    element: ElementTree.Element | None,
    key: str,
    where: str,
    default: float | None = None,
    least: float | None = None,
) -> float:
    """Return a number of an element.

    Args:
        element: that has it, or none.
        key: the attribute.
        where: what it belongs to, for the message.
        default: taken where the attribute is missing.
        least: the smallest that it may be.

    Raises:
        ParameterError: missing without a default, no finite number, or too small.
    """
    text = None if element is None else element.get(key)
    if text is None:
        if default is None:
            raise ParameterError(f"{where}: {key} is missing")
        return default
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or (least is not None and value < least):
        wanted = "a number" if least is None else f"a number >= {least:g}"
        raise ParameterError(f"{where}: {key} must be {wanted}, got {text!r}")
    return value
