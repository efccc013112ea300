"""Obstacles as plain data, and distances from them by MuJoCo's collision detection.

All in the platform-top frame with the base at rest; `Surroundings.clearance` leaves room
for its sway. The arm is a chain of capsules; the platform, the beam or the satellite under
it, and its own links count as soon as surroundings are given.
"""

from __future__ import annotations

import itertools
import math
import os
from collections import Counter
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, ClassVar, NamedTuple, cast

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import (
    Array,
    ParameterError,
    Vector,
    finite,
    from_plain,
    read_table,
    require_positive,
    unit,
)
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.dynamics import drawn_configurations
from ves_gym.mechanics.link import Capsule
from ves_gym.mechanics.spatial import rotation
from ves_gym.mechanics.vehicle import Beam, FlexibleBase
from ves_gym.system.system import System

RESOLUTION = 0.04  # rad in joint space between the configurations a search checks
# Radius of the first link over the arm's length (this project): thin enough for a PUMA's
# forearm to pass its column with some clearance, as the machine's does.
_THICKNESS = 0.036
_TAPER = 0.45  # by how much of it the last link is thinner
_PLATFORM = 4.5, 0.06  # radius over the first link's; height [m]
_AROUND = 29  # collision bit of what surrounds the arm; links below it have their own


@dataclass(frozen=True, kw_only=True)
class Sphere:
    """A ball."""

    kind: ClassVar[str] = "sphere"
    centre: Vector = unit("m")
    radius: float = unit("m")

    def __post_init__(self) -> None:
        finite(self.centre, (3,), "Sphere.centre")
        require_positive(self, "radius")


@dataclass(frozen=True, kw_only=True)
class Box:
    """A box, turned by Z-Y-X fixed angles (phi_x, phi_y, phi_z) as the base is."""

    kind: ClassVar[str] = "box"
    centre: Vector = unit("m")
    size: Vector = unit("m")  # edge lengths
    angles: Vector = unit("rad", default=(0.0, 0.0, 0.0))

    def __post_init__(self) -> None:
        finite(self.centre, (3,), "Box.centre")
        finite(self.angles, (3,), "Box.angles")
        if not (finite(self.size, (3,), "Box.size") > 0).all():
            raise ParameterError(f"Box.size must be > 0 m, got {self.size}")


@dataclass(frozen=True, kw_only=True)
class Surroundings:
    """Obstacles, and the distance to keep from everything."""

    obstacles: tuple[Sphere | Box, ...] = ()
    clearance: float = unit("m", default=0.02)

    def __post_init__(self) -> None:
        require_positive(self, "clearance", zero=True)
        if not isinstance(self.obstacles, tuple):
            raise ParameterError(f"obstacles must be a tuple, got {self.obstacles!r}")
        for obstacle in self.obstacles:
            if not isinstance(obstacle, Sphere | Box):
                raise ParameterError(f"obstacles must be Sphere or Box, got {obstacle!r}")


def read_surroundings(path: str | os.PathLike[str]) -> Surroundings:
    """Surroundings from a TOML or JSON file that mirrors `Surroundings`."""
    return cast(Surroundings, from_plain(Surroundings, read_table(path), str(path)))


def link_radius(arm: Arm, i: int) -> float:
    """Radius of link i's capsule, from 0: nominal, this project [m]."""
    span = arm.span_of(i)
    links = arm.links[span]
    size = float(sum(math.hypot(k.a, k.d) for k in links))
    return _THICKNESS * size * (1 - _TAPER * (i - span.start) / len(links))


class Proximity(NamedTuple):
    """Pairs of shapes near each other at one configuration."""

    distance: Array  # (k,) m, negative where they overlap
    slope: Array  # (k, n) its derivative by the joint angles [m/rad]


