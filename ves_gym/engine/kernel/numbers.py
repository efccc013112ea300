"""The numbers of a system in a fixed order: as values, or as symbols of the equations.

A number of the system that is zero stays zero and vanishes from the graph; every other one is
a parameter, so that systems that differ in values share one graph and one compiled kernel.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

from ves_gym._util.params import Array
from ves_gym.engine.kernel.symbolic import Traced, column, expressions, symbols, traced
from ves_gym.mechanics.arm_arrays import (
    STILL,
    Chain,
    JointCoupling,
    JointFrame,
    LinkBodies,
    Root,
)
from ves_gym.mechanics.carried import ReactionWheel
from ves_gym.mechanics.contact import ContactModel, Law
from ves_gym.mechanics.dynamics import merged
from ves_gym.mechanics.equations import InnerModes, Model, Springs
from ves_gym.mechanics.flexure import expand
from ves_gym.mechanics.orbit import Tide
from ves_gym.mechanics.vehicle import has_jets, orbit_of
from ves_gym.system.effect import TorqueEffect

if TYPE_CHECKING:
    import casadi

    from ves_gym.mechanics.arm import Arm
    from ves_gym.mechanics.vehicle import Carried, InternalModes
    from ves_gym.system.system import System

Number = Any  # a value, or a CasADi symbol
Body = tuple[Array, Array, Array]  # mass, centre of mass (3,), inertia about it (3, 3)


class _Reader:
    """Reads a system's numbers one by one, as values or as symbols.

    Args:
        make: (name, value) -> the number.
        array: (numbers row by row, shape) -> array.
        zeros: numbers that are zero may become others, and are made as well.
    """

    def __init__(
        self,
        make: Callable[[str, float], Number],
        array: Callable[[list[Number], tuple[int, ...]], Array],
        zeros: bool = False,
    ) -> None:
        self.make, self.array, self.zeros = make, array, zeros

    def __call__(self, name: str, value: float) -> Number:
        left_out = value == 0 and not self.zeros
        return float(value) if left_out else self.make(name, float(value))

    def number(self, name: str, value: float) -> Array:
        """One number, ()."""
        return self.array([self(name, value)], ())

    def vector(self, name: str, values: Sequence[float] | Array) -> Array:
        """Numbers name1, name2 and so on."""
        return self.array(
            [self(f"{name}{i}", k) for i, k in enumerate(values, 1)], (len(values),)
        )

    def always(self, name: str, values: Sequence[float]) -> Array:
        """The same, of numbers that may be set at any time and are never structural zeros."""
        numbers = [self.make(f"{name}{i}", k) for i, k in enumerate(values, 1)]
        return self.array(numbers, (len(values),))

    def matrix(self, name: str, values: Array) -> Array:
        """A symmetric matrix: its entries on and above the diagonal."""
        size = len(values)
        rows: list[list[Number]] = [[0.0] * size for _ in range(size)]
        for i in range(size):
            for j in range(i, size):
                rows[i][j] = rows[j][i] = self(f"{name}{i + 1}{j + 1}", values[i][j])
        return self.array([k for row in rows for k in row], (size, size))

    def body(self, name: str, body: Any, changing: bool = False) -> Body:
        """Mass properties; of a body that changes in a run no number is left out."""
        read = _Reader(self.make, self.array, zeros=True) if changing else self
        return (
            read.number(f"{name}.mass", body.mass),
            read.vector(f"{name}.com", body.com),
            read.matrix(f"{name}.I", np.array(body.inertia)),
        )

    def effect(self, name: str, effect: TorqueEffect) -> dict[str, Array]:
        """Parameters of an effect."""
        out: dict[str, Array] = {}
        for field in dataclasses.fields(effect):  # type: ignore[arg-type]
            value, label = getattr(effect, field.name), f"{name}.{field.name}"
            many = isinstance(value, tuple)
            out[field.name] = self.vector(label, value) if many else self.number(label, value)
        return out

    def modes(self, internal: InternalModes) -> InnerModes:
        """Inner modes of the base."""
        coupling = [
            self(f"coupling{k}.{i}", c)
            for k, column in enumerate(internal.coupling.T, start=1)
            for i, c in enumerate(column, start=1)
        ]
        return InnerModes(
            self.array(coupling, internal.coupling.shape[::-1]).T,
            self.vector("internal_stiffness", internal.omega**2),
            self.matrix("internal_damping.", internal.damping),
        )

    def carried(self, name: str, part: Carried) -> Any:
        """A wheel or an appendage; axes and places are structure."""
        shape = {"kind": part.kind, "axis": part.axis}
        if isinstance(part, ReactionWheel):
            return SimpleNamespace(
                **shape,
                inertia=self.number(f"{name}.inertia", part.inertia),
                viscous=self.number(f"{name}.viscous", part.viscous),
                motor=self.array([self.make(f"motor{name}", 0.0)], ()),  # set at any time
            )
        mass, com, inertia = self.body(name, part.body)
        return SimpleNamespace(
            **shape,
            joint=part.joint,
            point=part.point,
            body=SimpleNamespace(mass=mass, com=com, inertia=inertia),
            stiffness=self.number(f"{name}.stiffness", part.stiffness),
            damping=self.number(f"{name}.damping", part.damping),
        )


def _read(system: System, read: _Reader) -> Model:
    """Walk through the numbers of a system; the order of the walk is the order of p."""
    arm, base, n = system.arm, system.base, system.arm.n
    prescribed, ideal = system.drive == "prescribed", system.mode == "ideal"
    links, rotors = [], []
    for part in arm.ordered:
        name = part.body.replace("_", "")
        changes = system.payload is not None and name == f"link{n}"
        links.append(read.body(name, part.link.inertial, changes))
        rotors.append(read.number(f"{name}.rotor", part.link.rotor_inertia))
    arm_base = read.body("base", arm.base)
    flexible, flexures = _flexible(system, read, rotors)
    satellite = base.body if ideal else None
    host = (
        arm_base if satellite is None else merged([arm_base, read.body("satellite", satellite)])
    )
    zero = np.zeros((6, 6))
    M, D, K = (
        read.matrix(name, part if ideal else zero)
        for name, part in (("M", base.M), ("D", base.D), ("K", base.K))
    )
    drag = read.vector("drag", base.drag if ideal and base.drag is not None else np.zeros(6))
    limits = [np.inf if prescribed else link.tau_max for link in arm.links]
    gains = [
        read.always("kp", [0.0] * n),
        read.always("kd", [0.0] * n),
        read.always("limit", limits),
    ]
    laws = [
        (effect, read.effect(f"{effect.kind}#{i}", effect))
        for i, effect in enumerate(system.effects, start=1)
        if isinstance(effect, TorqueEffect)
    ]
    gears = [(f"gear{i + 1}", arm.links[i].gear) for i in arm.geared]
    springs = [
        *([read(f"{name}.{k}", getattr(gear, k)) for k in _SPRING] for name, gear in gears),
        *flexures,
    ]
    rows = read.array([k for row in springs for k in row], (len(springs), 3))
    loose = [k for k, (_, gear) in enumerate(gears) if getattr(gear, "gap", 0.0)]
    modes = read.modes(base.internal) if ideal and base.internal is not None else None
    carried = tuple(
        read.carried(f"carried{i}", part)
        for i, part in enumerate(base.carried if ideal else (), start=1)
    )
    jets = ideal and has_jets(system.vehicle)
    every = list(range(len(links)))
    rigid = _Joints(arm.joints, arm.roots, host, links, rotors, every, arm.coupling)
    places = rigid if flexible is None else flexible
    chain, driven, passive = places.unfolded(set(arm.geared))
    return Model(
        alone=replace(rigid, base=arm_base).chain(),
        arm=rigid.chain(),
        chain=chain,
        driven=driven[:n],
        passive=passive,
        bends=len(flexures),
        springs=Springs(rows[:, 0], rows[:, 1], rows[:, 2], loose),
        M=M,
        D=D,
        K=K,
        drag=drag,
        kp=gains[0],
        kd=gains[1],
        limit=gains[2],
        prescribed=prescribed,
        laws=tuple(
            effect.bound({**values, "tau_max": gains[2]}).law
            for effect, values in laws
            if not _vanishes(effect, values)
        ),
        modes=modes,
        carried=carried,
        jets=read.always("jet", [0.0] * 6) if jets else None,
        emulated=not ideal,
        balanced=not ideal and system.emulator_settings.joint_balance,
        contact=_contact(system, read),
        tide=_tide(system, read),
    )


def _contact(system: System, read: _Reader) -> ContactModel | None:
    """Law of the contact, and what is touched; shapes are structure."""
    contact, frame, body = system.contact, None, None
    touching: Array | float = 1.0
    if contact is None:
        return None
    names = ("stiffness", "damping", "friction", "tangential_damping")
    law = Law(*(read.number(f"contact.{k}", getattr(contact, k)) for k in names))
    if contact.on == "space":
        turn = read.always("frame.turn", np.eye(3).ravel().tolist()).reshape(3, 3)
        frame = read.always("frame.place", [0.0] * 3), turn
    if contact.on == "payload":
        assert system.payload is not None
        body = read.body("payload", system.payload.inertial, changing=True)
        touching = read.always("touching", [1.0])[0]
    return ContactModel(contact, law, system.arm.tool_rotation, frame, body, touching)


def _tide(system: System, read: _Reader) -> Tide | None:
    """Gravity gradient where the engine begins: its direction is set from time to time."""
    orbit = orbit_of(system.vehicle)
    if orbit is None or system.mode == "emulated":
        return None
    up, place = read.always("tide.up", orbit.radial), read.always("tide.place", [0.0] * 3)
    return Tide(read.number("mean_motion", orbit.rate), up, place)


_SPRING = ("stiffness", "damping", "gap")


@dataclasses.dataclass(frozen=True)
class _Joints:
    """The joints of an arm and what they carry, from which a chain is made."""

    joints: Sequence[JointFrame]
    roots: Sequence[Root]
    base: Body
    links: Sequence[Body]
    rotors: Sequence[Array]
    driven: list[int]  # places of the n joints, of followers too
    coupling: JointCoupling | None = None

    def chain(self) -> Chain:
        """They as they are."""
        bodies = [self.base, *self.links]
        mass, com, inertia = (np.stack([body[k] for body in bodies]) for k in range(3))
        numbers = LinkBodies(mass, com, inertia, np.stack(self.rotors))
        return Chain(tuple(self.joints), tuple(self.roots), numbers, self.coupling)

    def unfolded(self, geared: set[int]) -> tuple[Chain, list[int], list[int]]:
        """The chain with a joint for each gear, after its rotor; places of the n joints, and
        of the springs: gears, then flexures."""
        nothing, still = (np.zeros(()), np.zeros(3), np.zeros((3, 3))), np.zeros(())
        rows: list[tuple[JointFrame, Body, Array]] = []
        driven: list[int] = []
        gears: list[int] = []
        flexures: list[int] = []
        places: list[int] = []
        for place, (joint, link, rotor) in enumerate(
            zip(self.joints, self.links, self.rotors, strict=True)
        ):
            places.append(len(rows))
            if place not in self.driven:
                flexures.append(len(rows))
            elif len(driven) in geared:
                driven.append(len(rows))
                gears.append(len(rows) + 1)
                rows.append((STILL, nothing, rotor))
                rotor = still
            else:
                driven.append(len(rows))
            rows.append((joint, link, rotor))
        joints, links, rotors = zip(*rows, strict=True)
        roots = [root._replace(first=places[root.first]) for root in self.roots]
        expanded = replace(self, joints=joints, roots=roots, links=links, rotors=rotors)
        return expanded.chain(), driven, [*gears, *flexures]


def _flexible(
    system: System, read: _Reader, rotors: list[Array]
) -> tuple[_Joints | None, list[list[Number]]]:
    """All joints of an arm whose links bend, and numbers of its flexures."""
    if not system.arm.bends:
        return None, []
    expanded = expand(system.arm)
    links = [
        read.body(f"part{k}", link.inertial) for k, link in enumerate(expanded.arm.links, 1)
    ]
    base = read.body("root", expanded.arm.base)
    satellite = system.base.body if system.mode == "ideal" else None
    if satellite is not None:
        base = merged([base, read.body("host", satellite)])
    springs = enumerate(zip(expanded.stiffness, expanded.damping, strict=True), start=1)
    numbers = [
        [read(f"flexure{k}.stiffness", float(a)), read(f"flexure{k}.damping", float(b)), 0.0]
        for k, (a, b) in springs
    ]
    by_place = dict(zip(expanded.driven, rotors, strict=True))
    behind = [by_place.get(k, np.zeros(())) for k in range(expanded.arm.n)]
    joints = expanded.arm.joints, expanded.arm.roots
    return _Joints(*joints, base, links, behind, list(expanded.driven)), numbers


def _vanishes(effect: TorqueEffect, values: dict[str, Array]) -> bool:
    """True if every number that makes the effect act is a structural zero."""
    for field in dataclasses.fields(effect):  # type: ignore[arg-type]
        null = field.metadata["null"]
        if null is not None and (
            null != 0 or any(not _is_zero(k) for k in expressions(values[field.name]))
        ):
            return False
    return True


def _is_zero(value: Any) -> bool:
    return isinstance(value, float) and value == 0.0


def parameters(system: System) -> tuple[tuple[str, ...], Array]:
    """Names and values of p for a system."""
    names, values = _parameters(system)
    return names, values.copy()


@lru_cache(maxsize=256)
def _parameters(system: System) -> tuple[tuple[str, ...], Array]:
    names: list[str] = []
    values: list[float] = []

    def make(name: str, value: float) -> float:
        names.append(name)
        values.append(value)
        return value

    _read(system, _Reader(make, _values))
    return tuple(names), np.array(values, dtype=np.float64)


def _values(entries: list[Number], shape: tuple[int, ...]) -> Array:
    return np.array(entries, dtype=np.float64).reshape(shape)


def model_of(system: System) -> Model:
    """A system's numbers as the equations of motion take them; gains are those of no servo."""
    return _read(system, _Reader(lambda name, value: value, _values))


