"""Arms from URDF files.

A chain of revolute joints is taken out of the file's tree: fixed joints are merged, joints
off the chain stand still. Shapes become capsules that hold them.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym.mechanics.chain import (
    ENDLESS,
    ChainChoice,
    Joint,
    LinkMass,
    Lump,
    arm_of,
    given_rotors,
    require_body,
    require_plausible,
)
from ves_gym.mechanics.serial_chain import SerialChain
from ves_gym.mechanics.urdf_numbers import HERE, Pose, about, number, origin_of, vector
from ves_gym.mechanics.urdf_shapes import capsules_of

_TURNS = ("revolute", "continuous")
_DRIVEN = (*_TURNS, "prismatic")
_MOVES = (*_DRIVEN, "floating", "planar")


@dataclass
class _Joint:
    """A <joint>."""

    name: str
    kind: str
    parent: str
    child: str
    origin: Pose
    axis: Array
    limit: ElementTree.Element | None
    dynamics: ElementTree.Element | None
    mimic: ElementTree.Element | None


@dataclass
class _Tree:
    """A <robot>: its links and joints by name."""

    path: Path
    name: str
    links: dict[str, ElementTree.Element]
    joints: dict[str, _Joint]
    children: dict[str, list[_Joint]] = field(default_factory=dict)  # by parent link
    parent: dict[str, _Joint] = field(default_factory=dict)  # by child link


def read_urdf(path: str | os.PathLike[str], choice: ChainChoice) -> SerialChain:
    """Read an arm from a URDF file, see `Arm.from_urdf`.

    Args:
        path: the file.
        choice: the chain in it.

    Raises:
        ParameterError: names the link or the joint, and what is wrong with it.
    """
    path = Path(path)
    try:
        return _read(path, choice)
    except ParameterError as error:
        raise ParameterError(f"{path.name}: {error}") from None


def _read(path: Path, choice: ChainChoice) -> SerialChain:
    locked = choice.locked
    tree = _parsed(path)
    root = _root(tree, choice.root)
    tip = _tip(tree, root, choice.tip)
    chain = _chain(tree, root, tip)
    unknown = [name for name in locked if name not in tree.joints]
    if unknown:
        raise ParameterError(
            f"locked: no joint {unknown[0]!r}; there are {', '.join(tree.joints)}"
        )
    free = [j for j in chain if j.kind in _DRIVEN and j.name not in locked]
    for joint in chain:
        _require_usable(joint, locked)
    if not free:
        raise ParameterError(
            f"no revolute or prismatic joint lies between {root!r} and {tip!r}"
        )
    poses: dict[str, Pose] = {}
    bodies: dict[str, str | None] = {}  # link -> free joint that moves it
    still: list[str] = []
    _place(tree, root, HERE, None, {j.name for j in free}, locked, (poses, bodies, still))
    joints = {j.name: _joint(j, poses) for j in free}
    rotors = given_rotors(list(joints.values()), choice.rotors)
    lumps: dict[str | None, Lump] = {None: Lump()}
    lumps |= {name: joint.body for name, joint in joints.items()}
    tool = poses[tip]
    pieces = {link: _piece(tree, link, poses[link], bodies[link]) for link in bodies}
    if choice.check:
        moving = [k for link, k in pieces.items() if k is not None and bodies[link] is not None]
        require_plausible(list(joints.values()), tool.p, moving)
    for link, mover in bodies.items():
        piece = pieces[link]
        if piece is not None:
            lumps[mover].add(piece)
        if choice.collision:
            lumps[mover].capsules += capsules_of(tree.links[link], poses[link], path)
    notes = [f"read from {path.name}, {root} to {tip}"]
    if still:
        notes.append(f"joints that stand still: {', '.join(still)}")
    notes += rotors
    return arm_of(
        tree.name,
        lumps[None],
        list(joints.values()),
        (tool.R, tool.p),
        source="; ".join(notes),
        collision=choice.collision,
    )


# ---------------------------------------------------------------------------- the tree


def _parsed(path: Path) -> _Tree:
    try:
        robot = ElementTree.fromstring(path.read_bytes())
    except (OSError, ElementTree.ParseError) as error:
        raise ParameterError(f"cannot be read: {error}") from None
    if robot.tag != "robot":
        raise ParameterError(f"expected <robot> at the top of a URDF, got <{robot.tag}>")
    if any("xacro" in element.tag for element in robot.iter()):
        raise ParameterError("is a xacro, not yet a URDF: run `xacro` on it first")
    links = {_name(k, "link"): k for k in robot.findall("link")}
    joints: dict[str, _Joint] = {}
    for element in robot.findall("joint"):
        name = _name(element, "joint")
        if name in joints:
            raise ParameterError(f"joint {name!r} is there more than once")
        ends = []
        for role in ("parent", "child"):
            end = element.find(role)
            link = None if end is None else end.get("link")
            if link not in links:
                raise ParameterError(f"joint {name!r}: its {role} link {link!r} is not there")
            ends.append(str(link))
        where = f"joint {name!r}"
        axis = vector(element.find("axis"), "xyz", where, (1.0, 0.0, 0.0))
        kind = element.get("type", "")
        if kind not in ("fixed", *_MOVES):
            raise ParameterError(f"{where}: no such type of joint: {kind!r}")
        if kind in _DRIVEN:
            if not np.linalg.norm(axis) > 0:
                raise ParameterError(f"{where}: its axis must not be zero")
            axis = axis / np.linalg.norm(axis)
        joints[name] = _Joint(
            name,
            kind,
            ends[0],
            ends[1],
            origin_of(element.find("origin"), where),
            axis,
            element.find("limit"),
            element.find("dynamics"),
            element.find("mimic"),
        )
    tree = _Tree(path, robot.get("name") or path.stem, links, joints)
    for joint in joints.values():
        tree.children.setdefault(joint.parent, []).append(joint)
        if joint.child in tree.parent:
            raise ParameterError(f"link {joint.child!r} hangs on two joints")
        tree.parent[joint.child] = joint
    return tree


def _name(element: ElementTree.Element, what: str) -> str:
    name = element.get("name")
    if not name:
        raise ParameterError(f"a {what} has no name")
    return name


def _root(tree: _Tree, root: str | None) -> str:
    if root is not None:
        return _require_link(tree, root, "root")
    tops = [name for name in tree.links if name not in tree.parent]
    if len(tops) != 1:
        raise ParameterError(f"must have one root link, got {', '.join(tops) or 'none'}")
    return tops[0]


def _require_link(tree: _Tree, link: str, what: str) -> str:
    if link not in tree.links:
        raise ParameterError(f"{what}: no link {link!r}; there are {', '.join(tree.links)}")
    return link


def _tip(tree: _Tree, root: str, tip: str | None) -> str:
    """The tool's link: the one asked for, or the only end that a joint moves."""
    if tip is not None:
        return _require_link(tree, tip, "tip")
    ends = []
    stack = [(root, False)]
    while stack:
        link, moves = stack.pop()
        below = tree.children.get(link, [])
        if not below and moves:
            ends.append(link)
        stack += [(j.child, moves or j.kind in _MOVES) for j in reversed(below)]
    if len(ends) == 1:
        return ends[0]
    if not ends:
        raise ParameterError(f"no joint moves beyond {root!r}")
    raise ParameterError(
        f"has {len(ends)} ends: {', '.join(ends)}; name the link that is the tool"
        f" (tip={ends[0]!r}, or {tree.path.name}#{ends[0]})"
    )


