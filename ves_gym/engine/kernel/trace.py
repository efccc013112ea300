"""The equations of motion as one symbolic graph: what the kernel and its derivatives compile.

The physics is the text of `mechanics/dynamics.py`, traced with CasADi symbols. A number of the
system that is zero stays zero and vanishes from the graph; every other one is an input, so
that systems that differ in values share one graph and one compiled kernel.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym.engine.kernel.carried import body_fixed, with_carried
from ves_gym.engine.kernel.mechanics import (
    Expression,
    Model,
    balance_of_forces,
    base_energy,
    drive_torque,
    gear_torque,
    in_space,
    interleaved,
    internal_forces,
    is_zero,
    on_platform,
    one_base,
    pairs,
    residual,
    separated,
    solve,
    sum_of,
    times,
    unfolded,
)
from ves_gym.mechanics.dynamics import ZERO, inertia_entries, newton_euler
from ves_gym.mechanics.flexure import unfold
from ves_gym.mechanics.vehicle import blows
from ves_gym.system.effect import TorqueEffect
from ves_gym.system.system import PRESCRIBED_INERTIA

if TYPE_CHECKING:
    import casadi

    from ves_gym.mechanics.arm import Arm
    from ves_gym.mechanics.vehicle import Carried, InternalModes
    from ves_gym.system.effect import Effect
    from ves_gym.system.system import System


@dataclass(frozen=True)
class Equations:
    """Graphs of one system's structure: state x = (Y, q, Y', q'), input u, parameters p.

    u is (force on Y or, in mode emulated, platform acceleration Y''; joint commands).
    """

    n: int  # joints
    names: tuple[str, ...]  # of p
    motion: casadi.Function  # (x, u, p) -> x'; x with what is hidden: (z, h, z', h')
    observe: casadi.Function  # (x, u, p) -> x', (z'', drive torque, wrench if emulated)
    hidden: int = 0  # coordinates h: deflections of gears, internal modes of the base


class _Numbers:
    """Reads a system's numbers in a fixed order, as values or as symbols."""

    def __init__(self, make: Callable[[str, float], Expression], zeros: bool = False) -> None:
        self.make, self.zeros = make, zeros  # zeros: they may become other numbers

    def __call__(self, name: str, value: float) -> Expression:
        left_out = value == 0 and not self.zeros
        return float(value) if left_out else self.make(name, float(value))

    def matrix(self, name: str, values: Array) -> list[list[Expression]]:
        size = len(values)
        out: list[list[Expression]] = [[0.0] * size for _ in range(size)]
        for i in range(size):
            for j in range(i, size):
                out[i][j] = out[j][i] = self(f"{name}{i + 1}{j + 1}", values[i][j])
        return out

    def effect(self, name: str, effect: Effect) -> dict[str, Any]:
        out: dict[str, Any] = {}
        for field in dataclasses.fields(effect):  # type: ignore[arg-type]
            value, label = getattr(effect, field.name), f"{name}.{field.name}"
            if isinstance(value, tuple):
                out[field.name] = [self(f"{label}{i + 1}", k) for i, k in enumerate(value)]
            else:
                out[field.name] = self(label, value)
        return out

    def gear(self, name: str, gear: Any) -> Any:
        return SimpleNamespace(
            stiffness=self(f"{name}.stiffness", gear.stiffness),
            damping=self(f"{name}.damping", gear.damping),
            gap=self(f"{name}.gap", gear.gap),
        )

    def modes(self, internal: InternalModes) -> Any:
        coupling = [
            [self(f"coupling{k + 1}.{i + 1}", c) for i, c in enumerate(column)]
            for k, column in enumerate(internal.coupling.T)
        ]
        return SimpleNamespace(
            coupling=coupling,
            stiffness=[
                self(f"internal_stiffness{k + 1}", w * w) for k, w in enumerate(internal.omega)
            ],
            damping=self.matrix("internal_damping.", internal.damping),
        )

    def carried(self, name: str, part: Any) -> Any:
        """A wheel or an appendage, symbols for its numbers; axes are structure."""
        shape = {"kind": part.kind, "axis": part.axis}
        if part.kind == "wheel":
            return SimpleNamespace(
                **shape,
                inertia=self(f"{name}.inertia", part.inertia),
                viscous=self(f"{name}.viscous", part.viscous),
                motor=self.make(f"motor{name}", 0.0),  # set at any time, as gains are
            )
        return SimpleNamespace(
            **shape,
            joint=part.joint,
            point=part.point,
            body=self.inertial(name, part.body),
            stiffness=self(f"{name}.stiffness", part.stiffness),
            damping=self(f"{name}.damping", part.damping),
        )

    def inertial(self, name: str, body: Any, changing: bool = False) -> Any:
        """Mass properties; of a body that changes in a run no number is left out."""
        read = _Numbers(self.make, zeros=True) if changing else self
        return SimpleNamespace(
            mass=read(f"{name}.mass", body.mass),
            com=tuple(read(f"{name}.com{k + 1}", body.com[k]) for k in range(3)),
            inertia=read.matrix(f"{name}.I", np.array(body.inertia)),
        )


