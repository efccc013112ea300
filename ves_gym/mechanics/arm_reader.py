"""One reader of arms from files: of a tree of bodies and joints a chain becomes an arm.

A file format is a `Tree` (`urdf.UrdfTree`, `mjcf_arm.MjcfTree`); which joints move, which
bodies move as one, and what is refused is decided here. What is written is in `arm_files`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.chain import (
    ENDLESS,
    Joint,
    LinkMass,
    Lump,
    PlacedMesh,
    Segment,
    arm_of,
)
from ves_gym.mechanics.link import BANDWIDTH, Inertial, rigid_moments
from ves_gym.mechanics.side_by_side import side_by_side

# Numbers beyond these look like mm, g and kg mm^2 (this project).
_REACH = 100.0  # m
_DENSITY = 1e4  # kg/m^3: moving mass over the cube of the reach; a PUMA has 60
_ROUND = 1e-12  # determinant of followers that follow each other, below which they are a ring
_NOTHING = Inertial(mass=0.0, com=(0.0,) * 3, inertia=((0.0,) * 3,) * 3)
_GYRATION = 10.0  # radius of gyration over the reach
_SHAPE = 30.0  # of the arm's size; a gripper on its base link has less


class ChainChoice(NamedTuple):
    """The chain of a file that is taken, and how it is read; see `Arm.from_file`."""

    tip: str | Sequence[str] | None
    root: str | None
    locked: dict[str, float]  # name -> angle [rad]
    collision: bool
    check: bool
    rotors: dict[str, float]  # name -> inertia about the joint [kg m^2], where not the file's
    allow_outside: bool = False  # meshes of a URDF may lie anywhere
    massless: tuple[str, ...] = ()  # bodies that are taken to weigh nothing
    repair: bool = False  # take the nearest of what no rigid body or joint has
    degrees: bool = False  # `locked` is in degrees, of joints that turn


@dataclass
class TreeJoint:
    """A joint between a body and the one before it."""

    name: str
    body: str  # that it moves
    fixed: bool = False
    fault: str | None = None  # why no arm has it between root and tip
    slides: bool = False


class Tie(NamedTuple):
    """Joints that a file couples: follower = shift + the others times their ratios."""

    what: str  # of a sentence, like "joint 'a' mimics 'b'"
    follower: str
    ratios: dict[str, float]  # by joint
    shift: float = 0.0
    # no such sum: factors of the second power on of a sum from rest, and that sum's parts;
    # NaN of what is no sum at all
    bend: tuple[tuple[float, ...], dict[str, float]] | None = None


class Coupled(NamedTuple):
    """The moving joints of a chain and beside it, and where all others stand."""

    free: list[TreeJoint]  # from base to tool, each a coordinate
    moving: dict[str, Array]  # all that move: (n,) of their rates to those of the free ones
    at: dict[str, float]  # where every joint is while the free ones are at zero [rad, m]


def held(*names: str) -> str:
    """Return how joints are made to stand still, on the command line and in Python."""
    flags = " ".join(f"--lock {name}=0" for name in names)
    return f"{flags}, in Python locked={dict.fromkeys(names, 0.0)}"


class Tree(ABC):
    """Bodies and joints of a file, by name."""

    noun: ClassVar[str]  # what the format calls a body
    tip_nouns: ClassVar[str]  # what the tool may be
    moving: ClassVar[str]  # joints that an arm has
    path: Path
    name: str
    bodies: list[str]
    parents: dict[str, str]  # body -> the one before it
    joints: dict[str, list[TreeJoint]]  # body -> those that move it, inner first
    ties: list[Tie]
    coupled: Coupled  # once it is known which joints move
    bandwidth: float = BANDWIDTH
    repair: bool = False
    repairs: list[str]  # what was mended, for the arm's source
    unweighed: list[str]  # bodies with a shape and without a mass

    def require(self, body: str, what: str) -> str:
        """Return a body's name, refused where there is none."""
        if body not in self.bodies:
            names = ", ".join(self.bodies)
            raise ParameterError(f"{what}: no {self.noun} {body!r}; there are {names}")
        return body

    def root(self, root: str | None) -> str:
        """Return the body that stands on the platform: the one named, or the only one."""
        if root is not None:
            return self.require(root, "root")
        if not self.bodies:
            raise ParameterError(f"has no {self.noun}: is it what a xacro is made from?")
        tops = [name for name in self.bodies if name not in self.parents]
        if len(tops) != 1:
            names = ", ".join(tops) or "none"
            raise ParameterError(
                f"must have one root {self.noun}, got {names}: name the one that stands on the"
                f" platform (--root {self.noun.upper()}, in Python root=)"
            )
        return tops[0]

    def tip(self, tip: str | None, root: str) -> tuple[str, str]:
        """Return the body that has the tool, and the tool's name.

        The one named, or the only end that a joint moves.
        """
        if tip is not None:
            return self.require(tip, "tip"), tip
        moving = {j.name for joints in self.joints.values() for j in joints if not j.fixed}
        inner = set(self.parents.values())
        ends = [b for b, mover in self.movers(root, moving).items() if mover and b not in inner]
        if not ends:
            raise ParameterError(f"no joint moves beyond {root!r}")
        if len(ends) > 1:
            raise ParameterError(
                f"has {len(ends)} ends: {', '.join(ends)}; name the {self.tip_nouns} that is"
                f" the tool (--tip {ends[0]}, in Python tip={ends[0]!r}, or"
                f" {self.path.name}#{ends[0]}), or several, an arm to each"
            )
        return ends[0], ends[0]

    def chain(self, root: str, tip: str) -> list[str]:
        """Return the bodies from the one after the root to the tip."""
        out: list[str] = []
        body = tip
        while body != root:
            if body not in self.parents or len(out) > len(self.parents):
                raise ParameterError(f"no chain leads from {root!r} to {tip!r}")
            out.append(body)
            body = self.parents[body]
        return out[::-1]

    def movers(self, root: str, joints: set[str]) -> dict[str, str | None]:
        """Return the root and all bodies beyond it, each with the last of the joints that
        move it."""
        out: dict[str, str | None] = {}
        stack: list[tuple[str, str | None]] = [(root, None)]
        while stack:
            body, mover = stack.pop()
            if body in out:
                raise ParameterError(f"{self.noun} {body!r} hangs on itself, round a loop")
            if body != root:
                mover = [mover, *(j.name for j in self.joints[body] if j.name in joints)][-1]
            out[body] = mover
            below = [child for child, parent in self.parents.items() if parent == body]
            stack += [(child, mover) for child in reversed(below)]
        return out

    @abstractmethod
    def place(self, root: str, at: Mapping[str, float]) -> None:
        """Place all bodies, seen from the root, the joints where `at` says.

        Raises:
            ParameterError: a loop closes over joints that move.
        """

    def rest(self, joint: str) -> float:
        """Return where a joint stands still of which nothing is said."""
        return 0.0

    @abstractmethod
    def moving_joints(self, joints: list[TreeJoint]) -> list[Joint]:
        """Return joints as they are placed, each with an empty body."""

    @abstractmethod
    def tool(self, body: str, name: str) -> tuple[Array, Array]:
        """Return rotation (3, 3) and position (3,) of the tool."""

    @abstractmethod
    def mass(self, body: str, moves: bool) -> LinkMass | None:
        """Return a body's mass properties; None of a mere frame."""

    @abstractmethod
    def capsules(self, body: str) -> list[Segment]:
        """Return a body's shapes as capsules that hold them."""

    @abstractmethod
    def meshes(self, body: str) -> list[PlacedMesh]:
        """Return the meshes that a body is drawn with."""

    def notes(self, moving: list[str]) -> list[str]:
        """Return what the arm's source is to say of what is left out."""
        return []