def _chain(tree: _Tree, root: str, tip: str) -> list[_Joint]:
    chain: list[_Joint] = []
    link = tip
    while link != root:
        if link not in tree.parent or len(chain) > len(tree.joints):
            raise ParameterError(f"no chain leads from {root!r} to {tip!r}")
        chain.append(tree.parent[link])
        link = chain[-1].parent
    return chain[::-1]


def _require_usable(joint: _Joint, locked: Mapping[str, float]) -> None:
    """Refuse what an Arm cannot have between its root and its tip."""
    if joint.name in locked and joint.kind in _DRIVEN:
        return
    if joint.kind not in ("fixed", *_DRIVEN):
        raise ParameterError(
            f"joint {joint.name!r} to link {joint.child!r} is {joint.kind}: an arm has revolute"
            " and prismatic joints, a root below it leaves it out (root=LINK)"
        )
    if joint.mimic is not None and joint.kind != "fixed":
        raise ParameterError(
            f"joint {joint.name!r} to link {joint.child!r} mimics {joint.mimic.get('joint')!r}:"
            f" an arm has joints of their own; locked={{{joint.name!r}: 0.0}} holds it"
        )


def _place(
    tree: _Tree,
    link: str,
    pose: Pose,
    mover: str | None,
    free: set[str],
    locked: Mapping[str, float],
    out: tuple[dict[str, Pose], dict[str, str | None], list[str]],
) -> None:
    """Place a link and all beyond it, at zero of the free joints.

    Args:
        tree: links and joints.
        link: where to begin.
        pose: of it in the root.
        mover: free joint that moves it.
        free: names of the free joints.
        locked: angles of those that stand still.
        out: poses and movers of the links, names of joints that stand still; written.
    """
    poses, movers, still = out
    poses[link], movers[link] = pose, mover
    for joint in tree.children.get(link, []):
        at = pose @ joint.origin
        if joint.name not in free and joint.kind != "fixed":
            if joint.kind in ("floating", "planar"):
                raise ParameterError(
                    f"joint {joint.name!r} to link {joint.child!r} is {joint.kind}: it says not"
                    " where that link is; an arm has revolute and fixed joints"
                )
            value = _position(tree, joint, locked)
            still.append(f"{joint.name} at {value:g}")
            at = at @ (
                Pose(np.eye(3), value * joint.axis)
                if joint.kind == "prismatic"
                else Pose(about(joint.axis, value), np.zeros(3))
            )
        _place(
            tree,
            joint.child,
            at,
            joint.name if joint.name in free else mover,
            free,
            locked,
            out,
        )