def _model(system: System, read: _Numbers) -> Model:
    """Walk through the numbers of a system; the order of the walk is the order of p."""
    arm, base = system.arm, system.base
    prescribed = system.drive == "prescribed"
    links = [
        _link(
            link,
            read.inertial(
                f"link{i + 1}",
                link.inertial,
                changing=system.payload is not None and i == arm.n - 1,
            ),
            read(
                f"link{i + 1}.rotor",
                link.rotor_inertia + (PRESCRIBED_INERTIA if prescribed else 0.0),
            ),
        )
        for i, link in enumerate(arm.links)
    ]
    body = read.inertial("base", arm.base)
    bending = _bending(system, read, links) if arm.bends else {}
    ideal = system.mode == "ideal"
    zero = np.zeros((6, 6))
    drag = base.drag if ideal and base.drag is not None else np.zeros(6)
    if ideal and base.body is not None:
        body = (body, read.inertial("satellite", base.body))
    every = range(arm.n)
    return Model(
        arm=SimpleNamespace(n=arm.n, links=links, base=body, mount=arm.mount),
        M=read.matrix("M", base.M if ideal else zero),
        D=read.matrix("D", base.D if ideal else zero),
        K=read.matrix("K", base.K if ideal else zero),
        drag=[read(f"drag{i + 1}", c) for i, c in enumerate(drag)],
        # gains may be set at any time and are never structural zeros
        kp=[read.make(f"kp{i + 1}", 0.0) for i in every],
        kd=[read.make(f"kd{i + 1}", 0.0) for i in every],
        limit=[
            read.make(f"limit{i + 1}", np.inf if prescribed else arm.links[i].tau_max)
            for i in every
        ],
        gain=[
            read.make(f"gain{i + 1}", PRESCRIBED_INERTIA if prescribed else 1.0) for i in every
        ],
        laws=[
            (effect, read.effect(f"{effect.kind}#{i + 1}", effect))
            for i, effect in enumerate(system.effects)
            if isinstance(effect, TorqueEffect)
        ],
        gears={i: read.gear(f"gear{i + 1}", arm.links[i].gear) for i in arm.geared},
        internal=read.modes(base.internal) if ideal and base.internal is not None else None,
        carried=[
            read.carried(f"carried{i + 1}", part)
            for i, part in enumerate(base.carried if ideal else ())
        ],
        jets=[
            read.make(f"jet{i + 1}", 0.0)
            for i in range(6 if ideal and blows(system.vehicle) else 0)
        ],
        **bending,
    )


def _bending(system: System, read: _Numbers, rigid: list[Any]) -> dict[str, Any]:
    """The whole chain of an arm whose links bend, and its springs."""
    chain = unfold(system.arm)
    rotors = {
        place: link.rotor_inertia for place, link in zip(chain.driven, rigid, strict=True)
    }
    links = [
        _link(link, read.inertial(f"part{k + 1}", link.inertial), rotors.get(k, 0.0))
        for k, link in enumerate(chain.arm.links)
    ]
    body = read.inertial("root", chain.arm.base)
    satellite = system.base.body if system.mode == "ideal" else None
    if satellite is not None:
        body = (body, read.inertial("host", satellite))
    springs = enumerate(zip(chain.stiffness, chain.damping, strict=True), start=1)
    return {
        "whole": SimpleNamespace(n=chain.arm.n, links=links, base=body, mount=chain.arm.mount),
        "driven": chain.driven,
        "flexures": tuple(
            SimpleNamespace(
                stiffness=read(f"flexure{k}.stiffness", float(stiffness)),
                damping=read(f"flexure{k}.damping", float(damping)),
                gap=0.0,
            )
            for k, (stiffness, damping) in springs
        ),
    }