def arm_of_tree(tree: Tree, choice: ChainChoice) -> Arm:
    """Return the arm that a chain of a tree is, or the arms of several on one base.

    Args:
        tree: of a file.
        choice: the chain in it.

    Raises:
        ParameterError: names the body or the joint, and what is wrong with it.
    """
    tips = [choice.tip] if choice.tip is None or isinstance(choice.tip, str) else choice.tip
    if len(tips) == 1:
        return _arm_of_chain(tree, choice, tips[0])
    moved = _chains(tree, choice, [str(tip) for tip in tips])
    arms: list[Arm] = []
    for tip, mine in moved.items():
        others = {name for joints in moved.values() for name in joints - mine}
        rotors = {k: v for k, v in choice.rotors.items() if k not in others}
        arm = _arm_of_chain(tree, choice._replace(rotors=rotors), tip, others)
        arm = replace(arm, name=tip)
        arms.append(replace(arm, base=_NOTHING, base_shape=None) if arms else arm)
    return replace(side_by_side(arms), name=tree.name)


def _chains(tree: Tree, choice: ChainChoice, tips: Sequence[str]) -> dict[str, set[str]]:
    """The joints that move on the way to each of several tips, refused where two share one."""
    if not tips or len(set(tips)) < len(tips):
        raise ParameterError(f"tips must be different, got {', '.join(tips) or 'none'}")
    root = tree.root(choice.root)
    out: dict[str, set[str]] = {}
    for tip in tips:
        chain = tree.chain(root, tree.tip(tip, root)[0])
        joints = {k.name: body for body in chain for k in tree.joints[body] if not k.fixed}
        for other, theirs in out.items():
            for name, body in joints.items():
                if name in theirs and name not in choice.locked:
                    raise ParameterError(
                        f"the arms to {other!r} and {tip!r} share joint {name!r} and its"
                        f" {tree.noun} {body!r}: hold it ({held(name)})"
                    )
        out[tip] = joints.keys() - choice.locked.keys()
    return out


