"""Arms as data: Denavit-Hartenberg links with masses, joints that turn or slide.

Another arm, or the PUMA with its wrist, is another `Arm` (a TOML, URDF or MJCF file read by
`arm_library.get_arm`), not another piece of code.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ves_gym._util.params import (
    Array,
    ParameterError,
    Vector,
    finite,
    freeze_arrays,
    from_plain,
    read_table,
    require_positive,
    unit,
    write_text,
)
from ves_gym.mechanics.arm_arrays import (
    Chain,
    JointCoupling,
    JointFrame,
    LinkBodies,
    Root,
    spans,
)
from ves_gym.mechanics.link import (
    WEIGHTLESS,
    Capsule,
    Flexure,
    Follower,
    Inertial,
    Limb,
    Link,
    MeshFile,
    Mount,
    turn_by,
    turned_about,
)

if TYPE_CHECKING:
    import pinocchio


class ArmPart(NamedTuple):
    """A joint and the link it moves among all of an arm, and what carries it."""

    link: Link
    body: str  # its name in MuJoCo's models: link_1 or follower_1
    joint: str  # q_1 or follows_1
    on: int  # the part that carries it; -1: the base link
    rotation: Array  # (3, 3) of its joint, less the offset, in the carrier's own frame
    position: Array  # (3,) m
    ratios: Vector | None  # of a follower


@dataclass(frozen=True, kw_only=True)
class Arm:
    """Joints and links one after the other, on a base link fixed to the platform top.

    The tool is the last link's frame, turned by `tool_angle` about its z. Several arms side by
    side are one `Arm` too (`side_by_side`): `links` has those of all, `beside` says which are
    those of the arms before the last one, whose tool is the tool. `links` are those of the
    joints that are driven; joints that follow them are `followers`.
    """

    name: str
    base: Inertial  # base link, in the platform-top frame
    base_shape: tuple[Capsule, ...] | None = None  # of the base link, in the same frame
    base_meshes: tuple[MeshFile, ...] | None = field(default=None, compare=False)
    base_flexures: tuple[Flexure, ...] | None = None  # where the base link bends
    mount: Mount | None = None  # of the first joint; None: at the platform-top frame
    beside: tuple[Limb, ...] | None = None  # the arms before the last one, in order of links
    links: tuple[Link, ...]
    followers: tuple[Follower, ...] | None = None
    tool_angle: float | None = unit("rad", default=None)
    bandwidth: float | None = unit("Hz", default=None)  # of the joint servos, see own_gains
    source: str  # where this whole set comes from

    def __post_init__(self) -> None:
        freeze_arrays(self)
        if not self.links:
            raise ParameterError("Arm.links must hold at least one link, got none")
        finite(self.tool_angle or 0.0, (), "Arm.tool_angle")
        others = sum(limb.joints for limb in self.beside or ())
        if others >= len(self.links):
            raise ParameterError(
                f"Arm.beside must leave the last arm a link, got {others} joints beside it of"
                f" {len(self.links)}"
            )
        if self.beside:
            self.require_rigid("an arm beside others")
            self.require_uncoupled("an arm beside others")
        if self.followers:
            self._require_followers()
        if self.links[-1].flexures:
            raise ParameterError(
                "the last of Arm.links must not bend, for it carries the tool: got"
                f" {len(self.links[-1].flexures)} flexures"
            )
        if self.bandwidth is not None:
            require_positive(self, "bandwidth")

    @cached_property
    def n(self) -> int:
        """Number of joints."""
        return len(self.links)

    @property
    def home(self) -> Array:
        """Joint angles (n,) [rad] as near to 0 as the limits allow."""
        out: Array = np.clip(0.0, self.column("q_min"), self.column("q_max"))
        return out

    def _require_followers(self) -> None:
        """Refuse followers that stand nowhere, or on joints that give way."""
        if self.bends or self.geared:
            raise ParameterError(
                f"{self.name} has joints that follow others: its links and gears must be rigid"
            )
        followers = self.followers or ()
        places = sorted(k.place for k in followers if k.place is not None)
        carriers = self.n + len(places)
        if len(set(places)) < len(places) or (places and not 0 <= places[-1] < carriers):
            raise ParameterError(f"Follower.place must be one's own below {carriers}: {places}")
        for k in followers:
            if len(k.ratios) != self.n:
                raise ParameterError(f"Follower.ratios must have {self.n}, got {k.ratios}")
            if k.on is not None:
                if not -1 <= k.on < carriers:
                    raise ParameterError(
                        f"Follower.on must be -1 to {carriers - 1}, got {k.on}"
                    )
                carriers += 1

    @cached_property
    def parts(self) -> tuple[ArmPart, ...]:
        """All joints and links: from base to tool, then followers beside these."""
        at = {k.place: i for i, k in enumerate(self.followers or ()) if k.place is not None}
        feet = {foot.first: foot[1:3] for foot in self.feet}
        links, out = iter(enumerate(self.links, start=1)), []
        for place in range(self.n + len(at)):
            foot = feet.get(place, (np.eye(3), np.zeros(3)))
            on = -1 if place in feet else place - 1
            if place in at:
                out.append(self._following(at[place], on, *foot))
            else:
                i, link = next(links)
                out.append(ArmPart(link, f"link_{i}", f"q_{i}", on, *foot, None))
        for i, follower in enumerate(self.followers or ()):
            if follower.on is not None:
                foot = Root.at(0, follower.mount)[1:3]
                out.append(self._following(i, follower.on, *foot))
        return tuple(out)

    def _following(self, i: int, on: int, rotation: Array, position: Array) -> ArmPart:
        """A follower as a part, its limits those of what it follows."""
        follower, i = (self.followers or ())[i], i + 1
        names = f"follower_{i}", f"follows_{i}"
        gear = np.array(follower.ratios)
        ends = np.sort([gear * self.column(k) for k in ("q_min", "q_max")], axis=0).sum(axis=1)
        v_max, a_max = (float(np.abs(gear) @ self.column(k)) for k in ("v_max", "a_max"))
        led = np.flatnonzero(gear)
        link = replace(
            follower.link,
            q_min=float(ends[0]),
            q_max=float(ends[1]),
            v_max=v_max,
            a_max=a_max,
            tau_max=float((self.column("tau_max")[led] / np.abs(gear[led])).min()),
        )
        return ArmPart(link, *names, on, rotation, position, follower.ratios)

    @cached_property
    def _rows(self) -> tuple[int, ...]:
        """Parts in the order of `dynamics`: those beside the chain, outer ones first, and the
        chain, which ends in the tool."""
        chain = self._chain
        return (*reversed(range(chain, len(self.parts))), *range(chain))

    def depth_first(self, on: int = -1) -> list[int]:
        """Return places in `parts`, each before what it carries, and all that before the next:
        the order of bodies in MuJoCo and Pinocchio."""
        out: list[int] = []
        for k, part in enumerate(self.parts):
            if part.on == on:
                out += [k, *self.depth_first(k)]
        return out

    @property
    def ordered(self) -> list[ArmPart]:
        """Parts as `dynamics` takes them."""
        return [self.parts[k] for k in self._rows]

    @property
    def _chain(self) -> int:
        """Number of joints from base to tool (of all arms)."""
        return len(self.parts) - sum(k.on is not None for k in self.followers or ())

    @cached_property
    def joints(self) -> tuple[JointFrame, ...]:
        """Lengths and angles of the links as `dynamics` takes them, followers' before them."""
        links = (part.link for part in self.ordered)
        return tuple(
            JointFrame(
                link.d,
                link.a,
                turn_by(link.alpha),
                turn_by(link.beta) if link.beta else None,
                link.offset,
                bool(link.slides),
            )
            for link in links
        )

    @cached_property
    def feet(self) -> tuple[Root, ...]:
        """Return the root of each arm, one without others."""
        out, first = [], 0
        for limb in self.beside or ():
            out.append(Root.at(first, limb.mount))
            first += limb.joints
        return (*out, Root.at(first, self.mount))

    @cached_property
    def roots(self) -> tuple[Root, ...]:
        """Return roots of the chains of `joints`: of each arm and each follower beside one."""
        if not self.followers:
            return self.feet
        at = {part: row for row, part in enumerate(self._rows)}
        out = []
        for row, k in enumerate(self._rows):
            part = self.parts[k]
            if k == 0 or k >= self._chain:
                on = None if part.on < 0 else at[part.on]
                out.append(Root(row, part.rotation, part.position, on))
        return tuple(out)

    @cached_property
    def coupling(self) -> JointCoupling | None:
        """Return the coupling of `joints` to the driven ones; None: they are the same."""
        if not self.followers:
            return None
        driven, rows = iter(range(self.n)), {}
        for k, part in enumerate(self.parts):
            pairs = enumerate(part.ratios) if part.ratios is not None else [(next(driven), 1.0)]
            rows[k] = tuple((j, float(ratio)) for j, ratio in pairs if ratio)
        return JointCoupling(tuple(rows[k] for k in self._rows), self.n)

    @property
    def driven(self) -> list[int]:
        """Rows of `joints` (n,) that the links have; the last is always that of the tool."""
        rows = [row for row, part in enumerate(self.ordered) if part.ratios is None]
        return [*rows[:-1], len(self.parts) - 1]

    @property
    def spans(self) -> tuple[slice, ...]:
        """Joints of each arm among all, one without others."""
        return spans(self.feet, self.n)

    @property
    def placements(self) -> list[tuple[Array, Array]]:
        """Joints' frames at zero in those that carry them, and last the tool's: a rotation
        (3, 3) and a position (3,) [m] of each of `parts`, on the base in the platform-top
        frame."""
        out, far = [], [part.link.far_end for part in self.parts]
        for part in self.parts:
            R, p = far[part.on] if part.on >= 0 else (np.eye(3), np.zeros(3))
            turn = R @ part.rotation @ turned_about(2, part.link.offset)
            out.append((turn, p + R @ part.position))
        R, p = far[self._rows[-1]]
        return [*out, (R @ self.tool_rotation, p)]

    @cached_property
    def bodies(self) -> LinkBodies:
        """Base link and links as arrays, in the order of `joints`."""
        links = [part.link for part in self.ordered]
        inertials = [self.base, *(link.inertial for link in links)]
        return LinkBodies(
            np.array([k.mass for k in inertials]),
            np.array([k.com for k in inertials]),
            np.array([k.inertia for k in inertials]),
            np.array([link.rotor_inertia for link in links]),
        )

    @property
    def tool_rotation(self) -> Array:
        """(3, 3) of the tool in the last link's frame."""
        return turned_about(2, self.tool_angle or 0.0)

    @property
    def rubs(self) -> bool:
        """True if a link has damping or friction."""
        return any(link.damping or link.friction for link in self.links)

    def without_friction(self) -> Arm:
        """Return the arm without damping and friction of its links (itself, if it has none)."""
        if not self.rubs:
            return self
        links = tuple(replace(link, damping=None, friction=None) for link in self.links)
        return replace(self, links=links)

    @property
    def geared(self) -> tuple[int, ...]:
        """Joints (from 0) whose gears give way."""
        return tuple(i for i, link in enumerate(self.links) if link.gear is not None)

    @property
    def sliding(self) -> tuple[int, ...]:
        """Joints (from 0) that slide: q in m, tau in N."""
        return tuple(i for i, link in enumerate(self.links) if link.slides)

    def require_turning(self, what: str) -> None:
        """Refuse joints that slide, by name; `what` it is that takes all for revolute."""
        if self.sliding:
            names = ", ".join(self.links[i].name or f"joint {i + 1}" for i in self.sliding)
            raise ParameterError(
                f"{what} takes revolute joints, got {self.name} with {names} that slide:"
                " simulate it in mode ideal, or hold them (--lock JOINT=0, in"
                " Python locked=)"
            )

    @cached_property
    def bends(self) -> int:
        """Number of flexures: passive joints between the driven ones."""
        parts = (self.base_flexures, *(link.flexures for link in self.links))
        return sum(len(part or ()) for part in parts)

    def rigid(self) -> Arm:
        """Return the arm whose links and gears do not give way (itself, if none does)."""
        if not (self.bends or self.geared):
            return self
        links = tuple(replace(link, flexures=None, gear=None) for link in self.links)
        return replace(self, links=links, base_flexures=None)

    def require_rigid(self, what: str) -> None:
        """Refuse links that bend; `what` it is that takes them for rigid."""
        if self.bends:
            raise ParameterError(
                f"{what} takes links for rigid, got {self.name} with {self.bends} flexures: put"
                " the small arm on its braked boom as a vehicle (Boom.at), or simulate"
            )

    def span_of(self, i: int) -> slice:
        """Return the joints of the arm, of several, that joint i (from 0) belongs to."""
        return next(span for span in self.spans if i < span.stop)

    def require_alone(self, what: str) -> None:
        """Refuse several arms on one base; `what` it is that takes one."""
        if self.beside:
            raise ParameterError(
                f"{what} takes one arm, got {self.name}, {len(self.spans)} arms on one base:"
                " give one of them (Arm.apart)"
            )

    def require_uncoupled(self, what: str) -> None:
        """Refuse joints that follow others; `what` it is that takes none."""
        if self.followers:
            names = [k.link.name or f"follower {i}" for i, k in enumerate(self.followers, 1)]
            raise ParameterError(
                f"{what} takes an arm of driven joints alone, got {self.name}, where"
                f" {', '.join(names)} follow: hold them (--lock JOINT=0, in Python locked=)"
            )

    def require_driven_tool(self, what: str) -> None:
        """Refuse a tool on a joint that follows others; `what` it is that hangs on it."""
        if self.ordered[-1].ratios is not None:
            raise ParameterError(
                f"{what} takes a tool on a driven joint, got {self.name}, whose last joint"
                " follows others"
            )

    @property
    def apart(self) -> tuple[Arm, ...]:
        """Each of several arms as one of its own; the base link stays with the last one."""
        if not self.beside:
            return (self,)
        limbs = [*self.beside, Limb(name=self.name, joints=1, mount=self.mount)]
        turns = [*(limb.tool_angle for limb in self.beside), self.tool_angle]
        return tuple(
            replace(
                self,
                name=limb.name,
                base=self.base if span.stop == self.n else WEIGHTLESS,
                base_shape=self.base_shape if span.stop == self.n else None,
                base_meshes=self.base_meshes if span.stop == self.n else None,
                mount=limb.mount,
                beside=None,
                links=self.links[span],
                tool_angle=turn,
            )
            for limb, span, turn in zip(limbs, self.spans, turns, strict=True)
        )

    def column(self, name: str) -> Array:
        """One number of every link, e.g. `column("tau_max")`: (n,)."""
        return np.array([getattr(link, name) for link in self.links])

    @property
    def mass(self) -> float:
        """Total mass [kg]."""
        followed = sum(k.link.inertial.mass for k in self.followers or ())
        return self.base.mass + sum(link.inertial.mass for link in self.links) + followed

    def require_within_limits(self, q: object, name: str = "q") -> Array:
        """Return joint angles (n,) [rad] as an array, refused outside the joint limits by
        `name`."""
        array = finite(q, (self.n,), name)
        for i, link in enumerate(self.links):
            if not link.q_min - 1e-9 <= array[i] <= link.q_max + 1e-9:
                symbol = "m" if link.slides else "deg"
                low, high, got = (
                    f"{k:.4g}" if link.slides else f"{math.degrees(k):.1f}"
                    for k in (link.q_min, link.q_max, array[i])
                )
                raise ParameterError(
                    f"{name}: joint {i + 1} must be within {low} to {high} {symbol}, got {got}"
                    f" {symbol}"
                )
        return array

    def at(self, position: Vector, angles: Vector = (0.0, 0.0, 0.0)) -> Arm:
        """Return this arm, with its base link, elsewhere on the base: its platform-top frame at
        a position (3,) [m], turned by angles (3,) about x, then y, then z [rad]."""
        arm: Arm = import_module("ves_gym.mechanics.side_by_side").placed(
            self, position, angles
        )
        return arm

    @staticmethod
    def from_file(
        path: str | os.PathLike[str],
        *,
        tip: str | Sequence[str] | None = None,
        root: str | None = None,
        locked: Mapping[str, float] | None = None,
        collision: bool = True,
        check: bool = True,
        rotors: Mapping[str, float] | None = None,
        allow_outside: bool = False,
        massless: Sequence[str] = (),
        repair: bool = False,
        degrees: bool = False,
    ) -> Arm:
        """Read the chain of joints from root to tip of a URDF or MJCF file.

        Fixed joints are merged; joints off the chain stand still at zero. The root's frame is
        the platform-top frame, the tip's the tool. What a file does not give is derived, and
        `source` says so. An MJCF file is read as MuJoCo compiles it.

        Args:
            tip: link, body or site that is the tool; default the site `tool`, else the last
                one, where there is one. Several: an arm to each, side by side on one base, as
                `System(arms=...)` has them; the last one's tool is the tool.
            root: link or body that stands on the platform; default the file's, or the world.
            locked: angles [rad] of joints that stand still, by name; [m] of those that slide.
            collision: read shapes as capsules; False: capsules along the links.
            check: refuse numbers that look like g, mm, kg mm^2 or degrees.
            rotors: inertia of rotors about their joints [kg m^2], by name, in place of the
                file's: what a file of links that were identified or rounded lacks.
            allow_outside: read meshes that a URDF names outside its folder and its package.
            massless: links that have a shape and no mass of their own, to weigh nothing.
            repair: take the nearest inertia that a rigid body has, leave an inertia without
                mass out, and 2 pi either way for a range of nothing; `source` lists each.
            degrees: `locked` is in degrees, of joints that turn.

        Raises:
            ParameterError: names the link or the joint, and what is wrong with it.
        """
        files, lock, added = _files(), dict(locked or {}), dict(rotors or {})
        choice = files.ChainChoice(
            tip, root, lock, collision, check, added, allow_outside, tuple(massless), repair,
            degrees,
        )  # fmt: skip
        arm: Arm = files.read_file(path, choice)
        return arm

    def to_urdf(self, path: str | os.PathLike[str]) -> None:
        """Write a URDF file: `from_file` gives this arm back, a capsule as three shapes. URDF
        has no words for gears that give way."""
        write_text(path, _files().urdf_text(self))

    def to_mjcf(self, path: str | os.PathLike[str]) -> None:
        """Write an MJCF file: `from_file` gives this arm back. No words for gears that give
        way."""
        write_text(path, _files().mjcf_text(self))

    def to_pinocchio(self) -> pinocchio.Model:
        """Return the arm on a base that stands still in Pinocchio, its tool the frame
        `tool`."""
        return _files().pinocchio_model(self)


def _files() -> Any:
    """Readers and writers of URDF and MJCF, which most programs never need."""
    return import_module("ves_gym.mechanics.arm_files")


def read_arm(path: str | os.PathLike[str]) -> Arm:
    """Read an arm from a TOML or JSON file that mirrors `Arm`."""
    arm: Arm = from_plain(Arm, read_table(path), str(path))
    return arm


Mechanism = Arm | Chain