def _link(link: Any, inertial: Any, rotor_inertia: Expression) -> Any:
    """A link with symbols for its masses; its lengths are part of the structure."""
    return SimpleNamespace(
        d=link.d,
        a=link.a,
        alpha=link.alpha,
        beta=link.beta,
        offset=link.offset,
        slides=link.slides,
        inertial=inertial,
        rotor_inertia=rotor_inertia,
    )


def parameters(system: System) -> tuple[tuple[str, ...], Array]:
    """Names and values of p for a system."""
    names: list[str] = []
    values: list[float] = []

    def make(name: str, value: float) -> float:
        names.append(name)
        values.append(value)
        return value

    _model(system, _Numbers(make))
    return tuple(names), np.array(values, dtype=np.float64)


def structure(system: System) -> str:
    """Return a digest of the graph's shape, on which a system's compiled code depends."""
    names, _ = parameters(system)
    step = system.physics_dt if system.integrator == "implicitfast" else None
    balance = system.mode == "emulated" and system.emulator_settings.joint_balance
    laws = _laws(system) if any(isinstance(e, TorqueEffect) for e in system.effects) else None
    what: tuple[Any, ...] = (names, laws, system.mode, system.integrator, step, balance)
    if system.base.carried:
        what = (*what, [replaced(part) for part in system.base.carried])
    return f"{geometry(system.arm)} {what!r}"


def replaced(part: Carried) -> tuple[Any, ...]:
    """Return what of a wheel or an appendage is no number: its kind, axis and place."""
    joint = getattr(part, "joint", None), getattr(part, "point", None)
    return part.kind, part.axis, *joint


def geometry(arm: Arm) -> str:
    """Return a digest of an arm's lengths and angles: its code depends on no weight."""
    lengths: list[Any] = [(k.d, k.a, k.alpha, k.beta, k.offset) for k in arm.links]
    if arm.sliding:
        lengths.append(arm.sliding)
    if arm.bends:
        chain = unfold(arm)
        lengths += [(k.d, k.a, k.alpha, k.beta, k.offset) for k in chain.arm.links]
        return f"{_source()} {arm.mount!r} {chain.arm.mount!r} {chain.driven!r} {lengths!r}"
    return f"{_source()} {arm.mount!r} {lengths!r}"


def _laws(system: System) -> str:
    """Digest of the graph of the effects' laws, whatever text and constants it came from."""
    import casadi as ca

    model, symbols = _symbols(system)
    q, v, tau = (ca.SX.sym(name, system.arm.n) for name in ("q", "v", "tau"))
    parts = [list(ca.vertsplit(part)) for part in (q, v, tau)]
    torque = ca.vertcat(*model.push(*parts))
    graph = ca.Function("laws", [q, v, tau, ca.vertcat(*symbols)], [torque])
    return hashlib.sha256(graph.serialize().encode()).hexdigest()


@lru_cache(maxsize=1)
def _source() -> str:
    """Digest of the text that writes the code, so that a changed one is compiled anew."""
    from ves_gym.mechanics import carried, dynamics, gravity

    # by name: scene and pieces build on us
    beside = ("trace.py", "emit.py", "mechanics.py", "carried.py", "scene.py", "pieces.py")
    files = [Path(__file__).with_name(name) for name in beside]
    files += [Path(str(module.__file__)) for module in (dynamics, gravity, carried)]
    text = b"".join(path.read_bytes() for path in files)
    return hashlib.sha256(text).hexdigest()