def _arm_of_chain(
    tree: Tree, choice: ChainChoice, tip: str | None, others: Set[str] = frozenset()
) -> Arm:
    """The arm of one chain; what other arms' joints move is no part of it."""
    tree.repair, tree.repairs = choice.repair, []
    root = tree.root(choice.root)
    end, tip = tree.tip(tip, root)
    chain = tree.chain(root, end)
    tree.coupled = coupled = _coupled(tree, root, chain, _locked(tree, choice))
    if not coupled.free:
        raise ParameterError(f"no {tree.moving} joint lies between {root!r} and {tip!r}")
    tree.place(root, coupled.at)
    joints, lost = _moving(tree, root, chain, coupled)
    rotors = _with_rotors(joints, choice.rotors)
    movers = tree.movers(root, {*joints, *others})
    movers = {body: mover for body, mover in movers.items() if mover not in others}
    for body in choice.massless:
        tree.require(body, "massless")
    tree.unweighed = []
    masses = {
        body: tree.mass(body, mover is not None)
        for body, mover in movers.items()
        if body not in choice.massless
    }
    if tree.unweighed:
        _refuse_unweighed(tree.unweighed)
    pieces: dict[str | None, list[LinkMass]] = {name: [] for name in (None, *joints)}
    for body, mass in masses.items():
        if mass is not None:
            pieces[movers[body]].append(mass)
    tool = tree.tool(end, tip)
    if choice.check:
        along = [joint for joint in joints.values() if not joint.beside]
        moved = [piece for name in joints for piece in pieces[name]]
        size = _require_plausible(along, tool[1], moved)
    lumps: dict[str | None, Lump] = {None: Lump()}
    lumps |= {name: joint.body for name, joint in joints.items()}
    still = []
    for mover, of in pieces.items():
        for piece in of:
            lumps[mover].add(piece)
    _require_bodies(tree, lumps, pieces)
    for body, mover in movers.items():
        if choice.collision:
            capsules = tree.capsules(body)
            if choice.check:
                _require_shapes(body, capsules, size)
            lumps[mover].capsules += capsules
        lumps[mover].meshes += tree.meshes(body)
        for joint in tree.joints[body] if body != root else ():
            if not joint.fixed and joint.name not in joints:
                still.append(f"{joint.name} at {coupled.at[joint.name]:g}")
    notes = [f"read from {tree.path.name}, {root} to {tip}"]
    if still:
        notes.append(f"joints that stand still: {', '.join(still)}")
    names = [joint.name for joint in joints.values() if joint.ratios is not None]
    if names:
        notes.append(f"joints that follow others: {', '.join(names)}")
    if choice.massless:
        notes.append(f"taken to weigh nothing: {', '.join(choice.massless)}")
    notes += [*tree.repairs, *lost]
    return arm_of(
        tree.name,
        lumps[None],
        list(joints.values()),
        tool,
        source="; ".join([*notes, *tree.notes(list(joints)), *rotors]),
        collision=choice.collision,
        bandwidth=tree.bandwidth,
    )