def _position(tree: _Tree, joint: _Joint, locked: Mapping[str, float], depth: int = 0) -> float:
    """Position at which a joint stands still: the one asked for, its leader's, or zero."""
    if joint.name in locked:
        return float(locked[joint.name])
    if joint.mimic is None or depth > len(tree.joints):
        return 0.0
    where = f"joint {joint.name!r}"
    leader = tree.joints.get(joint.mimic.get("joint", ""))
    if leader is None:
        raise ParameterError(f"{where} mimics {joint.mimic.get('joint')!r}, which is not there")
    factor = number(joint.mimic, "multiplier", where, 1.0)
    return factor * _position(tree, leader, locked, depth + 1) + number(
        joint.mimic, "offset", where, 0.0
    )


def _joint(joint: _Joint, poses: Mapping[str, Pose]) -> Joint:
    """A free joint at zero, with its limits; without what it moves."""
    where, at = f"joint {joint.name!r}", poses[joint.child]
    limit, dynamics = (
        ElementTree.Element("none") if k is None else k for k in (joint.limit, joint.dynamics)
    )
    low, high = -ENDLESS, ENDLESS
    if joint.kind in ("revolute", "prismatic"):
        if limit.get("lower") is None and limit.get("upper") is None:
            raise ParameterError(f"{where} is {joint.kind} and has no <limit lower= upper=>")
        low, high = (number(limit, key, where, 0.0) for key in ("lower", "upper"))
    return Joint(
        name=joint.name,
        origin=at.p,
        axis=at.R @ joint.axis,
        q_min=low,
        q_max=high,
        body=Lump(),
        rotor_inertia=number(dynamics, "armature", where, 0.0, least=0.0),
        v_max=number(limit, "velocity", where, 0.0, least=0.0),
        a_max=number(limit, "acceleration", where, 0.0, least=0.0),
        tau_max=number(limit, "effort", where, 0.0, least=0.0),
        damping=number(dynamics, "damping", where, 0.0, least=0.0),
        friction=number(dynamics, "friction", where, 0.0, least=0.0),
        slides=joint.kind == "prismatic",
    )


# ------------------------------------------------------------------ masses and shapes


def _piece(tree: _Tree, name: str, pose: Pose, mover: str | None) -> LinkMass | None:
    """A link's mass properties; None of a frame."""
    link, where = tree.links[name], f"link {name!r}"
    inertial = link.find("inertial")
    if inertial is None:
        if mover is not None and any(link.find(k) is not None for k in ("collision", "visual")):
            raise ParameterError(f"{where} has a shape, but no <inertial>: its mass is unknown")
        return None
    moments = inertial.find("inertia")
    ixx, ixy, ixz, iyy, iyz, izz = (
        number(moments, key, f"{where}: its inertia")
        for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    )
    I = np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
    at = pose @ origin_of(inertial.find("origin"), where)
    mass = number(inertial.find("mass"), "value", f"{where}: its mass", least=0.0)
    require_body(LinkMass(name, mass, at.p, I))
    return LinkMass(name, mass, at.p, at.R @ I @ at.R.T)
