"""Equations of motion of arm, base and what they carry: z'' from the state, in plain NumPy.

z = (Y, q): pose of the base and angles of the joints. Inertia and Newton-Euler are `dynamics`'.
The same text runs on numbers, leading axes being simulations, and is traced into the compiled
kernel, its derivatives and its energies (`engine.kernel.trace`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ves_gym._util.params import Array
from ves_gym.mechanics.arm_arrays import Chain
from ves_gym.mechanics.carried import inertia_of, load_of, passive_effort
from ves_gym.mechanics.contact import ContactLoad, ContactModel, contact_load
from ves_gym.mechanics.dynamics import inertia_parts, newton_euler
from ves_gym.mechanics.gravity import GRAVITY
from ves_gym.mechanics.orbit import Tide, tidal_load
from ves_gym.mechanics.spatial import (
    base_motion,
    cross,
    matvec,
    rate_matrix,
    room,
    rotation,
    solve_partly,
    solve_symmetric,
)

Law = Callable[[Array, Array, Array], Any]  # of q, v and the motors' torque: more torque


class Springs(NamedTuple):
    """Passive joints along the arm: gears that give way, then flexures."""

    stiffness: Array  # (p,) N m/rad
    damping: Array  # (p,) N m s/rad
    gap: Array  # (p,) rad, of gears with play
    loose: list[int]  # those that have one


class InnerModes(NamedTuple):
    """Inner modes of the base (`vehicle.InternalModes`)."""

    coupling: Array  # (6, m)
    stiffness: Array  # (m,) omega^2
    damping: Array  # (6 + m, 6 + m)


@dataclass(frozen=True)
class Model:
    """A system's numbers, or symbols, as the equations take them."""

    alone: Chain  # the n driven joints, rigid, on the base link
    arm: Chain  # the same, the base link with its satellite as one body
    chain: Chain  # every joint: a gear's rotor, then its link; flexures where links bend
    driven: list[int]  # places of the n joints in the chain
    passive: list[int]  # places of the springs
    bends: int  # flexures among them
    springs: Springs
    M: Array  # (6, 6)
    D: Array  # (6, 6)
    K: Array  # (6, 6)
    drag: Array  # (6,)
    kp: Array  # (n,)
    kd: Array  # (n,)
    limit: Array  # (n,) N m
    prescribed: bool  # the joints accelerate as commanded, whatever that takes
    laws: tuple[Law, ...]
    modes: InnerModes | None
    carried: tuple[Any, ...]  # wheels and appendages
    jets: Array | None  # (6,) their wrench, platform axes
    emulated: bool  # on a platform that goes where it is told, under gravity
    balanced: bool  # the links' weight is carried outside the motors
    contact: ContactModel | None  # of the tool
    tide: Tide | None  # gravity gradient

    @property
    def n(self) -> int:
        """Number of driven joints."""
        return len(self.driven)

    @property
    def hidden(self) -> int:
        """Coordinates beside (Y, q): springs, what the base carries, its modes."""
        modes = 0 if self.modes is None else self.modes.stiffness.shape[-1]
        return len(self.passive) + len(self.carried) + modes

    @property
    def floating(self) -> int:
        """Coordinates behind these: a payload that is touched."""
        return 0 if self.contact is None else self.contact.floating

    def along(self, driven: Array, passive: Array) -> Array:
        """(..., joints of the chain) from what the n joints and the springs have."""
        if not self.passive:
            return driven
        out = room(driven, *driven.shape[:-1], self.n + len(self.passive))
        out[..., self.driven], out[..., self.passive] = driven, passive
        return out

    def parted(self, hidden: Array) -> tuple[Array, Array, Array]:
        """Coordinates of springs, of what the base carries and of its modes."""
        p, k = len(self.passive), len(self.passive) + len(self.carried)
        return hidden[..., :p], hidden[..., p:k], hidden[..., k : self.hidden]


class StateRate(NamedTuple):
    """Derivative of a state under its inputs."""

    rate: Array  # (..., 2 (6 + n + h)) of the state
    acceleration: Array  # (..., 6 + n) z''
    drive: Array  # (..., n) torque of the motors [N m]
    wrench: Array  # (..., 6) of the arm on its platform; (..., 0) in space
    # (..., 2) of all forces, which is the kinetic energy's rate, and sum |power| of the drives
    # [W]; (..., 0) on a platform
    power: Array