def _refuse_unweighed(names: Sequence[str]) -> None:
    """Refuse links of which nothing says what they weigh, all at once."""
    some = ", ".join(map(repr, names))
    what = f"link {some} has" if len(names) == 1 else f"links {some} have"
    flags = " ".join(f"--massless {name}" for name in names)
    raise ParameterError(
        f"{what} a shape, but no <inertial>: mass is unknown ({flags}, in Python"
        f" massless={list(names)}, takes it to be nothing)"
    )


def _locked(tree: Tree, choice: ChainChoice) -> dict[str, float]:
    """The joints that are asked to stand still, and where [rad, m]."""
    every = {joint.name: joint for joints in tree.joints.values() for joint in joints}
    out = {}
    for name, value in choice.locked.items():
        if name not in every:
            raise ParameterError(f"locked: no joint {name!r}; there are {', '.join(every)}")
        turns = choice.degrees and not every[name].slides
        out[name] = math.radians(value) if turns else float(value)
    return out


def _coupled(tree: Tree, root: str, chain: list[str], locked: Mapping[str, float]) -> Coupled:
    """The joints of a chain that move, and those that follow them; refuse what no arm has.

    Who holds a follower undoes its tie; it stands still where all that it follows does.
    """
    joints = {k.name: k for of in tree.joints.values() for k in of}
    on_chain = [joint for body in chain for joint in tree.joints[body]]
    loose = [k for k in on_chain if not k.fixed and k.name not in locked]
    ties = _ties(tree, root, {k.name for k in loose}, locked)
    free = [k for k in loose if k.name not in ties]
    n = len(free)
    rows = {k: np.zeros(n + 1) for k in joints}  # rates to the free ones, and where they are
    for name, row in rows.items():
        row[n] = locked.get(name, tree.rest(name))
    rows |= {joint.name: np.eye(n + 1)[k] for k, joint in enumerate(free)}
    rows |= _solved(tree, ties, rows)
    moving = {k: row[:n] for k, row in rows.items() if row[:n].any()}
    for tie in ties.values():
        if tie.bend:
            involved = [k for k in tie.ratios if k in moving or k in ties]
            _refuse(tie, involved, [tie.follower])
    for name in moving:
        if fault := joints[name].fault:
            raise ParameterError(fault)
    return Coupled(free, moving, {name: float(row[n]) for name, row in rows.items()})


def _ties(
    tree: Tree, root: str, loose: set[str], locked: Mapping[str, float]
) -> dict[str, Tie]:
    """Ties beyond the root by their followers; refuse those that cannot be kept.

    A follower off the chain of what is not there stands still.
    """
    joints = {k.name for of in tree.joints.values() for k in of}
    beyond = {k.name for body in tree.movers(root, set()) if body != root
              for k in tree.joints[body]}  # fmt: skip
    out: dict[str, Tie] = {}
    for tie in tree.ties:
        if math.isnan(tie.shift):  # by a tendon between sites
            involved = [k for k in (tie.follower, *tie.ratios) if k in loose]
            _refuse(tie, involved, involved)
            continue
        there = tie.ratios.keys() <= joints
        if tie.follower not in beyond or tie.follower in locked:
            continue
        if tie.follower in out or (not there and tie.follower in loose):
            what = "and follows others too" if there else "which is not there"
            raise ParameterError(f"{tie.what}, {what}: hold it ({held(tie.follower)})")
        if there:
            out[tie.follower] = tie
    return out


def _solved(tree: Tree, ties: Mapping[str, Tie], rows: Mapping[str, Array]) -> dict[str, Array]:
    """Rows of followers from those of all others: rates to the free joints, and where they
    are."""
    names = list(ties)
    if not names:
        return {}
    among = np.eye(len(names))  # followers less what they follow of each other = what is known
    constants = np.zeros((len(names), len(next(iter(rows.values())))))
    for i, tie in enumerate(ties.values()):
        constants[i, -1] = tie.shift
        if tie.bend:  # of what stands still; else refused
            way = sum(k * (rows[j][-1] - tree.rest(j)) for j, k in tie.bend[1].items())
            constants[i, -1] += np.polyval([*tie.bend[0][::-1], 0.0, 0.0], way)
        for leader, ratio in tie.ratios.items():
            if leader in ties:
                among[i, names.index(leader)] -= ratio
            else:
                constants[i] += ratio * rows[leader]
    if abs(np.linalg.det(among)) < _ROUND:
        raise ParameterError(
            f"joints {', '.join(map(repr, names))} follow each other in a ring: hold one"
            f" ({held(names[0])})"
        )
    return dict(zip(names, np.linalg.solve(among, constants), strict=True))


