"""URDF files as trees: links, joints, masses and shapes of the XML."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import unquote
from xml.etree.ElementTree import Element

import numpy as np
from scipy.spatial.transform import Rotation

from ves_gym._util.params import Array, ParameterError
from ves_gym._util.reading import read_xml
from ves_gym.mechanics.arm_tree import Tie, Tree, TreeJoint, held
from ves_gym.mechanics.chain import ENDLESS, Joint, LinkMass, Lump
from ves_gym.mechanics.link import Capsule, MeshFile
from ves_gym.mechanics.meshes import box_corners, capsule_around, read_mesh

_DRIVEN = ("revolute", "continuous", "prismatic")
_KINDS = ("fixed", *_DRIVEN, "floating", "planar")
_MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_NONE = Element("none")
_NO_SHAPES = "--no-collision, in Python collision=False, leaves shapes out"


class Pose(NamedTuple):
    """A frame in another."""

    R: Array  # (3, 3)
    p: Array  # (3,) [m]

    def __matmul__(self, other: Pose) -> Pose:
        return Pose(self.R @ other.R, self.R @ other.p + self.p)


class UrdfTree(Tree):
    """A <robot>."""

    noun, tip_nouns, moving = "link", "link", "revolute or prismatic"

    def __init__(self, path: Path, outside: bool = False) -> None:
        """`outside`: read meshes that lie outside the file's folder and package."""
        self.outside, robot = outside, read_xml(path)
        if any("xacro" in k.tag or "${" in "".join(k.attrib.values()) for k in robot.iter()):
            raise ParameterError("is a xacro, not yet a URDF: run `xacro` on it first")
        self.path, self.name = path, robot.get("name") or path.stem
        self.links = {_name(k, "link"): k for k in robot.findall("link")}
        self.bodies = list(self.links)
        self.parents, self.joints = {}, {}
        self.elements: dict[str, Element] = {}  # of the joints
        self.axes: dict[str, Array] = {}
        self.poses: dict[str, Pose] = {}  # of the links
        self.ties = []
        for element in robot.findall("joint"):
            self._add(element)
        self.rotors = dict(_rotor(k) for k in robot.findall("transmission"))

    def _add(self, element: Element) -> None:
        """Take a <joint> over."""
        name = _name(element, "joint")
        if name in self.elements:
            raise ParameterError(f"joint {name!r} is there more than once")
        where, ends = f"joint {name!r}", []
        for role in ("parent", "child"):
            link = _child(element, role).get("link")
            if link not in self.links:
                raise ParameterError(f"{where}: its {role} link {link!r} is not there")
            ends.append(str(link))
        parent, child = ends
        if child in self.parents:
            raise ParameterError(f"link {child!r} hangs on two joints")
        kind, mimic = element.get("type", ""), element.find("mimic")
        if kind not in _KINDS:
            raise ParameterError(f"{where}: no such type of joint: {kind!r}")
        axis = vector(element.find("axis"), "xyz", where, (1.0, 0.0, 0.0))
        length, fault = np.linalg.norm(axis), None
        if kind in _DRIVEN and not length > 0:
            raise ParameterError(f"{where}: its axis must not be zero")
        if kind not in ("fixed", *_DRIVEN):
            fault = (
                f"{where} to link {child!r} is {kind}: an arm has revolute and prismatic"
                f" joints, a root below it leaves it out (--root {child}, in Python"
                f" root={child!r})"
            )
        elif mimic is not None and kind != "fixed":
            leader, what = mimic.get("joint", ""), f"{where}: its <mimic>"
            ratio, shift = (
                number(mimic, k, what, v) for k, v in (("multiplier", 1.0), ("offset", 0.0))
            )
            self.ties.append(Tie(f"{where} mimics {leader!r}", name, {leader: ratio}, shift))
        self.parents[child] = parent
        slides = kind == "prismatic"
        self.joints[child] = [TreeJoint(name, child, kind == "fixed", fault, slides)]
        self.elements[name], self.axes[name] = element, axis / (length or 1.0)

    def place(self, root: str, at: Mapping[str, float]) -> None:
        """Place all links beyond the root."""
        self.poses = {root: Pose(np.eye(3), np.zeros(3))}
        for link in self.movers(root, set()):
            if link == root:
                continue
            (joint,) = self.joints[link]
            element, axis = self.elements[joint.name], self.axes[joint.name]
            kind = element.get("type")
            pose = self.poses[self.parents[link]] @ _origin(element, f"joint {joint.name!r}")
            if not joint.fixed and (joint.fault or at[joint.name]):
                if kind in ("floating", "planar"):
                    raise ParameterError(
                        f"joint {joint.name!r} to link {link!r} is {kind}: it says not where"
                        " that link is; an arm has revolute and fixed joints"
                    )
                value = at[joint.name]
                slides = kind == "prismatic"
                turn = np.zeros(3) if slides else value * axis
                way = value * axis if slides else np.zeros(3)
                pose = pose @ Pose(Rotation.from_rotvec(turn).as_matrix(), way)
            self.poses[link] = pose

    def moving_joints(self, joints: list[TreeJoint]) -> list[Joint]:
        """Return joints with their limits; a follower has no motor."""
        return [self._joint(joint) for joint in joints]

    def _joint(self, joint: TreeJoint) -> Joint:
        where, at, element = (
            f"joint {joint.name!r}",
            self.poses[joint.body],
            self.elements[joint.name],
        )
        kind, limit, dynamics = (
            element.get("type"),
            _child(element, "limit"),
            _child(element, "dynamics"),
        )
        low, high = self._range(element, where)
        names = {"v_max": "velocity", "a_max": "acceleration", "tau_max": "effort"}
        limits: dict[str, Any] = {
            k: number(limit, v, where, 0.0, 0.0, inf=True) for k, v in names.items()
        }
        limits = {k: v if math.isfinite(v) else 0.0 for k, v in limits.items()}
        names = {"damping": "damping", "friction": "friction"}
        losses: dict[str, Any] = {
            k: number(dynamics, v, where, 0.0, least=0.0) for k, v in names.items()
        }
        rotor = self.rotors.get(joint.name, 0.0)
        return Joint(
            name=joint.name,
            origin=at.p,
            axis=at.R @ self.axes[joint.name],
            q_min=low,
            q_max=high,
            body=Lump(),
            slides=kind == "prismatic",
            rotor_inertia=number(dynamics, "armature", where, rotor, least=0.0),
            **limits,
            **losses,
        )

    def _range(self, element: Element, where: str) -> tuple[float, float]:
        """Return the range of a joint; 2 pi either way where one that turns states none."""
        kind, limit = element.get("type"), _child(element, "limit")
        turns = kind != "prismatic"
        if kind == "continuous" or (turns and limit.get("lower") is limit.get("upper") is None):
            return -ENDLESS, ENDLESS
        remedy = held(element.get("name", ""))
        if limit.get("lower") is limit.get("upper") is None:
            raise ParameterError(
                f"{where} is prismatic and has no <limit lower= upper=>: hold it ({remedy})"
            )
        low, high = (number(limit, k, where, 0.0, inf=True) for k in ("lower", "upper"))
        for end in ("lower", "upper"):
            if limit.get(end) is None and not low == high == 0:
                name = element.get("name")
                self.repairs.append(f"no {end} limit of {name}, 0 taken, as URDF says")
        if turns:
            low, high = (float(np.clip(k, -ENDLESS, ENDLESS)) if math.isinf(k) else k
                         for k in (low, high))  # fmt: skip
        elif math.isinf(low) or math.isinf(high):
            raise ParameterError(f"{where} slides without end: hold it ({remedy})")
        if turns and low == high == 0:
            if not self.repair:
                raise ParameterError(
                    f"{where} has a range of 0 to 0: --repair, in Python repair=True, takes"
                    f" 2 pi either way, or hold it ({remedy})"
                )
            name = element.get("name")
            self.repairs.append(f"range of {name} 0 to 0 taken as 2 pi either way")
            return -ENDLESS, ENDLESS
        return low, high

    def tool(self, body: str, name: str) -> tuple[Array, Array]:
        """Return the frame of the link that is the tool."""
        return self.poses[body]

    def mass(self, body: str, moves: bool) -> LinkMass | None:
        """Return a link's mass properties; None of a frame."""
        link, where = self.links[body], f"link {body!r}"
        inertial = link.find("inertial")
        if inertial is None:
            if moves and any(link.find(k) is not None for k in ("collision", "visual")):
                self.unweighed.append(body)
            return None
        moments = inertial.find("inertia")
        if moments is None and self.repair:
            self.repairs.append(f"no <inertia> of {body}: all of its mass is at its centre")
            moments = Element("inertia", dict.fromkeys(_MOMENTS, "0"))
        if moments is None:
            raise ParameterError(
                f"{where} has a mass, but no <inertia>: --repair, in Python repair=True, takes"
                " all of it at its centre"
            )
        ixx, ixy, ixz, iyy, iyz, izz = (
            number(moments, key, f"{where}: its inertia") for key in _MOMENTS
        )
        matrix = np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
        at = self.poses[body] @ _origin(inertial, where)
        mass = number(inertial.find("mass"), "value", f"{where}: its mass", least=0.0)
        return LinkMass(body, mass, at.p, at.R @ matrix @ at.R.T)

    def capsules(self, body: str) -> list[Capsule]:
        """Return the shapes of a link, but not the ends of a capsule written as three."""
        shapes, pose = self.links[body].findall("collision"), self.poses[body]
        names, out = {shape.get("name") for shape in shapes}, []
        for shape in shapes:
            name = shape.get("name") or ""
            stem = name.removesuffix("_start").removesuffix("_end")
            if stem == name or stem not in names:
                capsule = _capsule(self.path, shape, f"link {body!r}", self.outside)
                if capsule is None:
                    self.repairs.append(f"a shape without a size left out: {body}")
                else:
                    out.append(capsule.placed(*pose))
        return out

    def meshes(self, body: str) -> list[MeshFile]:
        """Return the meshes that a link is drawn with, but not those that are not there."""
        out = []
        for shape in self.links[body].findall("visual"):
            where, mesh = f"link {body!r}", _child(shape, "geometry").find("mesh")
            if mesh is None:
                continue
            scale = vector(mesh, "scale", f"{where}: a mesh", (1.0, 1.0, 1.0))
            try:
                name = mesh.get("filename") or ""
                file = _mesh_file(self.path, name, where, self.outside)
            except ParameterError:
                self.repairs.append(f"drawn without its mesh, which is not there: {body}")
                continue
            at = self.poses[body] @ _origin(shape, where)
            out.append(MeshFile(file=str(file), scale=tuple(scale.tolist())).placed(*at))
        return out


