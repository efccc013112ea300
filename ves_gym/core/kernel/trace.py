"""The equations of motion as one symbolic graph: what the kernel and its derivatives compile.

The physics is the text of `core/dynamics.py`, traced with CasADi symbols. A number of the
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

from ves_gym.core.dynamics import inertia_entries
from ves_gym.core.kernel.mechanics import (
    Expression,
    Model,
    balance_of_forces,
    base_energy,
    drive_torque,
    in_space,
    is_zero,
    on_platform,
    one_base,
    pairs,
    residual,
    solve,
    sum_of,
    times,
)
from ves_gym.core.params import Array

if TYPE_CHECKING:
    import casadi

    from ves_gym.core.effect import Effect
    from ves_gym.core.system import System


@dataclass(frozen=True)
class Equations:
    """Graphs of one system's structure: state x = (Y, q, Y', q'), input u, parameters p.

    u is (force on Y or, in mode emulated, platform acceleration Y''; joint commands).
    """

    n: int  # joints
    names: tuple[str, ...]  # of p
    motion: casadi.Function  # (x, u, p) -> x'
    observe: casadi.Function  # (x, u, p) -> x', (z'', drive torque, wrench if emulated)


class _Numbers:
    """Reads a system's numbers in a fixed order, as values or as symbols."""

    def __init__(self, make: Callable[[str, float], Expression]) -> None:
        self.make = make

    def __call__(self, name: str, value: float) -> Expression:
        return float(value) if value == 0 else self.make(name, float(value))

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

    def inertial(self, name: str, body: Any) -> Any:
        return SimpleNamespace(
            mass=self(f"{name}.mass", body.mass),
            com=tuple(self(f"{name}.com{k + 1}", body.com[k]) for k in range(3)),
            inertia=self.matrix(f"{name}.I", np.array(body.inertia)),
        )


def _model(system: System, read: _Numbers) -> Model:
    """Walk through the numbers of a system; the order of the walk is the order of p."""
    from ves_gym.core.model import PRESCRIBED_INERTIA  # brings MuJoCo along

    arm, base = system.arm, system.base
    prescribed = system.drive == "prescribed"
    links = [
        SimpleNamespace(
            d=link.d,  # geometry is part of the structure
            a=link.a,
            alpha=link.alpha,
            offset=link.offset,
            inertial=read.inertial(f"link{i + 1}", link.inertial),
            rotor_inertia=read(
                f"link{i + 1}.rotor",
                link.rotor_inertia + (PRESCRIBED_INERTIA if prescribed else 0.0),
            ),
        )
        for i, link in enumerate(arm.links)
    ]
    body = read.inertial("base", arm.base)
    ideal = system.mode == "ideal"
    zero = np.zeros((6, 6))
    if ideal and base.body is not None:
        body = (body, read.inertial("satellite", base.body))
    every = range(arm.n)
    return Model(
        arm=SimpleNamespace(n=arm.n, links=links, base=body),
        M=read.matrix("M", base.M if ideal else zero),
        D=read.matrix("D", base.D if ideal else zero),
        K=read.matrix("K", base.K if ideal else zero),
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
            if effect.has_law
        ],
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
    """What the compiled code of a system depends on: its graph's shape, not its values."""
    names, _ = parameters(system)
    links = [(k.d, k.a, k.alpha, k.offset) for k in system.arm.links]
    step = system.physics_dt if system.integrator == "implicitfast" else None
    balance = system.mode == "emulated" and system.laboratory.joint_balance
    laws = _laws(system) if any(e.has_law for e in system.effects) else None
    what = (names, links, laws, system.mode, system.integrator, step, balance)
    return f"{_source()} {what!r}"


def _laws(system: System) -> str:
    """Digest of the graph of the effects' laws, whatever text and constants it came from."""
    import casadi as ca

    model, symbols = _symbols(system)
    q, v = (ca.SX.sym(name, system.arm.n) for name in "qv")
    torque = ca.vertcat(*model.push(ca.vertsplit(q), ca.vertsplit(v), ca))
    graph = ca.Function("laws", [q, v, ca.vertcat(*symbols)], [torque])
    return hashlib.sha256(graph.serialize().encode()).hexdigest()


@lru_cache(maxsize=1)
def _source() -> str:
    """Digest of the text that writes the code, so that a changed one is compiled anew."""
    from ves_gym.core import dynamics, gravity
    from ves_gym.core.kernel import emit, mechanics

    files = [__file__, *(str(m.__file__) for m in (dynamics, gravity, emit, mechanics))]
    text = b"".join(Path(name).read_bytes() for name in files)
    return hashlib.sha256(text).hexdigest()