def _refuse(tie: Tie, moving: list[str], remedy: list[str]) -> None:
    """Refuse a tie in no proportion, of which joints would move, unless some are held."""
    if moving:
        involved, hold = (", ".join(map(repr, names)) for names in (moving, remedy))
        raise ParameterError(
            f"{tie.what}, but not in proportion, and {involved} would move: hold {hold}"
            f" ({held(*remedy)})"
        )


def _moving(
    tree: Tree, root: str, chain: list[str], coupled: Coupled
) -> tuple[dict[str, Joint], list[str]]:
    """All joints that move, from base to tool and then beside these, the limits of followers
    in those of what they follow; and what is lost."""
    on_chain = [k for body in chain for k in tree.joints[body] if k.name in coupled.moving]
    others = [body for body in tree.movers(root, set()) if body not in (root, *chain)]
    beside = [k for body in others for k in tree.joints[body] if k.name in coupled.moving]
    joints = {joint.name: joint for joint in tree.moving_joints([*on_chain, *beside])}
    free, lost = [joints[k.name] for k in coupled.free], []
    movers = tree.movers(root, set(joints))
    for mine in beside:
        inner = [k.name for k in tree.joints[mine.body] if k.name in joints]
        before = inner[: inner.index(mine.name)]
        joints[mine.name].beside = True
        joints[mine.name].on = [movers[tree.parents[mine.body]], *before][-1]
    for name, ratios in coupled.moving.items():
        if joints[name] in free:
            continue
        joints[name].ratios = ratios
        leaders = np.flatnonzero(ratios)
        if len(leaders) == 1:
            k = int(leaders[0])
            _restrict(tree, free[k], joints[name], float(ratios[k]), coupled.at[name])
        else:
            lost.append(f"limits and friction of {name}, which follows several, left out")
    return joints, lost


def _restrict(tree: Tree, leader: Joint, follower: Joint, ratio: float, shift: float) -> None:
    """Keep a follower's limits by those of the joint that it follows, and add its friction."""
    if abs(follower.q_min) < ENDLESS or abs(follower.q_max) < ENDLESS:
        ends = sorted((end - shift) / ratio for end in (follower.q_min, follower.q_max))
        low, high = max(leader.q_min, ends[0]), min(leader.q_max, ends[1])
        if low < high:
            leader.q_min, leader.q_max = low, high
        elif tree.repair:
            tree.repairs.append(f"limits of {follower.name}, a follower, left out")
        else:
            raise ParameterError(
                f"joint {follower.name!r} follows {leader.name!r}, whose limits of"
                f" {leader.q_min:.4g} to {leader.q_max:.4g} leave it no range within its own"
                f" {follower.q_min:.4g} to {follower.q_max:.4g}: --repair, in Python"
                f" repair=True, leaves these out, or hold it ({held(follower.name)})"
            )
    for name in ("v_max", "a_max"):
        if most := getattr(follower, name):
            most /= abs(ratio)
            setattr(leader, name, min(getattr(leader, name) or most, most))
    leader.damping = (leader.damping or 0.0) + ratio**2 * (follower.damping or 0.0)
    leader.friction = (leader.friction or 0.0) + abs(ratio) * (follower.friction or 0.0)
    follower.damping = follower.friction = None


def _with_rotors(joints: Mapping[str, Joint], rotors: Mapping[str, float]) -> list[str]:
    """Set rotor inertias [kg m^2] that are given beside the file; return the note on them."""
    for name, value in rotors.items():
        if name not in joints:
            raise ParameterError(
                f"rotors: no moving joint {name!r}; there are {', '.join(joints)}"
            )
        if not (math.isfinite(value) and value >= 0):
            raise ParameterError(
                f"rotors: inertia about joint {name!r} must be >= 0 kg m^2, got {value!r}"
            )
        joints[name].rotor_inertia = float(value)
    if not rotors:
        return []
    values = (f"{name} {value:g} kg m^2" for name, value in rotors.items())
    return [f"rotor inertia given beside the file: {', '.join(values)}"]


