"""Bodies and joints of a file as a tree, by name: what a format provides to `arm_reader`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, NamedTuple

from ves_gym._util.params import Array, ParameterError
from ves_gym.mechanics.chain import Joint, LinkMass
from ves_gym.mechanics.link import BANDWIDTH, Capsule, MeshFile


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
    unweighed: list[str]  # bodies with a shape, of which the file gives no mass

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
        """Return the body that has the tool, and the tool's name: the one named, or the only
        end that a joint moves."""
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
        """Place all bodies, seen from the root, the joints where `at` says; refuse a loop that
        closes over joints that move."""

    def rest(self, joint: str) -> float:
        """Return where a joint stands still by default."""
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
    def capsules(self, body: str) -> list[Capsule]:
        """Return a body's shapes as capsules that hold them."""

    @abstractmethod
    def meshes(self, body: str) -> list[MeshFile]:
        """Return the meshes that a body is drawn with."""

    def notes(self, moving: list[str]) -> list[str]:
        """Return what the arm's source is to say of what is left out."""
        return []