def equations(system: System) -> Equations:
    """Trace the system's equations of motion."""
    import casadi as ca

    n = system.arm.n
    model, symbols = _symbols(system)
    names = [str(k) for k in symbols]
    if model.hidden:
        return _with_hidden(system, model, symbols)
    x, u, p = ca.SX.sym("x", 2 * (6 + n)), ca.SX.sym("u", 6 + n), ca.vertcat(*symbols)
    z, zd = list(ca.vertsplit(x))[: 6 + n], list(ca.vertsplit(x))[6 + n :]
    base, command = list(ca.vertsplit(u))[:6], list(ca.vertsplit(u))[6:]
    base = body_fixed(model, z[:6], base, ca)
    drive, tau = drive_torque(model, z, zd, command, ca)
    joint = [a + b for a, b in zip(tau, model.push(z[6:], zd[6:], tau), strict=True)]

    def accelerations(implicit: list[list[Any]]) -> tuple[list[Any], list[Any]]:
        if system.mode == "emulated":
            balance = system.emulator_settings.joint_balance
            return on_platform(model, z, zd, base, joint, implicit, balance, ca)
        return in_space(model, z, zd, base, joint, implicit, ca), []

    size = 6 + n
    zdd, wrench = accelerations([[0.0] * size for _ in range(size)])  # what is observed
    step = zdd  # what the integrator takes
    if system.integrator == "implicitfast":
        step, _ = accelerations(_implicit(system, model, drive, ca))
    slope, out = ca.vertcat(*zd, *step), ca.vertcat(*zdd, *tau, *wrench)
    return Equations(
        n,
        tuple(names),
        ca.Function("motion", [x, u, p], [ca.cse(slope)]),
        ca.Function("observe", [x, u, p], ca.cse([slope, out])),
    )


def _with_hidden(system: System, model: Model, symbols: list[Any]) -> Equations:
    """The same with passive joints (gears, flexures) and internal modes of the base."""
    import casadi as ca

    if system.integrator == "implicitfast":
        raise ParameterError(
            "backend kernel integrates gears, flexures, wheels, appendages and internal modes"
            " by rk4 or euler, got implicitfast: use backend mujoco"
        )
    n, h, g = system.arm.n, model.hidden, len(model.springs)
    size = 6 + n
    half = size + h
    x, u, p = ca.SX.sym("x", 2 * half), ca.SX.sym("u", size), ca.vertcat(*symbols)
    at, rate = list(ca.vertsplit(x))[:half], list(ca.vertsplit(x))[half:]
    base, command = list(ca.vertsplit(u))[:6], list(ca.vertsplit(u))[6:]
    first = size + g + len(model.carried)
    (z, d, c, s), (zd, dd, cd, sd) = (
        (k[:size], k[size : size + g], k[size + g : first], k[first:]) for k in (at, rate)
    )
    base = body_fixed(model, z[:6], base, ca)
    _, tau = drive_torque(model, z, zd, command, ca)
    laws = model.push(z[6:], zd[6:], tau)
    drives = [a + b for a, b in zip(tau, laws, strict=True)]
    inner = unfolded(model)
    joints = interleaved(model, drives, gear_torque(model, d, dd, ca))
    pose = [*z[:6], *interleaved(model, z[6:], d)]
    moving = [*zd[:6], *interleaved(model, zd[6:], dd)]
    push, sdd = internal_forces(model, z, zd, s, sd)
    loose = [[0.0] * len(pose) for _ in pose]
    wrench: list[Any] = []
    cdd: list[Any] = []
    if system.mode == "emulated":
        balance = system.emulator_settings.joint_balance
        acceleration, wrench = on_platform(
            inner, pose, moving, base, joints, loose, balance, ca
        )
    else:
        jets = [a + b for a, b in zip(base, push, strict=True)]
        if model.carried:
            acceleration, cdd = with_carried(inner, pose, moving, jets, joints, c, cd, ca)
        else:
            acceleration = in_space(inner, pose, moving, jets, joints, loose, ca)
    qdd, ddd = separated(model, acceleration[6:])
    zdd = [*acceleration[:6], *qdd]
    slope = ca.vertcat(*rate, *zdd, *ddd, *cdd, *sdd)
    out = ca.vertcat(*zdd, *tau, *wrench)
    return Equations(
        n,
        tuple(str(k) for k in symbols),
        ca.Function("motion", [x, u, p], [ca.cse(slope)]),
        ca.Function("observe", [x, u, p], ca.cse([slope, out])),
        h,
    )