class Collisions:
    """MuJoCo's collision detection on one system and its surroundings."""

    def __init__(self, system: System, surroundings: Surroundings) -> None:
        from ves_gym._util.mujoco_loader import mujoco
        from ves_gym.engine.mjcf import TO_Y

        self._mujoco, self._base = mujoco, TO_Y
        self.clearance, self.n = surroundings.clearance, system.arm.n
        self.model = _model(system, surroundings)
        self._geared = _geared(system.arm)
        self.data = mujoco.MjData(self.model)
        self._tested: float | None = None

    def _detect(self, q: Array, within: float) -> Any:
        """Contacts of shapes nearer than `within` [m]; some further ones among them."""
        if within != self._tested:
            self.model.geom_margin[:] = self.model.body_margin[:] = self._tested = within
        self.data.qpos[6:] = q if self._geared is None else self._geared @ q
        self._mujoco.mj_kinematics(self.model, self.data)
        self._mujoco.mj_collision(self.model, self.data)
        return self.data.contact

    def is_clear(self, q: Array) -> bool:
        """True if a configuration (n,) [rad] respects the clearance."""
        contacts = self._detect(q, self.clearance)
        return self.data.ncon == 0 or bool((contacts.dist >= self.clearance).all())

    def touching(self, q: Array, y: Array) -> list[str]:
        """Pairs of shapes that overlap at q (n,), by name, the base displaced by y (6,)."""
        self.data.qpos[self._base] = y
        try:
            return self._nearer(q, 0.0)
        finally:
            self.data.qpos[:6] = 0.0

    def first_contact(self, path: npt.ArrayLike) -> int | None:
        """Index of the first configuration of (N, n) nearer than the clearance, or None."""
        points = enumerate(np.asarray(path, float))
        return next((k for k, q in points if not self.is_clear(q)), None)

    def contact_names(self, q: npt.ArrayLike) -> list[str]:
        """Pairs of shapes nearer than the clearance at a configuration (n,) [rad], by name."""
        return self._nearer(np.asarray(q, float), self.clearance)

    def _nearer(self, q: Array, distance: float) -> list[str]:
        contacts = self._detect(q, distance)
        if self.data.ncon == 0:  # the usual answer, without NumPy
            return []
        pairs = contacts.geom[contacts.dist < distance]
        return sorted({" and ".join(self.model.geom(g).name for g in pair) for pair in pairs})

    def proximity(self, q: Array, within: float) -> Proximity:
        """Return the pairs of shapes nearer than `within` [m], and how their distances change.

        Distances are those of MuJoCo's geometry; where one shape is deep inside another its
        distance may stay the same, and the slope only points the way out.
        """
        mj, model, data = self._mujoco, self.model, self.data
        contacts = self._detect(q, within)
        if data.ncon == 0:
            return Proximity(np.zeros(0), np.zeros((0, self.n)))
        pairs = sorted({(int(a), int(b)) for a, b in contacts.geom})
        mj.mj_comPos(model, data)
        distance, slope = np.empty(len(pairs)), np.zeros((len(pairs), self.n))
        ends, jacobian = np.empty(6), np.empty((3, model.nv))
        for k, (first, second) in enumerate(pairs):
            distance[k] = mj.mj_geomDistance(model, data, first, second, within, ends)
            if distance[k] == 0.0:
                continue  # touching just so: the shapes have no direction apart
            normal = (ends[3:] - ends[:3]) / distance[k]
            for sign, geom, point in ((-1.0, first, ends[:3]), (1.0, second, ends[3:])):
                mj.mj_jac(model, data, jacobian, None, point, model.geom_bodyid[geom])
                along = jacobian[:, 6:]
                along = along if self._geared is None else along @ self._geared
                slope[k] += sign * normal @ along
        inside = distance < within
        return Proximity(distance[inside], slope[inside])


@lru_cache(maxsize=8)
def collisions(system: System, surroundings: Surroundings) -> Collisions:
    """Return the checker of an ideal system and its surroundings; the same one for the same.

    Not for several threads at once: they would share its MuJoCo data.
    """
    return Collisions(system, surroundings)


# ---------------------------------------------------------------------------- model


