"""Meshes of a file, read by trimesh, and the smallest capsule that holds one."""

from __future__ import annotations

import io
from pathlib import Path
from typing import NamedTuple

import numpy as np
import trimesh

from ves_gym._util.params import Array, Index, ParameterError
from ves_gym._util.reading import named, read_bytes, read_xml
from ves_gym.mechanics.link import Capsule

_FORMATS = (".stl", ".obj", ".dae", ".ply")
_SWELL = (1.0, 1.05, 1.1, 1.2, 1.4)  # radii tried: a thicker capsule may be shorter
_ROUNDS = 60  # of the circle around a set of points
_STL = 84, 50  # bytes of a binary STL's head, and of a triangle


class Mesh(NamedTuple):
    """Triangles."""

    points: Array  # (k, 3) in the file's unit (Collada: m), its z up
    faces: Index  # (m, 3) rows of points; none of a cloud of points


def read_mesh(path: Path) -> Mesh:
    """Return all meshes of an STL, OBJ, Collada or PLY file as one."""
    kind = path.suffix.lower()
    if kind not in _FORMATS:
        raise ParameterError(f"mesh {path.name}: must be one of {', '.join(_FORMATS)}")
    with named(f"mesh {path.name}"):
        data = read_bytes(path)
        if kind == ".dae":
            read_xml(path)  # within its bounds
        if kind == ".stl" and len(data) >= _STL[0]:  # readers take what follows for a fault
            size = _STL[0] + _STL[1] * int.from_bytes(data[80:84], "little")
            data = data[:size] if _STL[0] < size <= len(data) else data
        try:
            with np.errstate(all="ignore"):
                scene = trimesh.load_scene(
                    io.BytesIO(data), file_type=kind[1:], process=False, skip_materials=True
                )
                if kind == ".dae":
                    scene = scene.convert_units("meters")
                mesh = _joined(scene)
        except Exception as error:  # what is damaged makes a decoder raise nearly anything
            raise ParameterError(f"cannot be read: {error}") from None
        if len(mesh.points) == 0 or not np.isfinite(mesh.points).all():
            raise ParameterError("has no points")
    return mesh


def _joined(scene: trimesh.Scene) -> Mesh:
    """All geometries of a scene, where it has them."""
    points, faces, first = [np.zeros((0, 3))], [np.zeros((0, 3), int)], 0
    for node in scene.graph.nodes_geometry:
        at, name = scene.graph[node]
        shape = scene.geometry[name]
        points.append(trimesh.transform_points(np.asarray(shape.vertices, float), at))
        faces.append(np.asarray(getattr(shape, "faces", faces[0])).reshape(-1, 3) + first)
        first += len(points[-1])
    return Mesh(np.concatenate(points), np.concatenate(faces))


def capsule_around(points: Array) -> Capsule:
    """Return the capsule that holds points (k, 3) [m]: the smallest of those along their main
    axes and along x, y and z."""
    points = _hull(points)
    main = np.linalg.eigh(np.cov(points.T))[1].T if len(points) > 1 else np.eye(3)
    best, ends = np.inf, (points[0], points[0], 0.0)
    for axis in (*np.eye(3), *main):
        across = np.linalg.svd(axis[None])[2][1:]
        flat, along = points @ across.T, points @ axis
        centre = _centre(flat)
        distance = np.linalg.norm(flat - centre, axis=1)
        for factor in _SWELL:
            radius = factor * max(float(distance.max()), 1e-6)
            cap = np.sqrt(np.maximum(radius**2 - distance**2, 0.0))
            low, high = float((along + cap).min()), float((along - cap).max())
            if low > high:
                low = high = (low + high) / 2
            volume = radius**2 * (high - low) + 4 / 3 * radius**3
            if volume < best * (1 - 1e-9):
                middle = centre @ across
                best, ends = volume, (middle + low * axis, middle + high * axis, radius)
    return Capsule.of(*ends)


def box_corners(half: Array) -> Array:
    """(8, 3) corners of a box about its centre, from half its edges (3,)."""
    signs = np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).reshape(3, -1).T
    return np.asarray(signs * half, float)


def _hull(points: Array) -> Array:
    """The points that span the others; all, where they lie in a plane."""
    from scipy.spatial import ConvexHull, QhullError

    if len(points) < 50:
        return points
    try:
        return np.asarray(points[ConvexHull(points).vertices], float)
    except QhullError:
        return points


def _centre(points: Array) -> Array:
    """(2,) centre of a small circle around points (k, 2) (Badoiu and Clarkson, SODA 2003)."""
    centre: Array = (points.min(axis=0) + points.max(axis=0)) / 2
    best, least = centre, np.inf
    for k in range(1, _ROUNDS):
        distance = np.linalg.norm(points - centre, axis=1)
        far = int(distance.argmax())
        if distance[far] < least:
            best, least = centre, distance[far]
        centre = centre + (points[far] - centre) / (k + 1)
    return best