def _implicit(system: System, model: Model, drive: list[Any], xp: Any) -> list[list[Any]]:
    """Mass the integrator adds for what resists motion: h (D + kd), as MuJoCo's implicitfast.

    A motor at its limit resists no more.
    """
    size, h = 6 + model.arm.n, system.physics_dt
    out: list[list[Any]] = [[0.0] * size for _ in range(size)]
    for i in range(6):
        for j in range(6):
            if not is_zero(model.D[i][j]):
                out[i][j] = h * model.D[i][j]
    for i, (f, most) in enumerate(zip(drive, model.limit, strict=True)):
        out[6 + i][6 + i] = xp.if_else(xp.fabs(f) < most, h * model.kd[i], 0.0)
    return out


@dataclass(frozen=True)
class _Balance:
    """Balance of forces in space, r(x, a, u, p) = M a + bias - loads with a = z''.

    r = 0 gives a(x, u, p), so da = -M^-1 dr with a held in dr: nothing is differentiated
    through the solution of a linear system.
    """

    names: tuple[str, ...]  # of p
    x: Any
    u: Any
    p: Any
    a: Any
    missing: Any  # r
    energy: Any  # of the base [J]
    mass: list[list[Any]]
    solution: list[Any]  # the a of r = 0

    @property
    def width(self) -> int:
        """Number of coordinates: (Y, q), flexures, and the internal modes, whose mass is 1."""
        return len(self.solution)

    def response(self, change: Any) -> list[Any]:
        """da for dr."""
        loads = [-k for k in self.at_solution(change)]
        size = len(self.mass)
        return [*solve(self.mass, loads[:size]), *loads[size:]]

    def at_solution(self, value: Any) -> list[Any]:
        """A value at the acceleration found."""
        import casadi as ca

        return list(ca.vertsplit(ca.substitute(value, self.a, ca.vertcat(*self.solution))))


def _balance(system: System) -> _Balance:
    import casadi as ca

    model, symbols = _symbols(system)
    if model.gears:
        raise ParameterError(
            "derivatives know no gears that give way: use differences of Simulator runs"
        )
    if model.carried:
        raise ParameterError(
            "derivatives know no wheels and appendages: use differences of Simulator runs"
        )
    size, p = 6 + system.arm.n, len(model.flexures)
    width = size + model.hidden  # coordinates: (Y, q), then flexures and internal modes
    x, u, a = (ca.SX.sym(name, k) for name, k in (("x", 2 * width), ("u", size), ("a", width)))
    at, rate = list(ca.vertsplit(x))[:width], list(ca.vertsplit(x))[width:]
    z, zd, s, sd = at[:size], rate[:size], at[size + p :], rate[size + p :]
    d, dd = at[size : size + p], rate[size : size + p]
    base, command = list(ca.vertsplit(u))[:6], list(ca.vertsplit(u))[6:]
    tau = drive_torque(model, z, zd, command, ca)[1]
    tau = [k + law for k, law in zip(tau, model.push(z[6:], zd[6:], tau), strict=True)]
    push, sdd = internal_forces(model, z, zd, s, sd)
    base = [k + more for k, more in zip(base, push, strict=True)]
    chain = unfolded(model)
    tau = interleaved(model, tau, gear_torque(model, d, dd, ca))
    pose, moving = ([*k[:6], *interleaved(model, k[6:], b)] for k, b in ((z, d), (zd, dd)))
    # coordinates as they lie in the state, by their place along the chain
    joints, bends = separated(model, list(range(6, len(pose))))
    order = [*range(6), *joints, *bends]
    mass, loads = balance_of_forces(chain, pose, moving, base, tau, ca)
    mass, loads = [[mass[i][j] for j in order] for i in order], [loads[i] for i in order]
    tried = list(ca.vertsplit(a))
    accelerated = [*tried[:6], *interleaved(model, tried[6:size], tried[size : size + p])]
    balance = residual(chain, pose, moving, accelerated, base, tau, ca)
    missing = [balance[i] for i in order]
    missing += [k - found for k, found in zip(tried[size + p :], sdd, strict=True)]
    return _Balance(
        names=tuple(str(k) for k in symbols),
        x=x,
        u=u,
        p=ca.vertcat(*symbols),
        a=a,
        missing=ca.vertcat(*missing),
        energy=base_energy(model, z, zd, at[size:], rate[size:], ca)[0],
        mass=mass,
        solution=[*solve(mass, loads), *sdd],
    )