def symbolic_model(system: System) -> tuple[Model, tuple[str, ...], Traced]:
    """The model with a symbol for each of `parameters(system)`; their names, and themselves."""
    import casadi as ca

    symbols_of_p: list[Any] = []

    def make(name: str, value: float) -> Any:
        symbols_of_p.append(ca.SX.sym(name))
        return symbols_of_p[-1]

    model = _read(system, _Reader(make, traced))
    return (
        model,
        tuple(str(k) for k in symbols_of_p),
        traced(symbols_of_p, (len(symbols_of_p),)),
    )


def structure(system: System) -> str:
    """Describe what a system's compiled code depends on: all but the values of its numbers.

    Effects of the package are distinguished by their classes, a user's by their formulas.
    """
    effects = [type(e) for e in system.effects if isinstance(e, TorqueEffect)]
    if all(is_ours(kind) for kind in effects):
        return _described(system)
    formulas = hashlib.sha256(laws(system).serialize().encode()).hexdigest()
    return f"{_described(system)} {formulas}"


def is_ours(kind: type) -> bool:
    """True if the text of a class is the package's, so that it cannot change unseen."""
    return kind.__module__.startswith("ves_gym.") and "<locals>" not in kind.__qualname__


@lru_cache(maxsize=256)
def _described(system: System) -> str:
    names, _ = parameters(system)
    step = system.physics_dt if system.integrator == "implicitfast" else None
    balance = system.mode == "emulated" and system.emulator_settings.joint_balance
    kinds = [type(e).__qualname__ for e in system.effects if isinstance(e, TorqueEffect)]
    how = system.mode, system.drive, system.integrator, step, balance
    what: tuple[Any, ...] = (names, kinds, *how)
    if system.base.carried:
        what = (*what, [replaced(part) for part in system.base.carried])
    if system.contact is not None:
        shapes = system.contact.on, system.contact.tool, system.contact.target
        what = (*what, system.arm.tool_rotation.tolist(), shapes)
    return f"{geometry(system.arm)} {what!r}"


