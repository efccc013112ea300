"""Points of a mesh file, and the smallest capsule that holds them."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
from scipy.spatial.transform import Rotation

from ves_gym._util.params import Array, ParameterError
from ves_gym._util.reading import named, read_bytes, read_xml

_FORMATS = (".stl", ".obj", ".dae", ".ply")
_SWELL = (1.0, 1.05, 1.1, 1.2, 1.4)  # radii tried: a thicker capsule may be shorter
_ROUNDS = 60  # of the circle around a set of points
_STL = np.dtype([("normal", "<f4", 3), ("points", "<f4", (3, 3)), ("color", "<u2")])


def mesh_points(path: Path) -> Array:
    """Return the corners of a mesh.

    Args:
        path: an STL, OBJ, Collada or PLY file.

    Returns:
        (k, 3) in the file's unit (Collada: m).

    Raises:
        ParameterError: another format, or nothing in it.
    """
    kind = path.suffix.lower()
    if kind not in _FORMATS:
        raise ParameterError(f"mesh {path.name}: must be one of {', '.join(_FORMATS)}")
    with named(f"mesh {path.name}"), np.errstate(all="ignore"):
        try:
            if kind == ".dae":
                points = _collada(read_xml(path))
            else:
                points = {".stl": _stl, ".obj": _obj, ".ply": _ply}[kind](read_bytes(path))
        except (ValueError, IndexError, OverflowError) as error:
            raise ParameterError(f"cannot be read: {error}") from None
        points = points.reshape(-1, 3)
        if len(points) == 0 or not np.isfinite(points).all():
            raise ParameterError("has no points")
    return np.unique(points, axis=0)


def capsule_around(points: Array) -> tuple[Array, Array, float]:
    """Return a capsule that holds points.

    The smallest of those along their main axes and along x, y and z.

    Args:
        points: (k, 3) [m].

    Returns:
        Both ends of its line (3,) [m] and its radius [m].
    """
    points = _hull(points)
    main = np.linalg.svd(points - points.mean(axis=0), full_matrices=True)[2]
    best, capsule = np.inf, None
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
                best, capsule = volume, (middle + low * axis, middle + high * axis, radius)
    assert capsule is not None  # points are finite
    return capsule


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


# scalars of a PLY file by NumPy's names, of its old words and its new ones
_PLY = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
_PLY |= {"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4"}
_PLY |= {"uint32": "u4", "float": "f4", "float32": "f4", "double": "f8", "float64": "f8"}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


def _ply(data: bytes) -> Array:
    """Vertices, the first element of a file (Turk, The PLY Polygon File Format, 1994)."""
    head, ended, body = data.partition(b"end_header")
    lines = [line.split() for line in head.decode("latin-1").splitlines()]
    elements = [k for k, words in enumerate(lines) if words[:1] == ["element"]]
    order = next((words[1] for words in lines if words[:1] == ["format"]), "")
    if not ended or order not in _ORDERS or not elements or lines[elements[0]][1] != "vertex":
        raise ValueError("a PLY file begins with its format and its vertices")
    last = elements[1] if len(elements) > 1 else len(lines)
    own = [words for words in lines[elements[0] + 1 : last] if words[:1] == ["property"]]
    names, kinds = [words[-1] for words in own], [words[1] for words in own]
    if not {"x", "y", "z"} <= set(names) or not set(kinds) <= _PLY.keys():
        raise ValueError(f"its vertices must have numbers x, y and z, got {', '.join(names)}")
    count, body = int(lines[elements[0]][2]), body.partition(b"\n")[2]
    if order == "ascii":
        values = np.array(body.split()[: count * len(names)], float).reshape(count, -1)
        return values[:, [names.index(k) for k in "xyz"]]
    row = np.dtype([(k, _ORDERS[order] + _PLY[t]) for k, t in zip(names, kinds, strict=True)])
    rows = np.frombuffer(body, row, count)
    return np.stack([rows[k].astype(float) for k in "xyz"], axis=1)


def _stl(data: bytes) -> Array:
    count = int.from_bytes(data[80:84], "little") if len(data) >= 84 else 0
    if len(data) >= 84 + _STL.itemsize * count and count:  # others read what follows, too
        return np.frombuffer(data, _STL, count, offset=84)["points"].astype(float)
    return _numbers(re.findall(rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)", data))


def _obj(data: bytes) -> Array:
    return _numbers(re.findall(rb"(?m)^v\s+(\S+)\s+(\S+)\s+(\S+)", data))


def _numbers(rows: list[tuple[bytes, ...]]) -> Array:
    return np.array([[float(k) for k in row] for row in rows], float)


def _collada(tree: Element) -> Array:
    """Points of all geometries of the scene, in m, the file's z up."""
    for element in tree.iter():
        element.tag = element.tag.rpartition(":")[2]
    unit = tree.find("./asset/unit")
    scale = float(unit.get("meter", "1")) if unit is not None else 1.0
    shapes = {k.get("id"): _collada_points(k) for k in tree.iter("geometry")}
    out: list[Array] = []

    def walk(node: Element, at: Array) -> None:
        for child in node:
            values = (
                [float(k) for k in (child.text or "").split()] if child.tag in _MOVES else []
            )
            if child.tag == "matrix":
                at = at @ np.array(values).reshape(4, 4)
            elif child.tag == "translate":
                at = at @ _moved(np.eye(3), np.array(values))
            elif child.tag == "scale":
                at = at @ _moved(np.diag(values), np.zeros(3))
            elif child.tag == "rotate":
                axis = np.array(values[:3]) / np.linalg.norm(values[:3])
                turn = Rotation.from_rotvec(values[3] * axis, degrees=True)
                at = at @ _moved(turn.as_matrix(), np.zeros(3))
        for child in node:
            if child.tag == "node":
                walk(child, at)
            elif child.tag == "instance_geometry":
                points = shapes.get((child.get("url") or "#")[1:], np.zeros((0, 3)))
                out.append(points @ at[:3, :3].T + at[:3, 3])

    for scene in tree.iter("visual_scene"):
        walk(scene, np.eye(4))
    points = np.concatenate(out or list(shapes.values()) or [np.zeros((0, 3))])
    return np.asarray(points * scale, float)


_MOVES = ("matrix", "translate", "scale", "rotate")


def _collada_points(geometry: Element) -> Array:
    """(k, 3) positions of one geometry."""
    mesh = geometry.find("mesh")
    if mesh is None:
        return np.zeros((0, 3))
    names = {
        (k.get("source") or "#")[1:]
        for k in mesh.iter("input")
        if k.get("semantic") == "POSITION"
    }
    rows = [
        np.array((array.text or "").split(), float).reshape(-1, 3)
        for source in mesh.iter("source")
        if source.get("id") in names
        for array in source.iter("float_array")
    ]
    return np.concatenate(rows) if rows else np.zeros((0, 3))


def _moved(R: Array, p: Array) -> Array:
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = R, p
    return out
