"""Surfaces that touch, as MuJoCo's shapes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np

from ves_gym._util.params import Array
from ves_gym.mechanics.contact import ContactShape

_STAVES = 24  # of a funnel
_KINDS = {
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "box": mujoco.mjtGeom.mjGEOM_BOX,
}


def solids(
    shape: ContactShape, place: Array, turn: Array
) -> Iterator[tuple[Any, Array, Array, Array]]:
    """Yield type, size (3,), place (3,) and axes (3, 3) of what a surface is drawn as, its body
    at a place (3,) and turn (3, 3)."""
    at, axes = place + turn @ np.array(shape.place.position), turn @ shape.place.rotation
    size = np.array(shape.size)
    if shape.form != "cone":
        size = size / 2 if shape.form == "box" else size * [1.0, 0.5][: len(size)]
        yield _KINDS[shape.form], np.r_[size, 0.0, 0.0][:3], at, axes
        return
    low, high, length = size
    wall = 0.06 * length
    for angle in np.linspace(0.0, 2 * np.pi, _STAVES, endpoint=False):
        out = np.array([np.cos(angle), np.sin(angle), 0.0])
        along = np.array([0.0, 0.0, length]) + (high - low) * out
        reach = float(np.linalg.norm(along))
        z, side = along / reach, np.cross([0.0, 0.0, 1.0], out)
        frame = np.stack([side, np.cross(z, side), z], axis=1)
        middle = axes @ ((low + high) / 2 * out)
        yield (
            _KINDS["capsule"], np.array([wall, reach / 2, 0.0]), at + middle, axes @ frame,
        )  # fmt: skip


def add_surface(body: Any, shape: ContactShape, place: Array, turn: Array, rgba: Any) -> None:
    """Add a surface, placed as in `solids`, to a body of a model that is only drawn."""
    quat = np.zeros(4)
    for kind, size, at, axes in solids(shape, place, turn):
        mujoco.mju_mat2Quat(quat, axes.flatten())
        body.add_geom(
            type=kind, size=size.tolist(), pos=at.tolist(), quat=quat.tolist(), rgba=rgba,
            mass=0.0, contype=0, conaffinity=0,
        )  # fmt: skip