def _require_bodies(
    tree: Tree, lumps: Mapping[str | None, Lump], pieces: Mapping[str | None, list[LinkMass]]
) -> None:
    """Refuse links that move as one and are no rigid body together; or take the nearest one,
    where the tree is to be repaired.

    Links that are none by themselves are noted: only together do they act.
    """
    remedy = "--repair, in Python repair=True"
    alone: list[str] = []
    for mover, lump in lumps.items():
        faulty = [k.link for k in pieces[mover] if _is_no_body(k.moments)]
        names = ", ".join(map(repr, [k.link for k in pieces[mover]]))
        about = lump.second - lump.mass_at_centre
        try:
            lump.inertial(np.eye(3), np.zeros(3))
        except ParameterError as error:
            if not tree.repair:
                raise ParameterError(
                    f"{tree.noun} {names}: {error}: {remedy} takes the nearest that a body has"
                ) from None
            nearest = rigid_moments(about)
        else:
            if lump.mass or not lump.second.any():
                alone += faulty
                continue
            if not tree.repair:
                raise ParameterError(
                    f"{tree.noun} {names} has an inertia, but no mass: {remedy} leaves the"
                    " inertia out"
                )
            nearest = np.zeros((3, 3))
        was, now = (
            ", ".join(f"{k:.4g}" for k in np.linalg.eigvalsh(x)) for x in (about, nearest)
        )
        names = ", ".join(k.link for k in pieces[mover])
        tree.repairs.append(f"principal moments of {names} {was} taken as {now} kg m^2")
        lump.second = lump.mass_at_centre + nearest
    if alone:
        tree.repairs.append(
            f"inertia of {', '.join(alone)}, which no rigid body has, taken as it is: with what"
            " moves along it is one"
        )


def _is_no_body(moments: Array) -> bool:
    gap = np.abs(rigid_moments(moments) - moments).max()
    return bool(gap > _ROUND * np.abs(moments).max())


def _require_shapes(body: str, capsules: list[Segment], size: float) -> None:
    """Refuse shapes far larger than the arm, which look like mm."""
    largest = max((r + float(np.linalg.norm(b - a)) for a, b, r in capsules), default=0.0)
    if largest > _SHAPE * size:
        raise ParameterError(
            f"link {body!r} has a shape of {largest:.4g} m on an arm of {size:.3g} m: shapes"
            ' must be in m, this one looks like mm (give the mesh scale="0.001 0.001 0.001",'
            " --no-collision, in Python collision=False, leaves shapes out, --no-check takes"
            " them)"
        )


def _require_plausible(joints: list[Joint], tool: Array, pieces: list[LinkMass]) -> float:
    """Return the arm's size [m]; refuse lengths, masses and inertias that look like mm, g and
    kg mm^2."""
    points = np.array([*(joint.origin for joint in joints), tool])
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    reach = float(steps.sum())
    if reach > _REACH:
        k = int(steps.argmax())
        raise ParameterError(
            f"what joint {joints[k].name!r} moves is {steps[k]:.4g} m long and the whole arm"
            f" {reach:.4g} m: lengths must be in m, these look like mm (--no-check,"
            " in Python check=False, takes them)"
        )
    distances = [np.linalg.norm(k.com - points, axis=1).min() for k in pieces if k.mass]
    size = max([reach, 1e-3, *(2 * float(k) for k in distances)])
    for piece in pieces:
        largest = float(np.abs(piece.moments).max())
        if piece.mass and largest > piece.mass * (_GYRATION * size) ** 2:
            raise ParameterError(
                f"link {piece.link!r} of {piece.mass:.4g} kg has an inertia of {largest:.4g}"
                f" kg m^2, a radius of gyration of {math.sqrt(largest / piece.mass):.3g} m on"
                f" an arm of {size:.3g} m: inertias must be in kg m^2, these look like kg mm^2"
                " (--no-check, in Python check=False, takes them)"
            )
    total = sum(piece.mass for piece in pieces)
    if total > _DENSITY * size**3:
        heaviest = max(pieces, key=lambda piece: piece.mass)
        raise ParameterError(
            f"link {heaviest.link!r} has {heaviest.mass:.4g} kg and all that moves {total:.4g}"
            f" kg on {size:.3g} m: masses must be in kg, these look like g (--no-check,"
            " in Python check=False, takes them)"
        )
    return size
