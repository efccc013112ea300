"""Accounts of a run: work of the drives against what base and arm hold."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from ves_gym._util.params import Array, Mask, ParameterError
from ves_gym._util.views import Viewable
from ves_gym.mechanics.attitude import conjugate, rotate, to_matrix
from ves_gym.mechanics.dynamics import merged
from ves_gym.mechanics.flexure import expand
from ves_gym.mechanics.kinematics import tool_frame, tool_twists
from ves_gym.mechanics.link import Inertial, matrix
from ves_gym.mechanics.orbit import Tide, tidal_load
from ves_gym.mechanics.payload import numbers_of
from ves_gym.mechanics.spatial import matvec, rotation, twist
from ves_gym.mechanics.vehicle import orbit_of
from ves_gym.system.effect import joint_torque
from ves_gym.system.energy import (
    body_energy,
    internal_of,
    port_energy,
    system_of,
    vehicle_energies,
)
from ves_gym.system.runlog import RunLog
from ves_gym.system.runlog_files import QUANTITIES
from ves_gym.system.system import System


@dataclass(frozen=True, eq=False, repr=False)
class EnergyBalance(Viewable):
    """Energy account of a run: what the drives did against where it went.

    Each (N,) [J], zero at the first sample.
    """

    t: Array  # (N,) s
    work: Array  # of the joint drives, of a satellite's wheels, jets and gravity gradient
    kinetic: Array  # change, whole system
    strain: Array  # change
    dissipated: Array  # in the vehicle's damping, by effects at the joints, in contacts
    scale: float  # J that the residual is judged by

    @property
    def residual(self) -> Array:
        """Work less changes and losses: (N,) [J], zero where the account closes."""
        return self.work - self.kinetic - self.strain - self.dissipated

    @property
    def relative(self) -> float:
        """Largest residual over `scale`; inf where that is zero."""
        return float(np.abs(self.residual).max()) / self.scale if self.scale > 0 else math.inf

    def __repr__(self) -> str:
        return (
            f"<EnergyBalance: {self.work[-1]:.4g} J of work over {self.t[-1] - self.t[0]:g} s,"
            f" closes to {self.relative:.1e}>"
        )

    @classmethod
    def of(cls, log: RunLog) -> EnergyBalance:
        """Close the account of a run log; `scale` is the largest work through the base port.

        Needs the columns `tau`, `v` and `yd`; quadrature is Simpson's rule on the log's
        samples, so record densely (the physics step) where a small residual matters. There
        the drive's command, known to be linear between samples, is integrated as such.

        Raises:
            ParameterError: a column is missing, or the system has gears that give way.
        """
        if log.tau is None or log.v is None or log.yd is None:
            missing = [k for k in ("tau", "v", "yd") if getattr(log, k) is None]
            raise ParameterError(f"the energy balance needs the columns {', '.join(missing)}")
        if log.meta.get("captures") or (log.contact is not None and "captures" in log.meta):
            return cls._across(log)
        system = system_of(log).actual
        if system.arm.geared:
            raise ParameterError("the energy balance knows no gears that give way")
        internal = internal_of(system, log)
        laws = joint_torque(system.effects, log.q, log.v, log.tau, system.arm.column("tau_max"))
        power = -np.sum(laws * log.v, axis=-1)
        in_joints = scipy.integrate.cumulative_simpson(power, x=log.t, initial=0.0)
        strain, moving, _ = vehicle_energies(system, log.y, log.yd, internal)
        kinetic = moving + body_energy(system, log.q, log.y, log.yd, internal, log.v)
        absorbed, lost = port_energy(system, log.y, log.yd, internal)
        dissipated = scipy.integrate.cumulative_simpson(lost, x=log.t, initial=0.0)
        # the largest work through the port, not the last: a free base gives back what it took
        scale = float(np.abs(absorbed - absorbed[0] + dissipated).max())
        strain, dissipated = strain - strain[0], dissipated + in_joints
        if log.contact is not None:
            stored, taken = contact_energies(log, system)
            strain, dissipated = strain + stored, dissipated + taken
            scale = max(scale, float(np.abs(stored + taken).max()))
        return cls(
            t=log.t,
            work=_drive_work(system, log)
            + actuator_work(log, system)
            + tidal_work(log, system),
            kinetic=kinetic - kinetic[0],
            strain=strain,
            dissipated=dissipated,
            scale=scale,
        )

    @classmethod
    def _across(cls, log: RunLog) -> EnergyBalance:
        """Join the accounts between captures; what a latch takes is dissipated at once."""
        system, pieces = system_of(log).actual, segments(log)
        offset, columns, scale = np.zeros(3), [], 0.0
        for piece, lost in pieces:
            part = cls.of(piece)
            kinetic = payload_energy(system, piece) + _kinetic_at_start(system, piece)
            offset[2] += lost
            sums = np.stack([part.work, part.strain, part.dissipated]) + offset[:, None]
            columns.append(np.vstack([sums, part.kinetic + kinetic]))
            offset, scale = sums[:, -1], max(scale, part.scale, lost)
        rows = np.hstack([*(k[:, :-1] for k in columns[:-1]), columns[-1]])
        work, strain, dissipated, kinetic = rows
        return cls(
            t=log.t,
            work=work,
            kinetic=kinetic - kinetic[0],
            strain=strain,
            dissipated=dissipated,
            scale=scale,
        )


def _kinetic_at_start(system: System, log: RunLog) -> float:
    """Kinetic energy of arm and base at the first sample [J]."""
    assert log.v is not None and log.yd is not None
    internal = internal_of(system, log)
    first = None if internal is None else (internal[0][:1], internal[1][:1])
    y, yd = log.y[:1], log.yd[:1]
    moving = vehicle_energies(system, y, yd, first)[1]
    return float((moving + body_energy(system, log.q[:1], y, yd, first, log.v[:1]))[0])


def _drive_work(system: System, log: RunLog) -> Array:
    """(N,) work of the joint drives [J]."""
    assert log.tau is not None and log.v is not None
    gains = log.meta.get("controller", {})
    of = [np.asarray(gains[k], float) for k in ("kp", "kd")] if gains else []
    return drive_work(system, of, log.t, log.q, log.v, log.tau)


def drive_work(
    system: System, gains: Sequence[Array], t: Array, q: Array, v: Array, tau: Array
) -> Array:
    """Work of the joint drives since the first sample (N, ...) [J].

    At the physics step a servo's torque is c - kp q - kd v with the command c linear over
    the step. Simpson's rule would take kp c for as smooth as the motion, and miss
    h^2 / 12 of its curvature: 1e-3 of the work through the port (docs/physics.md).

    Args:
        system: whose drives and physics step.
        gains: kp and kd of the servo; none: not known.
        t: (N,) [s]. q, v, tau: (N, ..., joints).
    """
    step = np.diff(t)
    at_physics_step = len(step) > 0 and np.allclose(step, system.physics_dt, rtol=1e-6)
    if system.drive != "motor" or not len(gains) or not at_physics_step:
        power = np.sum(tau * v, axis=-1)
        simple = scipy.integrate.cumulative_simpson(power, x=t, axis=0, initial=0.0)
        return np.asarray(simple, np.float64)
    kp, kd = gains
    h, q = system.physics_dt, q - q[0]
    command = tau + kp * q + kd * v
    # int c v = [c q] - c' int q, with q of both ends and their slopes known
    area = h / 2 * (q[1:] + q[:-1]) - h**2 / 12 * np.diff(v, axis=0)
    pushed = np.diff(command * q - kp * q**2 / 2, axis=0) - np.diff(command, axis=0) / h * area
    damped = np.diff(
        scipy.integrate.cumulative_simpson(kd * v**2, x=t, axis=0, initial=0.0), axis=0
    )
    # a saturated motor gives its limit, whatever the command
    limited = np.abs(tau) > (1 - 1e-9) * system.arm.column("tau_max")
    clipped = (tau[1:] + tau[:-1]) / 2 * np.diff(q, axis=0)
    work = np.where(limited[1:] | limited[:-1], clipped, pushed - damped)
    out = np.zeros(tau.shape[:-1])
    out[1:] = np.cumsum(work.sum(axis=-1), axis=0)
    return out


def actuator_work(log: RunLog, system: System) -> Array:
    """Return the work of wheels' motors and jets since the first sample, (N,) [J].

    Both are held through a control period. So a motor's is its torque times the angle that the
    wheel turns, exactly, where records are no further apart than that; a jet's is the integral
    of wrench times twist, by Simpson's rule within each period.

    Args:
        log: with `u`, `motor` and `jet` of such a satellite.
        system: that it is of.
    """
    out = np.zeros(len(log.t))
    if log.motor is not None and log.u is not None:
        first = system.arm.bends
        turned = np.diff(log.u[:, first : first + log.motor.shape[1]], axis=0)
        out[1:] += np.cumsum(np.sum(log.motor[:-1] * turned, axis=1))
    if log.jet is not None and log.yd is not None:
        moving = twist(log.y, log.yd)
        step = (log.t[-1] - log.t[0]) / (len(log.t) - 1)
        stride = max(1, round(system.control_dt / step))
        for first in range(0, len(log.t) - 1, stride):
            part = slice(first, min(first + stride, len(log.t) - 1) + 1)
            power = moving[part] @ log.jet[first]
            work = scipy.integrate.cumulative_simpson(power, x=log.t[part], initial=0.0)
            out[part.start + 1 :] += work[-1]
            out[part.start + 1 : part.stop] += work[1:] - work[-1]
    return out


def tidal_work(log: RunLog, system: System) -> Array:
    """Return the work of the gravity gradient since the first sample, (N,) [J].

    Args:
        log: with `yd`, `v`, and `u` where something moves in arm or satellite.
        system: that it is of.
    """
    orbit = orbit_of(system.vehicle)
    if orbit is None:
        return np.zeros(len(log.t))
    assert log.v is not None and log.yd is not None and system.base.body is not None
    chain, at, carried = expand(system.arm), [], []
    bends, k = system.arm.bends, system.arm.bends + len(system.base.carried)
    for joints, hidden in ((log.q, log.u), (log.v, log.ud)):
        hidden = np.zeros((len(log.t), k)) if hidden is None else hidden
        at.append(chain.angles(joints, hidden[:, :bends]))
        carried.append(hidden[:, bends:k])
    tide = Tide(np.asarray(orbit.rate), orbit.up(log.t), np.zeros(3))
    mass, com, inertia = merged([numbers_of(k) for k in (chain.arm.base, system.base.body)])
    base = Inertial(mass=float(mass), com=tuple(com.tolist()), inertia=matrix(inertia))
    arm = replace(chain.arm, base=base)
    z = np.concatenate([log.y, at[0]], axis=1)
    load = tidal_load(tide, arm, system.base.carried, z, carried[0])
    rates = log.yd, at[1], carried[1]
    power = sum((f * r).sum(axis=1) for f, r in zip(load, rates, strict=True))
    return np.asarray(scipy.integrate.cumulative_simpson(power, x=log.t, initial=0.0))


def payload_energy(system: System, log: RunLog) -> Array:
    """Return the kinetic energy of the payload at each sample (N,) [J]; 0 without one.

    Args:
        system: with the payload's mass properties.
        log: with the column pd.
    """
    if system.payload is None or log.pd is None:
        return np.zeros(len(log))
    body = system.payload.inertial
    velocity, spin = log.pd[:, :3], log.pd[:, 3:]
    turning = np.sum(spin * matvec(np.array(body.inertia), spin), axis=1)
    out: Array = 0.5 * (body.mass * np.sum(velocity**2, axis=1) + turning)
    return out


def segments(log: RunLog) -> list[tuple[RunLog, float]]:
    """Return the pieces of a log between captures, with the energy lost at their starts [J].

    A sample at which a latch closes holds the rates after it; the piece before it ends there
    too, with the rates before it, which the metadata hold.

    Args:
        log: with the entry `captures`.

    Raises:
        ParameterError: a capture between two samples, or without its rates.
    """
    edges: list[tuple[int, dict[str, Any] | None]] = [(0, None)]
    for capture in log.meta["captures"]:
        k = int(np.argmin(np.abs(log.t - capture["time"])))
        if abs(log.t[k] - capture["time"]) > 1e-9:
            raise ParameterError(f"a capture at {capture['time']:g} s is no sample of the log")
        edges.append((k, capture))
    meta = {k: v for k, v in log.meta.items() if k != "captures"}
    out, lost = [], 0.0
    ends = [*edges[1:], (len(log) - 1, None)]
    for (first, _), (last, capture) in zip(edges, ends, strict=True):
        if last > first:
            rows = {name: getattr(log, name) for name in QUANTITIES}
            cut = {k: a[first : last + 1].copy() for k, a in rows.items() if a is not None}
            if capture is not None and capture["kind"] != "release":
                _set_before(cut, capture)
            out.append((replace(log, t=log.t[first : last + 1], meta=meta, **cut), lost))
            lost = 0.0
        lost += 0.0 if capture is None else capture["lost"]
    return out


def _set_before(cut: dict[str, Array], capture: dict[str, Any]) -> None:
    """Put the rates before a capture into the last row."""
    before = capture["before"]
    twist = np.array(before["payload"])
    cut["yd"][-1], cut["v"][-1], cut["tau"][-1] = before["yd"], before["v"], before["tau"]
    if "ud" in cut:
        cut["ud"][-1] = before["ud"]
    spin = rotate(conjugate(cut["p"][-1, 3:]), twist[3:])
    cut["pd"][-1] = np.r_[twist[:3], spin]


def contact_energies(log: RunLog, system: System) -> tuple[Array, Array]:
    """Return what contact has stored and what it has dissipated since the first sample [J].

    What it takes from the bodies is the integral of force times relative velocity. The force
    jumps where a contact begins, between two samples. So on a payload its impulse from sample
    to sample is taken from the payload's momentum, exactly; elsewhere the trapezoid rule has
    to do.

    Args:
        log: with `contact` and `contact_energy`.
        system: that it is of.

    Returns:
        (N,) each; the second one grows, but for the error of the quadrature.
    """
    assert log.contact is not None and log.contact_energy is not None
    place, moving = _tool(log, system)
    if system.contact is not None and system.contact.on == "payload":
        touching: Mask = np.asarray(log.contact.any(axis=1))
        steps = np.where(
            touching[1:] | touching[:-1], _from_payload(log, system, place, moving), 0
        )
        taken = np.r_[0.0, np.cumsum(steps)]
    else:
        power = -np.sum(log.contact * moving, axis=1)
        taken = scipy.integrate.cumulative_trapezoid(power, x=log.t, initial=0.0)
    stored = log.contact_energy[:, 0] - log.contact_energy[0, 0]
    return stored, np.asarray(taken - stored, np.float64)


def _tool(log: RunLog, system: System) -> tuple[Array, Array]:
    """Place (N, 3) and twist (N, 6) of the tool in inertial axes; against the base where that
    is touched."""
    assert system.contact is not None and log.v is not None and log.yd is not None
    place, _ = tool_frame(system.arm, log.q)
    R, base = rotation(log.y), twist(log.y, log.yd)
    out = matvec(tool_twists(system.arm, log.q), log.v)
    if system.contact.on != "base":
        out += base
        out[:, :3] += np.cross(base[:, 3:], place)
    out = np.concatenate([matvec(R, out[:, :3]), matvec(R, out[:, 3:])], axis=1)
    return log.y[:, :3] + matvec(R, place), out


def _from_payload(log: RunLog, system: System, place: Array, moving: Array) -> Array:
    """(N - 1,) energy that tool and payload lose to their contact from sample to sample [J]."""
    assert system.payload is not None and log.p is not None and log.pd is not None
    body, velocity = system.payload.inertial, log.pd[:, :3]
    com = log.p[:, :3] + rotate(log.p[:, 3:], np.array(body.com))
    turn = to_matrix(log.p[:, 3:])
    spin = matvec(turn, log.pd[:, 3:])
    momentum = matvec(turn, matvec(np.array(body.inertia), log.pd[:, 3:]))
    force, moment = body.mass * np.diff(velocity, axis=0), np.diff(momentum, axis=0)

    def mean(values: Array) -> Array:
        return (values[1:] + values[:-1]) / 2

    at_tool = moment + np.cross(mean(com - place), force)
    against = mean(velocity - moving[:, :3]), mean(spin), mean(moving[:, 3:])
    out: Array = np.sum(force * against[0] + moment * against[1] - at_tool * against[2], axis=1)
    return -out
