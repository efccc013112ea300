"""Shapes of a URDF's links as capsules that hold them."""

from __future__ import annotations

import os
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym.mechanics.meshes import capsule_around, mesh_points
from ves_gym.mechanics.urdf_numbers import Pose, number, origin_of, vector


def capsules_of(
    link: ElementTree.Element, pose: Pose, file: Path
) -> list[tuple[Array, Array, float]]:
    """Return a link's shapes as capsules that hold them.

    Args:
        link: a <link>.
        pose: of it in the frame of the capsules.
        file: the URDF.

    Returns:
        Both ends (3,) [m] and the radius [m] of each.

    Raises:
        ParameterError: names the link.
    """
    shapes = link.findall("collision")
    names = {shape.get("name") for shape in shapes}
    out = []
    for shape in shapes:
        if not _cap_of(shape.get("name"), names):
            a, b, radius = _capsule(file, shape, f"link {link.get('name')!r}")
            out.append((pose.R @ a + pose.p, pose.R @ b + pose.p, radius))
    return out


def _cap_of(name: str | None, names: set[str | None]) -> bool:
    """True if a shape is an end of a capsule that is written as a cylinder and two balls."""
    stem = (name or "").removesuffix("_start").removesuffix("_end")
    return stem != (name or "") and stem in names


def _capsule(path: Path, shape: ElementTree.Element, where: str) -> tuple[Array, Array, float]:
    """A capsule that holds a <collision>, in its link's frame."""
    at = origin_of(shape.find("origin"), where)
    geometry = shape.find("geometry")
    kind = next(iter(geometry), None) if geometry is not None else None
    if kind is None:
        raise ParameterError(f"{where}: a <collision> without a shape")
    tag = kind.tag
    if tag == "sphere":
        return at.p, at.p, number(kind, "radius", f"{where}: a sphere")
    if tag in ("cylinder", "capsule"):
        half = number(kind, "length", f"{where}: a {tag}") / 2 * at.R[:, 2]
        return at.p - half, at.p + half, number(kind, "radius", f"{where}: a {tag}")
    if tag == "box":
        size = vector(kind, "size", f"{where}: a box")
        points = np.array(np.meshgrid(*[[-0.5, 0.5]] * 3)).reshape(3, -1).T * size
    elif tag == "mesh":
        file = _mesh_file(path, kind.get("filename") or "", where)
        try:
            points = mesh_points(file)
        except ParameterError as error:
            raise ParameterError(
                f"{where}: {error} (collision=False leaves shapes out)"
            ) from None
        points = points * vector(kind, "scale", f"{where}: a mesh", (1.0, 1.0, 1.0))
    else:
        raise ParameterError(f"{where}: no such shape: <{tag}>")
    return capsule_around(points @ at.R.T + at.p)


def _mesh_file(path: Path, name: str, where: str) -> Path:
    """Return the file of a mesh; package:// is looked for around the URDF and on the paths
    that ROS goes by."""
    tried: list[Path] = []
    folder = path.resolve().parent
    if name.startswith("package://"):
        package, _, inner = name.removeprefix("package://").partition("/")
        for place in (folder, *folder.parents):
            tried += [place / inner] if place.name == package else []
            tried.append(place / package / inner)
        for variable, inside in (("ROS_PACKAGE_PATH", ""), ("AMENT_PREFIX_PATH", "share")):
            for entry in filter(None, os.environ.get(variable, "").split(os.pathsep)):
                tried.append(Path(entry) / inside / package / inner)
        tried += [place / inner for place in (folder, *folder.parents)]
    else:
        tried.append(folder / name.removeprefix("file://"))
    for file in tried:
        if file.is_file():
            return file
    raise ParameterError(
        f"{where}: its mesh {name!r} is not there (collision=False leaves shapes out)"
    )