def motion(model: Model, x: Array, u: Array, step: float | None = None) -> StateRate:
    """Return the rate of a state.

    Args:
        x: (..., 2 (6 + n + h)): z, what is hidden, and the rates of both; a payload that is
            touched is the last that is hidden.
        u: (..., 6 + n) force on Y or, emulated, acceleration of the platform; joint commands.
        step: of an integrator that takes what resists motion implicitly, as MuJoCo's
            implicitfast [s]; None: none.
    """
    half, size = x.shape[-1] // 2, 6 + model.n
    z, zd = x[..., :size], x[..., half : half + size]
    (d, c, s), (dd, cd, sd) = map(model.parted, (x[..., size:half], x[..., half + size :]))
    base = body_fixed(model, z, u[..., :6])
    load = touch(model, x)
    ask, drive = drive_torque(model, z, zd, u[..., 6:])
    joints = model.along(driven_torque(model, z, zd, drive), spring_torque(model, d, dd))
    pose, moving = along_the_chain(model, z, d), along_the_chain(model, zd, dd)
    implicit = None if step is None else _implicit(model, ask, step)
    cdd, sdd, wrench, power = c, s, z[..., :0], z[..., :0]
    if model.emulated:
        zdd, drive, wrench = on_platform(
            model, pose, moving, base, joints, drive, u[..., 6:], implicit
        )
    else:
        push, sdd = mode_forces(model, z, zd, s, sd)
        if load is not None:
            push, joints = push + load.base, joints + load.joints
        carried = 0.0 * c
        if model.tide is not None:
            tide = tidal_load(model.tide, model.chain, model.carried, pose, c)
            push, joints, carried = push + tide.base, joints + tide.joints, tide.carried
        mass, loads = balance_of_forces(model, pose, moving, base + push, joints)
        if implicit is not None:
            mass = mass + implicit
        if model.carried:
            mass, loads = with_carried(model, mass, loads, pose, moving, c, cd)
            loads[..., loads.shape[-1] - c.shape[-1] :] += carried
        solution, drive = solved(model, mass, loads, drive, u[..., 6:], 6)
        power = power_of(model, pose, moving, base + push, joints) + (sdd * sd).sum(axis=-1)
        driven = drive * zd[..., 6:]
        if model.prescribed:
            power = power + driven.sum(axis=-1)
        for k, part in enumerate(model.carried):
            effort = passive_effort(part, c[..., k], cd[..., k]) + getattr(part, "motor", 0.0)
            power = power + (effort + carried[..., k]) * cd[..., k]
        power = np.stack([power, np.abs(driven).sum(axis=-1)], axis=-1)
        zdd, cdd = solution[..., : pose.shape[-1]], solution[..., pose.shape[-1] :]
    joint = zdd[..., 6:]
    zdd, ddd = (
        np.concatenate([zdd[..., :6], joint[..., model.driven]], axis=-1),
        joint[..., model.passive],
    )
    floats = z[..., :0] if load is None else load.floating
    rate = np.concatenate([x[..., half:], zdd, ddd, cdd, sdd, floats], axis=-1)
    return StateRate(rate, zdd, drive, wrench, power)


def power_of(model: Model, z: Array, zd: Array, force: Array, tau: Array) -> Array:
    """Return the power of forces and of what holds the base (...) [W].

    Args:
        model, z, zd, force, tau: see `balance_of_forces`.
    """
    y, yd = z[..., :6], zd[..., :6]
    push = force - matvec(model.K, y) - matvec(model.D, yd) - model.drag * np.abs(yd) * yd
    power: Array = (push * yd).sum(axis=-1) + (tau * zd[..., 6:]).sum(axis=-1)
    return power


