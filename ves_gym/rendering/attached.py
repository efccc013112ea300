"""Parts drawn in addition to arm and base: a satellite's appendages, surfaces of a contact."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from ves_gym._util.params import Array
from ves_gym.engine.mjcf import LEAST
from ves_gym.engine.mjcf_carried import add_carried
from ves_gym.engine.mjcf_contact import add_shape, geom_of, tool_in_link
from ves_gym.mechanics.arm import Inertial
from ves_gym.mechanics.vehicle import Appendage, BaseModel
from ves_gym.system.system import System

_PANEL = (0.20, 0.30, 0.62, 1.0)
_SURFACE = (0.98, 0.86, 0.30, 0.45)


def equal_box(body: Inertial) -> tuple[Array, Array]:
    """Return half sizes (3,) [m] and axes (3, 3) of the box with a body's inertia."""
    moments, axes = np.linalg.eigh(np.array(body.inertia))
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1
    squares = 6 / max(body.mass, 1e-9) * (moments.sum() - 2 * moments)
    return np.sqrt(np.maximum(squares, 1e-4)) / 2, axes


def add_appendages(spec: Any, base: BaseModel) -> None:
    """Add a box on its hinge or slide for each appendage; wheels are inside the satellite.

    Args:
        spec: MuJoCo's, with the satellite; gets the joints of wheels, too.
        base: with what it carries.
    """
    add_carried(spec, base)
    for i, part in enumerate(base.carried, start=1):
        if isinstance(part, Appendage):
            half, axes = equal_box(part.body)
            quat = np.zeros(4)
            mujoco.mju_mat2Quat(quat, np.ascontiguousarray(axes).ravel())
            spec.body(f"carried_{i}").add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX,
                size=half.tolist(),
                pos=list(part.body.com),
                quat=quat.tolist(),
                rgba=_PANEL,
                contype=0,
                conaffinity=0,
                mass=0,
            )


def appendage_corners(base: BaseModel) -> Array:
    """Return the corners (k, 3) of the appendages at rest, in platform axes [m]."""
    signs = np.array(np.meshgrid(*([-1, 1],) * 3)).reshape(3, -1).T
    out = [np.zeros((0, 3))]
    for part in base.carried:
        if isinstance(part, Appendage) and part.body.mass > LEAST:
            half, axes = equal_box(part.body)
            out.append(np.array(part.body.com) + (signs * half) @ axes.T)
    return np.vstack(out)


def add_surfaces(spec: Any, system: System) -> None:
    """Add the surfaces of the tool, and those on the base or in space, half transparent.

    Args:
        spec: MuJoCo's, with the arm.
        system: whose contact it is.
    """
    contact = system.contact
    if contact is None:
        return
    place, turn = tool_in_link(system.arm)
    for shape in contact.tool:
        add_shape(spec.body(f"link_{system.arm.n}"), shape, place, turn, rgba=_SURFACE)
    if contact.on != "payload":
        body = spec.body("platform") if contact.on == "base" else spec.worldbody
        for shape in contact.target:
            add_shape(body, shape, np.zeros(3), np.eye(3), rgba=_SURFACE)


def add_payload_shapes(scene: Any, system: System, pose: Array, turn: Array, rgba: Any) -> bool:
    """Add the payload as the surfaces that the tool meets; False where it has none.

    Args:
        scene: MuJoCo's, of this frame.
        system: whose payload it is.
        pose: (7,) of the payload.
        turn: (3, 3) its axes in space.
        rgba: its colour.
    """
    contact = system.contact
    if contact is None or contact.on != "payload":
        return False
    for shape in contact.target:
        form, size = geom_of(shape)
        at = pose[:3] + turn @ np.array(shape.place.position)
        axes = np.ascontiguousarray(turn @ shape.place.rotation).ravel()
        geom, colour = scene.geoms[scene.ngeom], np.array(rgba, np.float32)
        mujoco.mjv_initGeom(geom, form, size, at, axes, colour)
        scene.ngeom += 1
    return True