def equations(system: System) -> Equations:
    """Trace the system's equations of motion."""
    import casadi as ca

    n = system.arm.n
    model, symbols = _symbols(system)
    names = [str(k) for k in symbols]
    x, u, p = ca.SX.sym("x", 2 * (6 + n)), ca.SX.sym("u", 6 + n), ca.vertcat(*symbols)
    z, zd = list(ca.vertsplit(x))[: 6 + n], list(ca.vertsplit(x))[6 + n :]
    base, command = list(ca.vertsplit(u))[:6], list(ca.vertsplit(u))[6:]
    drive, tau = drive_torque(model, z, zd, command, ca)
    joint = [a + b for a, b in zip(tau, model.push(z[6:], zd[6:], ca), strict=True)]

    def accelerations(implicit: list[list[Any]]) -> tuple[list[Any], list[Any]]:
        if system.mode == "emulated":
            balance = system.laboratory.joint_balance
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


def tangents(system: System, wrt: tuple[str, ...], controls: int) -> Equations:
    """Motion, base energy and their exact derivatives along given directions (mode ideal).

    Directions: one per parameter named in `wrt`, then `controls` directions of the command.
    With m of them the state is (x, e, dx_1, de_1, ..., dx_m, de_m), e the time integral of
    the base energy, and the input (u, du_1, ..., du_controls).

    The acceleration a(x, u, p) solves r = M a + bias - loads = 0, so da = -M^-1 dr with a held
    in dr: one pass of Newton-Euler per direction and no derivative of the solution.
    """
    import casadi as ca

    model, symbols = _symbols(system)
    names, n = [str(k) for k in symbols], system.arm.n
    size = 6 + n
    x, a = ca.SX.sym("x", 2 * size), ca.SX.sym("a", size)
    u = ca.SX.sym("u", size)
    p = ca.vertcat(*symbols)
    z, zd = list(ca.vertsplit(x))[:size], list(ca.vertsplit(x))[size:]
    base, command = list(ca.vertsplit(u))[:6], list(ca.vertsplit(u))[6:]
    tau = drive_torque(model, z, zd, command, ca)[1]
    tau = [a + b for a, b in zip(tau, model.push(z[6:], zd[6:], ca), strict=True)]
    mass, loads = balance_of_forces(model, z, zd, base, tau, ca)
    still = solve(mass, loads)
    missing = ca.vertcat(*residual(model, z, zd, list(ca.vertsplit(a)), base, tau, ca))
    energy = base_energy(model, z, zd, ca)

    states, slopes, inputs = [x, ca.SX.sym("e")], [*zd, *still, energy], [u]
    for j in range(len(wrt) + controls):
        dx = ca.SX.sym(f"dx{j}", 2 * size)
        du = ca.SX.zeros(size)
        dp = ca.SX.zeros(len(names))
        if j < len(wrt):
            dp[names.index(wrt[j])] = 1
        else:
            du = ca.SX.sym(f"du{j}", size)
            inputs.append(du)
        along, seed = ca.vertcat(x, u, p), ca.vertcat(dx, du, dp)
        change = ca.substitute(ca.jtimes(missing, along, seed), a, ca.vertcat(*still))
        da = solve(mass, [-k for k in ca.vertsplit(change)])
        states += [dx, ca.SX.sym(f"de{j}")]
        slopes += [*list(ca.vertsplit(dx))[size:], *da, ca.jtimes(energy, along, seed)]
    whole, given = ca.vertcat(*states), ca.vertcat(*inputs)
    slope = ca.vertcat(*slopes)
    motion = ca.Function("motion", [whole, given, p], [ca.cse(slope)])
    observe = ca.Function("observe", [whole, given, p], ca.cse([slope, ca.SX(energy)]))
    return Equations(n, tuple(names), motion, observe)


def coupling(system: System) -> casadi.Function:
    """(q, p) -> Q(q), row by row: `planners.coupling.coupling_matrix` as a graph."""
    import casadi as ca

    model, symbols = _symbols(system)
    n, q = system.arm.n, ca.SX.sym("q", system.arm.n)
    H = inertia_entries(one_base(model.arm), list(ca.vertsplit(q)), ca)
    Mt = sum_of(H.base, model.M)
    A = [solve(Mt, row) for row in H.across]  # each the base's motion per joint rate
    KA = [times(model.K, column) for column in A]
    Q = [sum(a * b for a, b in pairs(A[i], KA[j])) for i in range(n) for j in range(n)]
    return ca.Function("coupling", [q, ca.vertcat(*symbols)], [ca.cse(ca.vertcat(*Q))])


def inertia_matrix(system: System) -> casadi.Function:
    """(q, p) -> H(q) of arm and base link, row by row: `dynamics.inertia` as a graph."""
    import casadi as ca

    model, symbols = _symbols(system)
    n, q = system.arm.n, ca.SX.sym("q", system.arm.n)
    arm = model.arm
    if isinstance(arm.base, tuple):  # the base link alone, without the satellite
        arm = SimpleNamespace(n=n, links=arm.links, base=arm.base[0])
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