def touch(model: Model, x: Array) -> ContactLoad | None:
    """Return what contact at the tool does in a state, as `motion` takes it; None without."""
    if model.contact is None:
        return None
    half, size = x.shape[-1] // 2, 6 + model.n
    pose, moving = (
        along_the_chain(model, k[..., :size], model.parted(k[..., size:])[0])
        for k in (x[..., :half], x[..., half:])
    )
    b, bd = (k[..., size + model.hidden :] for k in (x[..., :half], x[..., half:]))
    return contact_load(model.contact, model.chain, pose, moving, b, bd)


def momenta(
    model: Model, z: Array, zd: Array, hidden: Array, rate: Array
) -> tuple[Array, Array]:
    """Return the momentum of arm and base in space about the origin (..., 6) [kg m/s, kg
    m^2/s], and their kinetic energy [J], of a state and its rate (..., 6 + n) and what is
    hidden and its (..., h). Internal modes of the base have no part in it."""
    (d, c, _), (dd, cd, _) = model.parted(hidden), model.parted(rate)
    pose, moving = along_the_chain(model, z, d), along_the_chain(model, zd, dd)
    none = 0.0 * moving
    mass, loads = balance_of_forces(model, pose, moving, none[..., :6], none[..., 6:])
    if model.carried:
        mass, _ = with_carried(model, mass, loads, pose, moving, c, cd)
    rates = np.concatenate([moving, cd], axis=-1)
    p = matvec(mass, rates)
    # the angles' axes in space times angular momentum are p of the angles
    about_x, about_y, about_z = (p[..., k] for k in (3, 4, 5))
    (sy, cy), (sz, cz) = ((np.sin(k), np.cos(k)) for k in (z[..., 4], z[..., 5]))
    flat = (about_x + sy * about_z) / cy
    turning = np.stack([cz * flat - sz * about_y, sz * flat + cz * about_y, about_z], axis=-1)
    turning = turning + cross(z[..., :3], p[..., :3])
    return np.concatenate([p[..., :3], turning], axis=-1), 0.5 * (rates * p).sum(axis=-1)


def along_the_chain(model: Model, z: Array, d: Array) -> Array:
    """(Y, joints of the chain) from (Y, q) and the springs' deflections."""
    return np.concatenate([z[..., :6], model.along(z[..., 6:], d)], axis=-1)


def body_fixed(model: Model, z: Array, force: Array) -> Array:
    """Add the jets, whose wrench turns with the base, to a generalised force on Y."""
    if model.jets is None:
        return force
    T = rate_matrix(z[..., :6])
    return force + matvec(np.swapaxes(T, -1, -2), model.jets)


def drive_torque(model: Model, z: Array, zd: Array, command: Array) -> tuple[Array, Array]:
    """Return the torques (..., n) that the servos ask, and that the motors give [N m]; zero
    where joints are prescribed: what holds them there follows from the motion."""
    if model.prescribed:
        return 0.0 * command, 0.0 * command
    ask = command - model.kp * z[..., 6:] - model.kd * zd[..., 6:]
    return ask, np.clip(ask, -model.limit, model.limit)


def driven_torque(model: Model, z: Array, zd: Array, drive: Array) -> Array:
    """Return the torque (..., n) of motors and of the effects' laws at the joints [N m]."""
    out = drive
    for law in model.laws:
        out = out + law(z[..., 6:], zd[..., 6:], drive)
    return out


def spring_torque(model: Model, d: Array, rate: Array) -> Array:
    """Return the torque of p gears and flexures on what is beyond them [N m], at deflections d
    (..., p) [rad] and their rates."""
    stiffness, damping, gap, loose = model.springs
    if loose:
        d, half = d.copy(), gap[..., loose] / 2
        d[..., loose] -= np.clip(d[..., loose], -half, half)
    return -stiffness * d - damping * rate


def mode_forces(model: Model, z: Array, zd: Array, s: Array, sd: Array) -> tuple[Array, Array]:
    """Return the generalised force of the base's m modes on Y (..., 6), and their s'' (..., m),
    from z = (Y, q), its rate, and their own coordinates and rates (..., m)."""
    if model.modes is None:
        return np.zeros(6), s
    coupling, stiffness, damping = model.modes
    lost = matvec(damping, np.concatenate([zd[..., :6], sd], axis=-1))
    force = stiffness * (s - z[..., :6] @ coupling)
    return force @ coupling.T - lost[..., :6], -force - lost[..., 6:]