def replaced(part: Carried) -> tuple[Any, ...]:
    """Return what of a wheel or an appendage is no number: its kind, axis and place."""
    joint = getattr(part, "joint", None), getattr(part, "point", None)
    return part.kind, part.axis, *joint


def geometry(arm: Arm) -> str:
    """Describe an arm's lengths and angles: its code depends on no weight."""
    lengths: list[Any] = [(k.d, k.a, k.alpha, k.beta, k.offset) for k in arm.links]
    if arm.sliding:
        lengths.append(arm.sliding)
    if arm.beside:
        lengths.append([(limb.joints, limb.mount) for limb in arm.beside])
    if arm.followers:
        lengths += [(arm.joints, arm.coupling, [(k.first, k.on) for k in arm.roots])]
        lengths += [(k.rotation.tolist(), k.position.tolist()) for k in arm.roots]
    if arm.bends:
        chain = expand(arm)
        lengths += [(k.d, k.a, k.alpha, k.beta, k.offset) for k in chain.arm.links]
        return f"{arm.mount!r} {chain.arm.mount!r} {chain.driven!r} {lengths!r}"
    return f"{arm.mount!r} {lengths!r}"


def laws(system: System) -> casadi.Function:
    """(q, v, motor torque, p) -> torque of the effects' laws (`effect.joint_torque`)."""
    import casadi as ca

    model, _, p = symbolic_model(system)
    q, v, tau = (symbols(name, (system.arm.n,)) for name in ("q", "v", "tau"))
    torque = sum(law(q, v, tau) for law in model.laws) + 0.0 * q
    return ca.Function("laws", [column(k) for k in (q, v, tau, p)], [column(torque)])