def _model(system: System, surroundings: Surroundings) -> Any:
    """The system's own MuJoCo model with shapes, contacts on."""
    from ves_gym._util.mujoco_loader import mujoco
    from ves_gym.engine.mjcf import build_spec

    arm = system.arm.rigid()
    base = replace(system.base, internal=None, carried=())  # nothing to run into
    spec = build_spec(arm, base, gravity=(0.0,) * 3, integrator="euler", physics_dt=1e-3)
    spec.option.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    r = link_radius(arm, 0)
    _add_arm(spec, arm)
    platform, plate = spec.body("platform"), (0, 0, -_PLATFORM[1])
    under = _AROUND + 1  # meets every link but the first, which stands on it
    _rod(platform, "platform", "CYLINDER", plate, (0, 0, 0), _PLATFORM[0] * r, under)
    for k, capsule in enumerate(arm.base_shape or (), start=1):
        _add_capsule(platform, f"base {k}", capsule, np.eye(3), np.zeros(3), under)
    if system.base.body is not None:
        _add_satellite(spec, system.base.body, under)
    if isinstance(system.vehicle, (Beam, FlexibleBase)):
        nodes = system.vehicle.nodes
        for k, (a, b) in enumerate(itertools.pairwise(() if nodes is None else nodes)):
            radius = system.vehicle.outer_diameter / 2
            _rod(spec.worldbody, f"beam segment {k + 1}", "CAPSULE", a, b, radius, under)
    for k, obstacle in enumerate(surroundings.obstacles):
        name = f"obstacle {k + 1} ({obstacle.kind})"
        if isinstance(obstacle, Sphere):
            _add(spec.worldbody, name, "SPHERE", _AROUND, pos=obstacle.centre,
                 size=[obstacle.radius, 0, 0])  # fmt: skip
        else:
            half = np.array(obstacle.size) / 2
            turn = _quaternion(rotation(np.array([0.0, 0, 0, *obstacle.angles])))
            _add(spec.worldbody, name, "BOX", _AROUND, pos=obstacle.centre, size=half,
                 quat=turn)  # fmt: skip
    for a, b in _too_close(arm):
        spec.add_exclude(bodyname1=f"link_{a + 1}", bodyname2=f"link_{b + 1}")
    if any(link.shape is not None for link in arm.links):
        for body, other in _mostly_overlapping(spec.compile(), arm):
            spec.add_exclude(bodyname1=body, bodyname2=other)
    return spec.compile()


def _mostly_overlapping(model: Any, arm: Arm) -> list[tuple[str, str]]:
    """Bodies of the arm that overlap in most configurations: capsules hold shapes loosely."""
    from ves_gym._util.mujoco_loader import mujoco

    data, counts = mujoco.MjData(model), Counter[tuple[str, str]]()
    robot, geared = {"platform", *(part.body for part in arm.parts)}, _geared(arm)
    drawn = drawn_configurations(arm)
    for q in drawn:
        data.qpos[:] = 0.0
        data.qpos[6 : 6 + len(arm.parts)] = q if geared is None else geared @ q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        bodies = model.geom_bodyid[data.contact.geom[data.contact.dist < 0]]
        pairs = {tuple(sorted(pair)) for pair in bodies.tolist()}
        names = [tuple(model.body(k).name for k in pair) for pair in pairs]
        counts.update((a, b) for a, b in names if a in robot and b in robot)
    return [pair for pair, count in counts.items() if 2 * count > len(drawn)]


