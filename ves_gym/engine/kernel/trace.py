"""The equations of motion as one symbolic graph: what the kernel and its derivatives compile.

The physics is the text of `mechanics/equations.py` and `mechanics/dynamics.py`, called with
arrays of CasADi symbols (`symbolic.py`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym.engine.kernel.numbers import symbolic_model
from ves_gym.engine.kernel.symbolic import Traced, column, symbols, traced
from ves_gym.mechanics.arm_arrays import Chain, LinkBodies
from ves_gym.mechanics.dynamics import inertia_parts, newton_euler
from ves_gym.mechanics.equations import (
    Model,
    along_the_chain,
    balance_of_forces,
    base_energy,
    drive_torque,
    driven_torque,
    mode_forces,
    momenta,
    motion,
    residual,
    spring_torque,
    touch,
)
from ves_gym.mechanics.orbit import tidal_load
from ves_gym.mechanics.spatial import solve_partly, solve_symmetric
from ves_gym.mechanics.vehicle import orbit_of

if TYPE_CHECKING:
    import casadi

    from ves_gym.mechanics.arm import Arm
    from ves_gym.system.system import System


@dataclass(frozen=True)
class Equations:
    """Graphs of one system's structure: state x = (Y, q, Y', q'), input u, parameters p.

    u is (force on Y or, in mode emulated, platform acceleration Y''; joint commands).
    """

    n: int  # joints
    names: tuple[str, ...]  # of p
    # (x, u, p) -> x'; x with what is hidden, and two works where they are accounted:
    # (z, h, z', h', w)
    motion: casadi.Function
    observe: casadi.Function  # (x, u, p) -> x', (z'', drive torque, wrench if emulated)
    hidden: int = 0  # coordinates h: deflections of gears, internal modes of the base

    @property
    def order(self) -> int:
        """Number of coordinates (z, h)."""
        return 6 + self.n + self.hidden


def equations(system: System, account: bool = False) -> Equations:
    """Trace the system's equations of motion; `account`: x has `StateRate.power`'s works."""
    import casadi as ca

    model, names, p = symbolic_model(system)
    h, size = model.hidden + model.floating, 6 + model.n
    implicit = system.integrator == "implicitfast"
    if h and implicit:
        other = "rk4" if model.floating else "backend mujoco"
        raise ParameterError(
            "backend kernel integrates gears, flexures, wheels, appendages, internal modes and"
            f" payloads that are touched by rk4 or euler, got implicitfast: use {other}"
        )
    x, u = symbols("x", (2 * (size + h),)), symbols("u", (size,))
    observed = motion(model, x, u)  # what is observed
    step = motion(model, x, u, system.physics_dt) if implicit else observed  # and integrated
    slope = column(step.rate, observed.power) if account else column(step.rate)
    out = column(observed.acceleration, observed.drive, observed.wrench)
    state = ca.vertcat(column(x), ca.SX.sym("work", 2)) if account else column(x)
    arguments = [state, column(u), column(p)]
    return Equations(
        model.n,
        names,
        ca.Function("motion", arguments, [ca.cse(slope)]),
        ca.Function("observe", arguments, ca.cse([slope, out])),
        h,
    )


def contact(system: System) -> casadi.Function:
    """(x, p) -> wrench of contact on the tool, about it, engine's axes; energy stored."""
    import casadi as ca

    model, _, p = symbolic_model(system)
    x = symbols("x", (2 * (6 + model.n + model.hidden + model.floating),))
    load = touch(model, x)
    assert load is not None
    out = column(load.wrench, load.energy)
    return ca.Function("contact", [column(x), column(p)], [ca.cse(out)])