def _capsule(path: Path, shape: Element, where: str, outside: bool) -> Capsule | None:
    """A capsule that holds a <collision>, in its link's frame; None of one without a size."""
    at = _origin(shape, where)
    kind = next(iter(_child(shape, "geometry")), None)
    if kind is None:
        raise ParameterError(f"{where}: a <collision> without a shape")
    tag = kind.tag
    if tag == "sphere":
        radius, half = number(kind, "radius", f"{where}: a sphere", least=0.0), np.zeros(3)
    elif tag in ("cylinder", "capsule"):
        half = number(kind, "length", f"{where}: a {tag}") / 2 * at.R[:, 2]
        radius = number(kind, "radius", f"{where}: a {tag}", least=0.0)
    elif tag == "box":
        points = box_corners(vector(kind, "size", f"{where}: a box") / 2)
    elif tag == "mesh":
        file = _mesh_file(path, kind.get("filename") or "", where, outside)
        try:
            points = np.unique(read_mesh(file).points, axis=0)
        except ParameterError as error:
            raise ParameterError(f"{where}: {error} ({_NO_SHAPES})") from None
        points = points * vector(kind, "scale", f"{where}: a mesh", (1.0, 1.0, 1.0))
    else:
        raise ParameterError(f"{where}: no such shape: <{tag}>")
    if tag in ("box", "mesh"):
        return capsule_around(points @ at.R.T + at.p)
    return Capsule.of(at.p - half, at.p + half, radius) if radius else None