def _add_arm(spec: Any, arm: Arm) -> None:
    """Capsules along every link, and the tool."""
    parts = arm.parts
    if len(parts) >= _AROUND:
        raise ParameterError(f"collisions know {_AROUND - 1} links, got {len(parts)}")
    for i, (link, name, _, on, *_) in enumerate(parts):
        body, r = spec.body(name), link_radius(arm, min(i, arm.n - 1))
        # meets what surrounds it and every link before it but its neighbours
        affinity = (1 << _AROUND) | ((1 << (_AROUND + 1)) if on >= 0 else 0)
        near = {on, *(j for j in range(i) if on >= 0 and parts[j].on == on)}
        affinity |= sum(1 << j for j in range(i) if j not in near)
        if link.shape is not None:
            R, p = link.far_end
            for k, capsule in enumerate(link.shape):
                name = _named(arm, i) + "'" * k
                _add_capsule(body, name, capsule, R, p, i, affinity)
            continue
        knee, end = (0.0, 0.0, link.d), (link.a, 0.0, link.d)
        rods = [((0.0, 0.0, 0.0), knee)] if abs(link.d) > 1e-6 else []
        rods += [(knee, end)] if abs(link.a) > 1e-6 else []
        for k, (a, b) in enumerate(rods):
            _rod(body, _named(arm, i) + "'" * k, "CAPSULE", a, b, r, i, affinity)
        if parts[i] is arm.ordered[-1]:
            _add(body, "tool", "SPHERE", i, affinity, pos=end, size=[1.1 * r, 0, 0])


def _named(arm: Arm, i: int) -> str:
    """A part's name in messages: its link's number, or its joint's name if that follows."""
    part = arm.parts[i]
    if part.ratios is None:
        return part.body.replace("_", " ")
    return part.link.name or part.body.replace("_", " ")


def _geared(arm: Arm) -> Array | None:
    """The engine's joints per driven joint (all, n), in its order; None: they are these."""
    from ves_gym.engine.mjcf import places

    if not arm.followers:
        return None
    motors, _, followers = places(arm)
    out = np.zeros((len(arm.parts), arm.n))
    out[motors - 6] = np.eye(arm.n)
    out[followers - 6] = [follower.ratios for follower in arm.followers]
    return out


def _add_capsule(
    body: Any, name: str, capsule: Capsule, R: Array, p: Array, bit: int, affinity: int = 0
) -> None:
    """A capsule whose frame is turned by R (3, 3) and moved by p (3,) in the body's."""
    a, b = (p + R @ np.array(k) for k in (capsule.start, capsule.end))
    if np.array_equal(a, b):
        _add(body, name, "SPHERE", bit, affinity, pos=a, size=[capsule.radius, 0, 0])
    else:
        _rod(body, name, "CAPSULE", a, b, capsule.radius, bit, affinity)


def _too_close(arm: Arm) -> list[tuple[int, int]]:
    """Links not next to each other, with too little between them to ever be apart."""
    slim = [i for i, link in enumerate(arm.links) if link.shape is None]
    return [  # of links with a shape see _mostly_overlapping
        (i, j)
        for i, j in itertools.combinations(slim, 2)
        if j > i + 1
        and arm.span_of(i) == arm.span_of(j)
        and sum(math.hypot(k.a, k.d) for k in arm.links[i + 1 : j])
        <= link_radius(arm, i) + link_radius(arm, j)
    ]


def _add_satellite(spec: Any, body: Any, bit: int) -> None:
    """The homogeneous box with the satellite's inertia."""
    half, axes = body.box()
    turn = _quaternion(axes)
    _add(spec.body("satellite"), "satellite", "BOX", bit, pos=body.com, size=half, quat=turn)


def _rod(
    body: Any, name: str, kind: str, a: Any, b: Any, radius: float, bit: int, affinity: int = 0
) -> None:
    ends = [float(k) for k in (*a, *b)]
    _add(body, name, kind, bit, affinity, size=[radius, 0, 0], fromto=ends)


def _add(body: Any, name: str, kind: str, bit: int, affinity: int = 0, **shape: Any) -> None:
    """A shape of no mass that meets shapes with its bit among their affinities."""
    from ves_gym._util.mujoco_loader import mujoco

    options = {key: [float(k) for k in value] for key, value in shape.items()}
    body.add_geom(
        name=name,
        type=getattr(mujoco.mjtGeom, f"mjGEOM_{kind}"),
        contype=1 << bit,
        conaffinity=affinity,
        mass=0,
        **options,
    )


def _quaternion(turn: Array) -> Array:
    """MuJoCo's of a rotation matrix (3, 3)."""
    from ves_gym._util.mujoco_loader import mujoco

    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, turn.flatten())
    return quat