def momentum(system: System) -> casadi.Function:
    """(z, z', h, h', p) -> `equations.momenta` of arm and base: momentum, kinetic energy."""
    import casadi as ca

    model, _, p = symbolic_model(system)
    sizes = {"z": 6 + model.n, "zd": 6 + model.n, "h": model.hidden, "hd": model.hidden}
    state = [symbols(name, (k,)) for name, k in sizes.items()]
    out = column(*momenta(model, *state))
    return ca.Function("momentum", [column(k) for k in (*state, p)], [ca.cse(out)])


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
    mass: Array
    prescribed: list[int]  # coordinates whose acceleration is prescribed
    solution: Any  # the a of r = 0

    @property
    def width(self) -> int:
        """Number of coordinates: (Y, q), flexures, and the internal modes, whose mass is 1."""
        return int(self.solution.size1())

    def response(self, change: Any) -> Any:
        """da for dr."""
        import casadi as ca

        value = -ca.substitute(change, self.a, self.solution)
        size = len(self.mass)
        loads = traced(ca.vertsplit(value[:size]), (size, 1))
        return ca.vertcat(column(solve_partly(self.mass, loads, self.prescribed)), value[size:])


def _balance(system: System) -> _Balance:
    model, names, p = symbolic_model(system)
    if model.hidden and len(model.passive) > model.bends:
        raise ParameterError(
            "derivatives know no gears that give way: use differences of Simulator runs"
        )
    if model.carried:
        raise ParameterError(
            "derivatives know no wheels and appendages: use differences of Simulator runs"
        )
    size = 6 + model.n
    width = size + model.hidden  # coordinates: (Y, q), then flexures and internal modes
    x, u, a = symbols("x", (2 * width,)), symbols("u", (size,)), symbols("a", (width,))
    at, rate = x[:width], x[width:]
    z, zd = at[:size], rate[:size]
    (d, _, s), (dd, _, sd) = map(model.parted, (at[size:], rate[size:]))
    _, drive = drive_torque(model, z, zd, u[6:])
    push, sdd = mode_forces(model, z, zd, s, sd)
    tau = model.along(driven_torque(model, z, zd, drive), spring_torque(model, d, dd))
    pose, moving = along_the_chain(model, z, d), along_the_chain(model, zd, dd)
    if model.tide is not None:
        tide = tidal_load(model.tide, model.chain, (), pose, z[:0])
        push, tau = push + tide.base, tau + tide.joints
    mass, loads = balance_of_forces(model, pose, moving, u[:6] + push, tau)
    # coordinates as they lie in the state, by their place along the chain
    order = [*range(6), *(6 + k for k in (*model.driven, *model.passive))]
    mass, loads = mass[order][:, order], loads[order]
    tried = along_the_chain(model, a[:size], model.parted(a[size:])[0])
    missing = residual(model, pose, moving, tried, u[:6] + push, tau)[order]
    prescribed = list(range(6, size)) if model.prescribed else []
    if prescribed:  # these rows say that the joints accelerate as commanded
        loads[prescribed], missing[prescribed] = u[6:], a[prescribed] - u[6:]
    solution = solve_partly(mass, loads[:, None], prescribed)[:, 0]
    return _Balance(
        names=names,
        x=column(x),
        u=column(u),
        p=column(p),
        a=column(a),
        missing=column(missing, a[len(order) :] - sdd),
        energy=column(base_energy(model, z, zd, at[size:], rate[size:])[0]),
        mass=mass,
        prescribed=prescribed,
        solution=column(solution, sdd),
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
    if system.contact is not None:
        raise ParameterError(
            "derivatives know no contact at the tool: use differences of Simulator runs"
        )
    if orbit_of(system.vehicle) is not None:
        raise ParameterError(
            "derivatives know no orbit, whose gravity changes with time: use differences of"
            " Simulator runs"
        )
    by_column, at_once = (_tangents(system, wrt, controls, k) for k in (False, True))
    return min(by_column, at_once, key=lambda graphs: int(graphs.motion.n_instructions()))


def _tangents(system: System, wrt: tuple[str, ...], controls: int, at_once: bool) -> Equations:
    import casadi as ca

    b, size = _balance(system), 6 + system.arm.n
    width = b.width
    both = ca.vertcat(b.missing, b.energy)
    slope = ca.jacobian(both, b.x) if at_once else None
    states, inputs = [b.x, ca.SX.sym("e")], [b.u]
    slopes = [b.x[width:], b.solution, b.energy]
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
        slopes += [dx[width:], b.response(change[:-1]), change[-1]]
    arguments = [ca.vertcat(*states), ca.vertcat(*inputs), b.p]
    rate = ca.cse(ca.vertcat(*slopes))
    return Equations(
        system.arm.n,
        b.names,
        ca.Function("motion", arguments, [rate]),
        ca.Function("observe", arguments, ca.cse([rate, b.energy])),
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
    out = ca.vertcat(b.solution, *(b.response(k) for k in columns))
    still = ca.vertcat(b.x[size:], b.u[:6])
    out = ca.substitute(out, still, ca.SX.zeros(size + 6))
    point = ca.vertcat(b.x[:size], b.u[6:])
    return ca.Function("linearisation", [point, b.p], [ca.cse(ca.densify(out))])


def regressor(arm: Arm) -> casadi.Function:
    """Trace wrench on the base and joint torques per inertial parameter, column after column.

    At (q, v, a) of joints on a base at rest, by ten numbers a body (m, m c, inertia about its
    frame xx xy yy xz yz zz) and the rotor inertias.

    The balance is linear in these numbers. It is differentiated by (m, c, I_c) at unit masses
    in the origins of their frames, which is the same: m c = c there, and what moves I_c to the
    frame is of second order in c.
    """
    import casadi as ca

    arm.require_uncoupled("a regressor")
    n = arm.n
    bodies, rotors = symbols("body", (n + 1, 10)), symbols("rotor", (n,))
    square = bodies[:, [[4, 5, 7], [5, 6, 8], [7, 8, 9]]]
    masses = LinkBodies(bodies[:, 0], bodies[:, 1:4], square, rotors)
    chain = Chain(arm.joints, arm.roots, masses, None)
    x = symbols("x", (3, n))
    torque, wrench = newton_euler(chain, *x)
    every, load = column(bodies, rotors), column(-wrench, torque)
    unit = ca.vertcat(*[1.0, *[0.0] * 9] * (n + 1), ca.SX.zeros(n))
    slope = ca.substitute(ca.jacobian(load, every), every, unit)
    return ca.Function("regressor", [column(x)], [ca.cse(ca.densify(ca.vec(slope)))])


def coupling(system: System) -> casadi.Function:
    """(q, p) -> Q(q), row by row: `planners.coupling.coupling_matrix` as a graph."""
    model, _, p = symbolic_model(system)
    q = symbols("q", (model.n,))
    H = inertia_parts(model.arm, q)
    A = solve_symmetric(H.base + model.M, H.across.T)  # the base's motion per joint rate
    return _function("coupling", q, p, A.T @ (_stiffness(model) @ A))


def _stiffness(model: Model) -> Array:
    """K of the base while its internal modes stand still: K + sum_k omega_k^2 P_k P_k^T."""
    if model.modes is None:
        return model.K
    C = model.modes.coupling
    return model.K + (model.modes.stiffness * C) @ C.T


def inertia_matrix(system: System) -> casadi.Function:
    """(q, p) -> H(q) of arm and base link, row by row: `dynamics.inertia` as a graph."""
    model, _, p = symbolic_model(system)
    q = symbols("q", (model.n,))
    base, across, joints = inertia_parts(model.alone, q)
    H = np.concatenate(
        [np.concatenate([base, across.T], axis=1), np.concatenate([across, joints], axis=1)]
    )
    return _function("inertia", q, p, H)


def _function(name: str, x: Traced, p: Traced, out: Array) -> casadi.Function:
    """(x, p) -> entries of an array, row by row."""
    import casadi as ca

    return ca.Function(name, [column(x), column(p)], [ca.cse(column(out))])