def _mesh_file(path: Path, name: str, where: str, outside: bool) -> Path:
    """Return the file of a mesh: below the URDF's folder, or beside that as in ../meshes, or in
    its package, which package:// names and ROS's paths lead to; elsewhere only if `outside`."""
    folder = path.resolve().parent
    around = (folder, *folder.parents)
    tried: list[tuple[Path, str]] = []  # folder that it must be in, and where in it
    if name.startswith("package://"):
        package, _, inner = name.removeprefix("package://").partition("/")
        for place in around:
            tried += [(place, inner)] if place.name == package else []
            tried.append((place / package, inner))
        for variable, inside in (("ROS_PACKAGE_PATH", ""), ("AMENT_PREFIX_PATH", "share")):
            for entry in filter(None, os.environ.get(variable, "").split(os.pathsep)):
                tried.append((Path(entry) / inside / package, inner))
        tried += [(place, inner) for place in around]
    else:
        near = folder if os.path.isabs(name) or "://" in name else folder.parent
        root = next((k for k in around if (k / "package.xml").is_file()), near)
        inner = name.removeprefix("file://").replace("\\", "/")
        spaced = unquote(inner) if name.startswith("file://") else inner
        tried += [(root, os.path.relpath(folder / k, root)) for k in (inner, spaced)]
    for root, inner in tried:
        file = (root / inner).resolve()
        if not file.is_file():
            continue
        if outside or file.is_relative_to(root.resolve()):
            return file
        raise ParameterError(
            f"{where}: its mesh {name!r} lies outside {root} (--allow-outside, in Python"
            f" allow_outside=True, reads it; {_NO_SHAPES})"
        )
    raise ParameterError(f"{where}: its mesh {name!r} is not there ({_NO_SHAPES})")