def tangents(system: System, wrt: tuple[str, ...], controls: int) -> Equations:
    """Trace motion, base energy and their exact derivatives (mode ideal).

    Directions: one per parameter named in `wrt`, then `controls` directions of the command.
    With m of them the state is (x, e, dx_1, de_1, ..., dx_m, de_m), e the time integral of
    the base energy, and the input (u, du_1, ..., du_controls).

    The balance is differentiated once per direction or, for many, once by the state as a
    vector and then multiplied by each: whichever takes fewer operations.

    Args:
        system: what to simulate.
        wrt: names of parameters.
        controls: number of directions of the command.
    """
    by_column, at_once = (_tangents(system, wrt, controls, k) for k in (False, True))
    return min(by_column, at_once, key=lambda graphs: int(graphs.motion.n_instructions()))


def _tangents(system: System, wrt: tuple[str, ...], controls: int, at_once: bool) -> Equations:
    import casadi as ca

    b, size = _balance(system), 6 + system.arm.n
    width = b.width
    both = ca.vertcat(b.missing, b.energy)
    slope = ca.jacobian(both, b.x) if at_once else None
    states, inputs = [b.x, ca.SX.sym("e")], [b.u]
    slopes = [b.x[width:], *b.solution, b.energy]
    for j in range(len(wrt) + controls):
        dx, du = ca.SX.sym(f"dx{j}", 2 * width), ca.SX.sym(f"du{j}", size)
        if j < len(wrt):
            cause, step = b.p[b.names.index(wrt[j])], ca.SX(1)
        else:
            cause, step = b.u, du
            inputs.append(du)
        if slope is None:
            change = ca.jtimes(both, ca.vertcat(b.x, cause), ca.vertcat(dx, step))
        else:
            change = slope @ dx + ca.jtimes(both, cause, step)
        states += [dx, ca.SX.sym(f"de{j}")]
        slopes += [dx[width:], *b.response(change[:-1]), change[-1]]
    arguments = [ca.vertcat(*states), ca.vertcat(*inputs), b.p]
    motion = ca.cse(ca.vertcat(*slopes))
    return Equations(
        system.arm.n,
        b.names,
        ca.Function("motion", arguments, [motion]),
        ca.Function("observe", arguments, ca.cse([motion, ca.SX(b.energy)])),
    )


def linearisation(system: System) -> casadi.Function:
    """((Y, q, u, command), p) -> z'' at rest, then its derivatives (mode ideal).

    (s,) of z'' and, column after column, (s, 2 s) by the state (Y, q, u and their rates) and
    (s, n) by the command, s = 6 + n + m with m flexures and internal modes of the base.
    """
    import casadi as ca

    b = _balance(system)
    size = b.width
    causes = ca.vertcat(b.x, b.u[6:])
    columns = ca.horzsplit(ca.jacobian(b.missing, causes))
    out = ca.vertcat(*b.solution, *(k for column in columns for k in b.response(column)))
    still = ca.vertcat(b.x[size:], b.u[:6])
    out = ca.substitute(out, still, ca.SX.zeros(size + 6))
    point = ca.vertcat(b.x[:size], b.u[6:])
    return ca.Function("linearisation", [point, b.p], [ca.cse(ca.densify(out))])