def balance_of_forces(
    model: Model, z: Array, zd: Array, force: Array, tau: Array
) -> tuple[Array, Array]:
    """Return mass matrix and loads of M z'' = loads in space, at a state z and its rate (..., 6
    + joints of the chain), under a generalised force (..., 6) on Y and torques tau."""
    H, T = inertia_parts(model.chain, z[..., 6:]), rate_matrix(z[..., :6])
    size = z.shape[-1]
    mass = room(T, *T.shape[:-2], size, size)
    mass[..., :6, :6] = np.swapaxes(T, -1, -2) @ (H.base @ T) + model.M
    mass[..., 6:, :6] = across = H.across @ T
    mass[..., :6, 6:] = np.swapaxes(across, -1, -2)
    mass[..., 6:, 6:] = H.joints
    return mass, -residual(model, z, zd, 0.0 * zd, force, tau)


def residual(model: Model, z: Array, zd: Array, zdd: Array, force: Array, tau: Array) -> Array:
    """Return the imbalance of forces on z under accelerations z'', as `balance_of_forces` takes
    the others."""
    y, yd, ydd = (k[..., :6] for k in (z, zd, zdd))
    T, spin, turn, accel = base_motion(y, yd, ydd)
    torque, wrench = newton_euler(
        model.chain, z[..., 6:], zd[..., 6:], zdd[..., 6:], spin=spin, turn=turn, accel=accel
    )
    base = matvec(np.swapaxes(T, -1, -2), wrench) - force + model.drag * np.abs(yd) * yd
    for matrix, vector in ((model.M, ydd), (model.D, yd), (model.K, y)):
        base = base + matvec(matrix, vector)
    return np.concatenate([base, torque - tau], axis=-1)


def solved(
    model: Model, mass: Array, loads: Array, drive: Array, command: Array, first: int
) -> tuple[Array, Array]:
    """Return a of M a = loads, and the torque of the drives (..., n) [N m].

    Prescribed joints have the acceleration that they are commanded [rad/s^2]; only the rest is
    solved for, and what is then missing in the joints' own rows is their drives' torque. Loads
    (..., m) of prescribed joints are without their drives; others' are with `drive` (..., n).
    The chain's joints lie from coordinate `first` on.
    """
    if not model.prescribed:
        return solve_symmetric(mass, loads[..., None])[..., 0], drive
    prescribed = [first + k for k in model.driven]
    out = loads.copy()
    out[..., prescribed] = command
    out = solve_partly(mass, out[..., None], prescribed)[..., 0]
    return out, matvec(mass[..., prescribed, :], out) - loads[..., prescribed]


def _implicit(model: Model, ask: Array, step: float) -> Array:
    """Mass that an implicit step adds for what resists motion, h (D + kd); a motor at its limit
    resists no more."""
    size = 6 + model.n
    out = room(ask, *ask.shape[:-1], size, size)
    out[..., :6, :6] = step * model.D
    joints = range(6, size)
    out[..., joints, joints] = np.where(np.abs(ask) < model.limit, step * model.kd, 0.0)
    return out


def with_carried(
    model: Model, mass: Array, loads: Array, z: Array, zd: Array, at: Array, rate: Array
) -> tuple[Array, Array]:
    """Return mass matrix and loads of `balance_of_forces` with the k joints of wheels and
    appendages after z, at their coordinates and rates (..., k).

    Each joint couples with the base alone, so the mass matrix has a diagonal more.
    """
    size, k = mass.shape[-1], len(model.carried)
    T, spin, turn, accel = base_motion(z[..., :6], zd[..., :6], 0.0 * zd[..., :6])
    down = np.swapaxes(T, -1, -2)
    wide = room(mass, *mass.shape[:-2], size + k, size + k)
    wide[..., :size, :size] = mass
    push = room(loads, *loads.shape[:-1], size + k)
    push[..., :size] = loads
    for c, part in enumerate(model.carried):
        entries = inertia_of(part, at[..., c])
        if entries.locked is not None:
            wide[..., :6, :6] += down @ (entries.locked @ T)
        coupled = matvec(down, entries.across)
        wide[..., :6, size + c] = wide[..., size + c, :6] = coupled
        wide[..., size + c, size + c] = entries.joint
        wrench, effort = load_of(part, at[..., c], rate[..., c], spin, turn, accel)
        push[..., :6] -= matvec(down, wrench)
        motor = getattr(part, "motor", 0.0)
        push[..., size + c] = passive_effort(part, at[..., c], rate[..., c]) + motor - effort
    return wide, push