# -------------------------------------------------------------------- elements and numbers


def _name(element: Element, what: str) -> str:
    name = element.get("name")
    if not name:
        raise ParameterError(f"a {what} has no name")
    return name


def _rotor(transmission: Element) -> tuple[str, float]:
    """Joint of a <transmission>, and what Drake's words say of its rotor [kg m^2, kg]."""
    joint, motor = _child(transmission, "joint").get("name", ""), transmission.find("actuator")
    if motor is None:
        return joint, 0.0
    words = {k.tag: k for k in motor}  # `find` would ask for the prefix's namespace
    ratio, inertia = (
        number(words.get(f"drake:{tag}"), "value", f"the drive of {joint!r}", default)
        for tag, default in (("gear_ratio", 1.0), ("rotor_inertia", 0.0))
    )
    return joint, ratio**2 * inertia


def _child(element: Element, tag: str) -> Element:
    """The element of a tag, or an empty one."""
    child = element.find(tag)
    return _NONE if child is None else child


def _origin(element: Element, where: str) -> Pose:
    """The pose that an <origin> gives; without one the parent's own frame."""
    origin = element.find("origin")
    p = vector(origin, "xyz", f"{where}: its origin", (0.0, 0.0, 0.0))
    angles = vector(origin, "rpy", f"{where}: its origin", (0.0, 0.0, 0.0))
    return Pose(Rotation.from_euler("xyz", angles).as_matrix(), p)


def vector(
    element: Element | None,
    key: str,
    where: str,
    default: tuple[float, float, float] | None = None,
) -> Array:
    """Return three numbers (3,) of an element; see `number`."""
    text = None if element is None else element.get(key)
    if text is None:
        if default is None:
            raise ParameterError(f"{where} has no {key}")
        return np.array(default)
    try:
        # commas between all three; one alone may be a decimal comma
        plain = text.replace(",", " ") if text.count(",") == 2 else text
        values = np.array([float(k) for k in plain.split()])
    except ValueError:
        values = np.array([])
    if values.shape != (3,) or not np.isfinite(values).all():
        raise ParameterError(f"{where}: {key} must be three numbers, got {text!r}")
    return values


def number(
    element: Element | None,
    key: str,
    where: str,
    default: float | None = None,
    least: float | None = None,
    inf: bool = False,
) -> float:
    """Return the finite number of an element's attribute, or `inf`; where it is missing, the
    default.

    Refused, with `where` before the message: missing without a default, no number, less than
    `least`.
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
    bad = math.isnan(value) or (math.isinf(value) and not inf)
    if bad or (least is not None and value < least):
        kind = "a number" if least is None else f"a number >= {least:g}"
        raise ParameterError(f"{where}: {key} must be {kind}, got {text!r}")
    return value