def regressor(arm: Arm, moving: bool) -> casadi.Function:
    """Trace wrench on the base and joint torques per inertial parameter, column after column.

    Moving: at (q, v, a, spin, turn, accel) as in `newton_euler`, by ten numbers a body (m, m c,
    inertia about its frame xx xy yy xz yz zz) and the rotor inertias. Otherwise at (q, free
    fall), by the four of a body that weigh. The second argument, p, is empty.

    The balance is linear in these numbers. It is differentiated by (m, c, I_c) at unit masses
    in the origins of their frames, which is the same: m c = c there, and what moves I_c to the
    frame is of second order in c.

    Args:
        arm: lengths and angles.
        moving: see above.
    """
    import casadi as ca

    n = arm.n
    numbers, rotors = [ca.SX.sym(f"body{i}", 10) for i in range(n + 1)], ca.SX.sym("rotor", n)
    bodies = [
        SimpleNamespace(
            mass=k[0],
            com=(k[1], k[2], k[3]),
            inertia=[[k[4], k[5], k[7]], [k[5], k[6], k[8]], [k[7], k[8], k[9]]],
        )
        for k in numbers
    ]
    links = [_link(*k) for k in zip(arm.links, bodies[1:], ca.vertsplit(rotors), strict=True)]
    x = ca.SX.sym("x", 3 * n + 9 if moving else n + 3)
    at: list[Any] = list(ca.vertsplit(x))
    q, v, a = at[:n], [0.0] * n, [0.0] * n
    spin: Any = ZERO
    turn: Any = ZERO
    if moving:
        v, a = at[n : 2 * n], at[2 * n : 3 * n]
        spin, turn = at[3 * n : 3 * n + 3], at[3 * n + 3 : 3 * n + 6]
    accel: Any = at[-3:] if moving else [-k for k in at[-3:]]
    body: Any = SimpleNamespace(n=n, links=links, base=bodies[0], mount=arm.mount)
    torque, force, moment = newton_euler(
        body, q, v, a, spin=spin, turn=turn, accel=accel, xp=ca
    )
    unknowns = ca.vertcat(*numbers, rotors) if moving else ca.vertcat(*(k[:4] for k in numbers))
    load = ca.vertcat(*(-k for k in (*force, *moment)), *torque)
    unit = ca.vertcat(*[1.0, *[0.0] * 9] * (n + 1), ca.SX.zeros(n))
    slope = ca.substitute(ca.jacobian(load, unknowns), ca.vertcat(*numbers, rotors), unit)
    return ca.Function("regressor", [x, ca.SX(0, 1)], [ca.cse(ca.densify(ca.vec(slope)))])


def coupling(system: System) -> casadi.Function:
    """(q, p) -> Q(q), row by row: `planners.coupling.coupling_matrix` as a graph."""
    import casadi as ca

    model, symbols = _symbols(system)
    n, q = system.arm.n, ca.SX.sym("q", system.arm.n)
    H = inertia_entries(one_base(model.arm), list(ca.vertsplit(q)), ca)
    Mt = sum_of(H.base, model.M)
    A = [solve(Mt, row) for row in H.across]  # each the base's motion per joint rate
    KA = [times(_stiffness(model), column) for column in A]
    Q = [sum(a * b for a, b in pairs(A[i], KA[j])) for i in range(n) for j in range(n)]
    return ca.Function("coupling", [q, ca.vertcat(*symbols)], [ca.cse(ca.vertcat(*Q))])


def _stiffness(model: Model) -> list[list[Any]]:
    """K of the base while its internal modes stand still: K + sum_k omega_k^2 P_k P_k^T."""
    K, modes = model.K, model.internal
    if modes is None:
        return K
    springs = list(zip(modes.stiffness, modes.coupling, strict=True))
    stiffened = [
        [sum(w * p[i] * p[j] for w, p in springs if not is_zero(p[i])) for j in range(6)]
        for i in range(6)
    ]
    return sum_of(K, stiffened)


def inertia_matrix(system: System) -> casadi.Function:
    """(q, p) -> H(q) of arm and base link, row by row: `dynamics.inertia` as a graph."""
    import casadi as ca

    model, symbols = _symbols(system)
    n, q = system.arm.n, ca.SX.sym("q", system.arm.n)
    arm = model.arm
    if isinstance(arm.base, tuple):  # the base link alone, without the satellite
        arm = SimpleNamespace(n=n, links=arm.links, base=arm.base[0], mount=arm.mount)
    H = inertia_entries(arm, list(ca.vertsplit(q)), ca)
    rows = [[*H.base[i], *(H.across[j][i] for j in range(n))] for i in range(6)]
    rows += [[*H.across[j], *H.joints[j]] for j in range(n)]
    entries = ca.vertcat(*(k for row in rows for k in row))
    return ca.Function("inertia", [q, ca.vertcat(*symbols)], [ca.cse(entries)])


def _symbols(system: System) -> tuple[Model, list[Any]]:
    """The model with a symbol for each of `parameters(system)`."""
    import casadi as ca

    symbols: list[Any] = []

    def make(name: str, value: float) -> Any:
        symbols.append(ca.SX.sym(name))
        return symbols[-1]

    return _model(system, _Numbers(make)), symbols