def on_platform(
    model: Model,
    z: Array,
    zd: Array,
    ydd: Array,
    tau: Array,
    drive: Array,
    command: Array,
    implicit: Array | None = None,
) -> tuple[Array, Array, Array]:
    """Return z'' of the arm on a platform that moves by ydd (..., 6) under gravity, its drives'
    torque, its wrench; see `balance_of_forces`, `solved` and `_implicit`."""
    q, v, still = z[..., 6:], zd[..., 6:], 0.0 * zd[..., 6:]
    _, spin, turn, accel = base_motion(z[..., :6], zd[..., :6], ydd)
    lift = GRAVITY * rotation(z[..., :6])[..., 2, :]  # "up" in platform axes
    under = accel + lift
    torque, _ = newton_euler(model.chain, q, v, still, spin=spin, turn=turn, accel=under)
    loads = tau - torque
    if model.balanced:
        loads = loads + newton_euler(model.chain, q, still, still, accel=lift)[0]
    mass = inertia_parts(model.chain, q).joints
    if implicit is not None:
        mass = mass + implicit[..., 6:, 6:]
    qdd, drive = solved(model, mass, loads, drive, command, 0)
    _, wrench = newton_euler(model.chain, q, v, qdd, spin=spin, turn=turn, accel=under)
    return np.concatenate([ydd, qdd], axis=-1), drive, -wrench


def base_energy(
    model: Model, z: Array, zd: Array, hidden: Array, rate: Array
) -> tuple[Array, Array]:
    """Return E = 1/2 Y'^T (M + H_b) Y' + strain energy, and the latter [J], gears left out.

    Of a state and its rate (..., 6 + n) and what is hidden and its (..., h): flexures, wheels
    and appendages, modes of the base.
    """
    p, k = model.bends, model.bends + len(model.carried)
    d, c, s = hidden[..., :p], hidden[..., p:k], hidden[..., k:]
    dd, cd, sd = rate[..., :p], rate[..., p:k], rate[..., k:]
    y, yd = z[..., :6], zd[..., :6]
    moved = matvec(rate_matrix(y), yd)
    chain = model.chain if p else model.arm
    H = inertia_parts(chain, model.along(z[..., 6:], d) if p else z[..., 6:])
    kinetic, strain = form(H.base, moved) + form(model.M, yd), form(model.K, y)
    if p:
        strain = strain + (model.springs.stiffness * d * d).sum(axis=-1)
        bending = model.along(0.0 * zd[..., 6:], dd)
        kinetic = kinetic + form(H.joints, bending)
        kinetic = kinetic + 2.0 * (moved * (bending[..., None] * H.across).sum(axis=-2)).sum(-1)
    for k, part in enumerate(model.carried):
        if part.kind == "wheel":  # locked: what it stores is no motion of the base
            continue
        entries, slip = inertia_of(part, c[..., k]), cd[..., k]
        assert entries.locked is not None
        kinetic = kinetic + form(entries.locked, moved) + entries.joint * slip * slip
        kinetic = kinetic + 2.0 * slip * (entries.across * moved).sum(axis=-1)
        strain = strain + part.stiffness * c[..., k] * c[..., k]
    if model.modes is not None:
        stretch = s - y @ model.modes.coupling
        kinetic = kinetic + (sd * sd).sum(axis=-1)
        strain = strain + (model.modes.stiffness * stretch * stretch).sum(axis=-1)
    return 0.5 * (kinetic + strain), 0.5 * strain


def form(matrix: Array, vector: Array) -> Array:
    """Return x^T A x."""
    out: Array = (vector * matvec(matrix, vector)).sum(axis=-1)
    return out
