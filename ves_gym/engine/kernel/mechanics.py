"""Mechanics of arm, vehicle and platform on scalars of any kind, as the graphs need them.

Built on `mechanics/dynamics.py`: inertia and Newton-Euler are written there and nowhere else.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

from ves_gym.engine.kernel.symbolic import expressions, traced
from ves_gym.mechanics.carried import inertia_of
from ves_gym.mechanics.dynamics import Vec, inertia_entries, newton_euler
from ves_gym.mechanics.gravity import GRAVITY

if TYPE_CHECKING:
    from ves_gym.system.effect import TorqueEffect

Expression = Any  # a CasADi SX scalar, or a float


@dataclass
class Model:
    """A system whose numbers are symbols (or values), as the equations need it."""

    arm: Any
    M: list[list[Expression]]
    D: list[list[Expression]]
    K: list[list[Expression]]
    drag: list[Expression]
    kp: list[Expression]
    kd: list[Expression]
    limit: list[Expression]
    gain: list[Expression]
    laws: list[tuple[TorqueEffect, dict[str, Any]]]  # with their numbers
    gears: dict[int, Any]  # of the joints that have one: stiffness, damping, gap
    internal: Any = None  # modes of the base: coupling (m, 6), stiffness (m,), damping
    whole: Any = None  # the arm with its flexures as joints, where its links bend
    driven: tuple[int, ...] = ()  # places of the n joints in it
    flexures: tuple[Any, ...] = ()  # of each: stiffness, damping, gap 0
    carried: list[Any] = dataclasses.field(default_factory=list)  # wheels and appendages
    jets: list[Expression] = dataclasses.field(default_factory=list)  # their wrench, or none

    @property
    def springs(self) -> list[Any]:
        """Of the passive joints: gears, then flexures."""
        return [*self.gears.values(), *self.flexures]

    @property
    def hidden(self) -> int:
        """Coordinates beside (Y, q): gears and flexures, what the base carries, its modes."""
        modes = 0 if self.internal is None else len(self.internal.stiffness)
        return len(self.springs) + len(self.carried) + modes

    @property
    def slots(self) -> list[tuple[bool, int]]:
        """All joints along the arm: (True, number of a passive one) or (False, of a driven)."""
        out: list[tuple[bool, int]] = []
        gears = {i: k for k, i in enumerate(self.gears)}
        bends = len(gears)
        driven = {place: i for i, place in enumerate(self.driven)}
        for place in range(self.arm.n if self.whole is None else self.whole.n):
            i = place if self.whole is None else driven.get(place)
            if i is None:
                out.append((True, bends))
                bends += 1
                continue
            out.append((False, i))
            if i in gears:
                out.append((True, gears[i]))
        return out

    def push(self, q: list[Any], v: list[Any], tau: list[Any]) -> list[Any]:
        """Return the torque of the effects' laws at the joints [N m].

        Args:
            q, v: n joint angles and rates.
            tau: n motor torques.
        """
        total = [0.0] * len(q)
        for effect, values in self.laws:
            if _vanishes(effect, values):
                continue
            arrays = {
                name: traced(k, (len(k),)) if isinstance(k, list) else traced([k], ())
                for name, k in {**values, "tau_max": self.limit}.items()
            }
            n = len(q)
            torque = effect.bound(arrays).law(*(traced(k, (n,)) for k in (q, v, tau)))
            pushed = expressions(np.broadcast_to(torque, (n,)))
            total = [a + b for a, b in zip(total, pushed, strict=True)]
        return total


def _vanishes(effect: TorqueEffect, values: dict[str, Any]) -> bool:
    """True if every number that makes the effect act is a structural zero."""
    for field in dataclasses.fields(effect):  # type: ignore[arg-type]
        value, null = values[field.name], field.metadata["null"]
        numbers = value if isinstance(value, list) else [value]
        if null is not None and not (null == 0 and all(is_zero(k) for k in numbers)):
            return False
    return True


def drive_torque(
    model: Model, z: list[Any], zd: list[Any], command: list[Any], xp: Any
) -> tuple[list[Any], list[Any]]:
    """Return the torques that the servos command, and that the motors give [N m]."""
    ask = [
        g * c - kp * q - kd * v
        for g, c, kp, kd, q, v in zip(
            model.gain, command, model.kp, model.kd, z[6:], zd[6:], strict=True
        )
    ]
    return ask, [xp.fmin(xp.fmax(f, -m), m) for f, m in zip(ask, model.limit, strict=True)]


def unfolded(model: Model) -> Model:
    """The model with gears and flexures as joints of their own: rotor first, then the link."""
    links: list[Any] = []
    zero = [[0.0] * 3 for _ in range(3)]
    arm = model.arm if model.whole is None else model.whole
    places = range(arm.n) if model.whole is None else model.driven
    geared = {places[i] for i in model.gears}
    for place, link in enumerate(arm.links):
        if place in geared:
            nothing = SimpleNamespace(mass=0.0, com=(0.0, 0.0, 0.0), inertia=zero)
            shape = {
                "d": 0.0,
                "a": 0.0,
                "alpha": 0.0,
                "beta": None,
                "offset": 0.0,
                "slides": False,
            }
            rotor = link.rotor_inertia
            links.append(SimpleNamespace(**shape, inertial=nothing, rotor_inertia=rotor))
            link = SimpleNamespace(**{**vars(link), "rotor_inertia": 0.0})
        links.append(link)
    arm = SimpleNamespace(**{**vars(arm), "n": len(links), "links": links})
    return dataclasses.replace(model, arm=arm)


def interleaved(model: Model, joints: list[Any], passive: list[Any]) -> list[Any]:
    """Return quantities in the order of the unfolded joints.

    Args:
        model: which joints have gears, and where links bend.
        joints: n of them.
        passive: one per gear, then one per flexure.
    """
    return [passive[k] if is_passive else joints[k] for is_passive, k in model.slots]


def separated(model: Model, values: list[Any]) -> tuple[list[Any], list[Any]]:
    """Return quantities of driven and of passive joints, the inverse of `interleaved`.

    Args:
        model: which joints have gears, and where links bend.
        values: in the order of the unfolded joints.
    """
    by_slot = dict(zip(model.slots, values, strict=True))
    return (
        [by_slot[False, i] for i in range(model.arm.n)],
        [by_slot[True, k] for k in range(len(model.springs))],
    )


def gear_torque(model: Model, d: list[Any], rate: list[Any], xp: Any) -> list[Any]:
    """Return the torque of gears and flexures on what is beyond them [N m].

    Args:
        model: with their springs.
        d: deflections [rad].
        rate: of these [rad/s].
        xp: namespace of the functions.
    """
    out = []
    for gear, bend, bending in zip(model.springs, d, rate, strict=True):
        if not is_zero(gear.gap):
            half = gear.gap / 2
            bend = bend - xp.fmin(xp.fmax(bend, -half), half)
        out.append(-gear.stiffness * bend - gear.damping * bending)
    return out


def internal_forces(
    model: Model, y: list[Any], yd: list[Any], u: list[Any], ud: list[Any]
) -> tuple[list[Any], list[Any]]:
    """Return the generalised force of the internal modes on Y (6), and their u'' (m).

    Args:
        model: with its modes (`vehicle.InternalModes`).
        y, yd: state (Y, q) and its rate.
        u, ud: coordinates and rates of the modes.
    """
    modes, push = model.internal, [0.0] * 6
    out: list[Any] = []
    if modes is None:
        return push, out
    lost = times(modes.damping, [*yd[:6], *ud])
    for column, stiffness, at, loss in zip(
        modes.coupling, modes.stiffness, u, lost[6:], strict=True
    ):
        force = stiffness * (at - sum(c * k for c, k in pairs(column, y[:6])))
        push = [
            a + b * force if not is_zero(b) else a for a, b in zip(push, column, strict=True)
        ]
        out.append(-force - loss)
    return [a - b for a, b in zip(push, lost[:6], strict=True)], out


def _rates(y: list[Expression], xp: Any) -> tuple[list[list[Expression]], list[Expression]]:
    """T of `spatial.rate_matrix`, and the sines and cosines it is made of."""
    sx, sy, sz = (xp.sin(k) for k in y[3:])
    cx, cy, cz = (xp.cos(k) for k in y[3:])
    R = [
        [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx],
        [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx],
        [-sy, cy * sx, cy * cx],
    ]
    T: list[list[Expression]] = [[0.0] * 6 for _ in range(6)]
    for i in range(3):
        for j in range(3):
            T[i][j] = R[j][i]
    T[3][3], T[3][5] = 1.0, -sy
    T[4][4], T[4][5] = cx, cy * sx
    T[5][4], T[5][5] = -sx, cy * cx
    return T, [sx, cx, sy, cy]


def base_motion(
    y: list[Expression], yd: list[Expression], ydd: list[Expression], xp: Any
) -> tuple[list[list[Expression]], Vec, Vec, Vec]:
    """Return T of `spatial.rate_matrix` and the motion of the base in its axes.

    Args:
        y, yd, ydd: pose and its derivatives.
        xp: namespace of sin and cos.

    Returns:
        T, angular velocity, angular acceleration and acceleration of the origin.
    """
    T, (sx, cx, sy, cy) = _rates(y, xp)
    rotated, accelerated = times(T, yd), times(T, ydd)
    dx, dy, dz = yd[3:]
    turn = (
        accelerated[3] - dz * cy * dy,
        accelerated[4] - dy * sx * dx + dz * (cy * cx * dx - sy * sx * dy),
        accelerated[5] - dy * cx * dx - dz * (cy * sx * dx + sy * cx * dy),
    )
    spin = (rotated[3], rotated[4], rotated[5])
    return T, spin, turn, (accelerated[0], accelerated[1], accelerated[2])


def in_space(
    model: Model,
    z: list[Any],
    zd: list[Any],
    jets: list[Any],
    tau: list[Any],
    implicit: list[list[Any]],
    xp: Any,
) -> list[Expression]:
    """Return z'' of arm and vehicle without gravity.

    Args:
        model: numbers or symbols of the system.
        z, zd: state (Y, q) and its rate.
        jets: generalised force on Y.
        tau: joint torques.
        implicit: added to the mass matrix by an implicit integrator.
        xp: namespace of the functions.
    """
    mass, loads = balance_of_forces(model, z, zd, jets, tau, xp)
    return solve(sum_of(mass, implicit), loads)


def balance_of_forces(
    model: Model, z: list[Any], zd: list[Any], jets: list[Any], tau: list[Any], xp: Any
) -> tuple[list[list[Any]], list[Any]]:
    """Return mass matrix and loads of M z'' = loads, in z = (Y, q).

    Args:
        model, z, zd, jets, tau, xp: see `in_space`.
    """
    n = model.arm.n
    T, _ = _rates(z[:6], xp)
    H = inertia_entries(one_base(model.arm), z[6:], xp)
    mass = [[0.0] * (6 + n) for _ in range(6 + n)]
    block = sum_of(product(transposed(T), product(H.base, T)), model.M)
    for i in range(6):
        mass[i][:6] = block[i]
        for j in range(n):
            mass[i][6 + j] = mass[6 + j][i] = sum(T[k][i] * H.across[j][k] for k in range(6))
    for i in range(n):
        mass[6 + i][6:] = H.joints[i]
    still = [0.0] * (6 + n)
    return mass, [-k for k in residual(model, z, zd, still, jets, tau, xp)]


def residual(
    model: Model,
    z: list[Any],
    zd: list[Any],
    zdd: list[Any],
    jets: list[Any],
    tau: list[Any],
    xp: Any,
) -> list[Any]:
    """Return the imbalance of forces on z under accelerations z''.

    Args:
        model, z, zd, jets, tau, xp: see `in_space`.
        zdd: accelerations.
    """
    T, spin, turn, accel = base_motion(z[:6], zd[:6], zdd[:6], xp)
    arm = one_base(model.arm)
    torque, force, moment = newton_euler(
        arm, z[6:], zd[6:], zdd[6:], spin=spin, turn=turn, accel=accel, xp=xp
    )
    out = times(transposed(T), [*force, *moment])
    terms = ((model.M, zdd[:6]), (model.D, zd[:6]), (model.K, z[:6]))
    passive = [times(matrix, vector) for matrix, vector in terms]
    out = [k + sum(part[i] for part in passive) - jets[i] for i, k in enumerate(out)]
    for i, (c, rate) in enumerate(zip(model.drag, zd[:6], strict=True)):
        if not is_zero(c):
            out[i] = out[i] + c * xp.fabs(rate) * rate
    return out + [t - motor for t, motor in zip(torque, tau, strict=True)]


def base_energy(
    model: Model, z: list[Any], zd: list[Any], u: list[Any], ud: list[Any], xp: Any
) -> tuple[Any, Any]:
    """Return E = 1/2 Y'^T (M + H_b) Y' + strain energy, and the latter (`system/energy.py`).

    Args:
        model, z, zd, xp: see `in_space`.
        u, ud: coordinates and rates of flexures, of wheels and appendages, of internal
            modes; empty without any.
    """
    p = len(model.flexures)
    d, dd, u, ud = u[:p], ud[:p], u[p:], ud[p:]
    twist = times(_rates(z[:6], xp)[0], zd[:6])
    if p:
        chain = unfolded(model)
        H = inertia_entries(one_base(chain.arm), interleaved(model, z[6:], d), xp)
        bending = interleaved(model, [0.0] * model.arm.n, dd)
        carried = [sum(k * r for k, r in pairs(row, bending)) for row in transposed(H.across)]
        forms = [(H.base, twist), (model.M, zd[:6]), (H.joints, bending)]
        kinetic = sum(a * b for A, x in forms for a, b in pairs(times(A, x), x))
        kinetic = kinetic + 2 * sum(a * b for a, b in zip(carried, twist, strict=True))
    else:
        locked = inertia_entries(one_base(model.arm), z[6:], xp).base
        forms = [(locked, twist), (model.M, zd[:6])]
        kinetic = sum(a * b for A, x in forms for a, b in pairs(times(A, x), x))
    strain = sum(a * b for a, b in pairs(times(model.K, z[:6]), z[:6]))
    for spring, bend in zip(model.flexures, d, strict=True):
        strain = strain + spring.stiffness * bend * bend
    k = len(model.carried)
    for part, at, rate in zip(model.carried, u[:k], ud[:k], strict=True):
        if part.kind == "wheel":  # locked: what it stores is no motion of the base
            continue
        entries = inertia_of(part, at, xp)
        assert entries.locked is not None
        kinetic = kinetic + sum(a * b for a, b in pairs(times(entries.locked, twist), twist))
        kinetic = kinetic + 2 * rate * sum(a * b for a, b in pairs(entries.across, twist))
        kinetic = kinetic + entries.joint * rate * rate
        strain = strain + part.stiffness * at * at
    u, ud = u[k:], ud[k:]
    if model.internal is not None:
        kinetic = kinetic + sum(k * k for k in ud)
        springs = zip(model.internal.coupling, model.internal.stiffness, u, strict=True)
        for column, stiffness, at in springs:
            stretch = at - sum(c * k for c, k in pairs(column, z[:6]))
            strain = strain + stiffness * stretch * stretch
    return 0.5 * (kinetic + strain), 0.5 * strain


def on_platform(
    model: Model,
    z: list[Any],
    zd: list[Any],
    base: list[Any],
    tau: list[Any],
    implicit: list[list[Any]],
    balance: bool,
    xp: Any,
) -> tuple[list[Expression], list[Expression]]:
    """Return z'' of the arm on a moving platform under gravity, and its wrench on it.

    Args:
        model, z, zd, tau, implicit, xp: see `in_space`.
        base: Y'' of the platform.
        balance: the links' weight is carried outside the motors.
    """
    n, q, v = model.arm.n, z[6:], zd[6:]
    T, spin, turn, accel = base_motion(z[:6], zd[:6], base, xp)
    # T's upper block is R^T: its last column is "up" in platform axes
    lift: Vec = (GRAVITY * T[0][2], GRAVITY * T[1][2], GRAVITY * T[2][2])
    under = (accel[0] + lift[0], accel[1] + lift[1], accel[2] + lift[2])
    zeros = [0.0] * n
    torque, _, _ = newton_euler(
        model.arm, q, v, zeros, spin=spin, turn=turn, accel=under, xp=xp
    )
    loads = [tau[i] - torque[i] for i in range(n)]
    if balance:
        static, _, _ = newton_euler(model.arm, q, zeros, zeros, accel=lift, xp=xp)
        loads = [load + k for load, k in zip(loads, static, strict=True)]
    joint_block = [row[6:] for row in implicit[6:]]
    qdd = solve(sum_of(inertia_entries(model.arm, q, xp).joints, joint_block), loads)
    _, force, moment = newton_euler(
        model.arm, q, v, qdd, spin=spin, turn=turn, accel=under, xp=xp
    )
    return [*base, *qdd], [-k for k in (*force, *moment)]


def one_base(arm: Any) -> Any:
    """The arm with base link and satellite as one body (`newton_euler` knows one)."""
    if not isinstance(arm.base, tuple):
        return arm
    link, satellite = arm.base
    mass = link.mass + satellite.mass
    com = tuple(
        (link.mass * a + satellite.mass * b) / mass
        for a, b in zip(link.com, satellite.com, strict=True)
    )
    inertia = [[0.0] * 3 for _ in range(3)]
    for body in (link, satellite):
        r = [a - b for a, b in zip(body.com, com, strict=True)]
        square = sum(k * k for k in r)
        for i in range(3):
            for j in range(3):
                shift = body.mass * ((square if i == j else 0.0) - r[i] * r[j])
                inertia[i][j] = inertia[i][j] + body.inertia[i][j] + shift
    return SimpleNamespace(
        n=arm.n,
        links=arm.links,
        mount=arm.mount,
        base=SimpleNamespace(mass=mass, com=com, inertia=inertia),
    )


# ------------------------------------------------------------------------- small algebra


def times(matrix: list[list[Any]], vector: list[Any]) -> list[Any]:
    return [sum(a * b for a, b in pairs(row, vector)) for row in matrix]


def product(A: list[list[Any]], B: list[list[Any]]) -> list[list[Any]]:
    return transposed([times(A, column) for column in transposed(B)])


def sum_of(A: list[list[Any]], B: list[list[Any]]) -> list[list[Any]]:
    return [
        [a if is_zero(b) else a + b for a, b in zip(row, other, strict=True)]
        for row, other in zip(A, B, strict=True)
    ]


def transposed(A: list[list[Any]]) -> list[list[Any]]:
    return [list(column) for column in zip(*A, strict=True)]


def pairs(a: list[Any], b: list[Any]) -> Iterator[tuple[Any, Any]]:
    for x, y in zip(a, b, strict=True):
        if not any(isinstance(k, float) and k == 0.0 for k in (x, y)):
            yield x, y


def solve(A: list[list[Any]], b: list[Any]) -> list[Any]:
    """Return A^-1 b by L D L^T from the last row up.

    The arm is eliminated before its base, as along the tree, so that a joint of 1e8 kg m^2
    costs the base no digits.

    Args:
        A: symmetric positive definite.
        b: right-hand side.
    """
    size = len(b)
    A, b = [row[:] for row in A], list(b)
    for k in reversed(range(size)):
        inverse, row = 1.0 / A[k][k], A[k][:k]
        for i in range(k):
            if is_zero(row[i]):
                continue
            factor = row[i] * inverse
            for j in range(i + 1):
                if not is_zero(row[j]):
                    A[i][j] = A[i][j] - factor * row[j]
            b[i] = b[i] - factor * b[k]
            A[k][i] = factor  # L
        A[k][k] = inverse
    out: list[Any] = [0.0] * size
    for k in range(size):
        total = b[k] * A[k][k]
        for i in range(k):
            if not is_zero(A[k][i]):
                total = total - A[k][i] * out[i]
        out[k] = total
    return out


def is_zero(value: Any) -> bool:
    return isinstance(value, float) and value == 0.0
