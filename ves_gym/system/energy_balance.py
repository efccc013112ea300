"""Balance of energy over a run: work of the drives against what base and arm hold."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import scipy

from ves_gym._util.params import Array, ParameterError
from ves_gym._util.views import Viewable
from ves_gym.mechanics.spatial import quadratic, twist
from ves_gym.system.actuator_work import actuator_work
from ves_gym.system.bending import (
    Internal,
    in_flexures,
    moving_inertia,
    moving_rates,
    own_modes,
)
from ves_gym.system.captures import payload_energy, segments
from ves_gym.system.contacts import contact_energies
from ves_gym.system.effect import joint_torque
from ves_gym.system.energy import interface_energies, internal_of, port_energy, system_of
from ves_gym.system.runlog import RunLog
from ves_gym.system.system import System


@dataclass(frozen=True, eq=False, repr=False)
class EnergyBalance(Viewable):
    """Energy account of a run: what the drives did against where it went.

    Each (N,) [J], zero at the first sample.
    """

    t: Array  # (N,) s
    work: Array  # of the joint drives, and of a satellite's wheels and jets
    kinetic: Array  # change, whole system
    strain: Array  # change
    dissipated: Array  # in the vehicle's damping, by effects at the joints, in contacts
    scale: float  # J that the residual is judged by

    @property
    def residual(self) -> Array:
        """Work less changes and losses: (N,) [J], zero where the account closes."""
        residual: Array = self.work - self.kinetic - self.strain - self.dissipated
        return residual

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
        parts = log.t, log.q, log.v, log.y, log.yd
        work = _drive_work(system, log) + actuator_work(log, system)
        balance = cls.close(system, *parts, work, in_joints=in_joints, internal=internal)
        if log.contact is None:
            return balance
        stored, lost = contact_energies(log, system)
        return replace(
            balance,
            strain=balance.strain + stored,
            dissipated=balance.dissipated + lost,
            scale=max(balance.scale, float(np.abs(stored + lost).max())),
        )

    @classmethod
    def _across(cls, log: RunLog) -> EnergyBalance:
        """Join the accounts between captures; what a latch takes is dissipated at once."""
        system, pieces = system_of(log).actual, segments(log)
        offset, columns, scale, first = np.zeros(3), [], 0.0, None
        for piece, lost in pieces:
            part = cls.of(piece)
            body = payload_energy(system, piece)
            start = _kinetic_at_start(system, piece)
            kinetic = part.kinetic + start + body
            first = kinetic[0] if first is None else first
            offset[2] += lost
            sums = np.stack([part.work, part.strain, part.dissipated]) + offset[:, None]
            columns.append(np.vstack([sums, kinetic - first]))
            offset, scale = sums[:, -1], max(scale, part.scale, lost)
        rows = np.hstack([*(k[:, :-1] for k in columns[:-1]), columns[-1]])
        work, strain, dissipated, moving = rows
        return cls(
            t=log.t,
            work=work,
            kinetic=moving,
            strain=strain,
            dissipated=dissipated,
            scale=scale,
        )

    @classmethod
    def close(
        cls,
        system: System,
        t: Array,
        q: Array,
        v: Array,
        y: Array,
        yd: Array,
        work: Array,
        *,
        in_joints: Array | float = 0.0,
        turned_over: float | None = None,
        internal: Internal | None = None,
    ) -> EnergyBalance:
        """Set the work of the drives against the energies of the samples.

        Args:
            system: mode ideal; arm and vehicle as they really are.
            t: (N,) s.
            q, v: (N, n) joint angles and rates [rad, rad/s].
            y, yd: (N, 6) base pose and its rate.
            work: (N,) of the drives since the first sample [J].
            in_joints: (N,) taken by effects at the joints [J].
            turned_over: all work of the drives, whatever its sign [J]. With it the residual
                is judged by that and the energy at the first sample, else by the largest
                work through the base port.
            internal: u and u' (N, m) of a base with internal modes.

        Returns:
            The account, its losses in the vehicle by Simpson's rule.
        """
        modes = own_modes(system, internal)
        strain, _, _ = interface_energies(system.base, y, yd, modes)
        strain = strain + in_flexures(system, internal)[0]
        kinetic = _kinetic(system, q, v, y, yd, internal)
        stored, power = port_energy(system, y, yd, internal)
        dissipated = scipy.integrate.cumulative_simpson(power, x=t, initial=0.0)
        if turned_over is not None:
            scale = float(kinetic[0] + strain[0]) + turned_over
        else:  # the largest, not the last: a free base gives back what it took
            scale = float(np.abs(stored - stored[0] + dissipated).max())
        return cls(
            t=t,
            work=work,
            kinetic=kinetic - kinetic[0],
            strain=strain - strain[0],
            dissipated=dissipated + in_joints,
            scale=scale,
        )


def _kinetic_at_start(system: System, log: RunLog) -> float:
    """Kinetic energy of arm and base at the first sample [J]."""
    assert log.v is not None and log.yd is not None
    internal = internal_of(system, log)
    first = None if internal is None else (internal[0][:1], internal[1][:1])
    return float(_kinetic(system, log.q[:1], log.v[:1], log.y[:1], log.yd[:1], first)[0])


def _kinetic(
    system: System, q: Array, v: Array, y: Array, yd: Array, internal: Internal | None
) -> Array:
    """(N,) kinetic energy of arm and base [J], arguments as of `EnergyBalance.close`."""
    rates = moving_rates(system, twist(y, yd), internal)
    body = moving_inertia(system, q, internal)
    if system.base.body is not None:
        body[..., :6, :6] += system.base.body.spatial()
    moving = interface_energies(system.base, y, yd, own_modes(system, internal))[1]
    out: Array = quadratic(body, np.concatenate([rates, v], axis=-1)) + moving
    return out


def _drive_work(system: System, log: RunLog) -> Array:
    """(N,) work of the joint drives [J].

    At the physics step a servo's torque is c - kp q - kd v with the command c linear over
    the step. Simpson's rule would take kp c for as smooth as the motion, and miss
    h^2 / 12 of its curvature: 1e-3 of the work through the port (docs/physics.md).
    """
    assert log.tau is not None and log.v is not None
    gains = log.meta.get("controller", {})
    step = np.diff(log.t)
    at_physics_step = len(step) > 0 and np.allclose(step, system.physics_dt, rtol=1e-6)
    if system.drive != "motor" or not gains or not at_physics_step:
        power = np.sum(log.tau * log.v, axis=-1)
        return np.asarray(
            scipy.integrate.cumulative_simpson(power, x=log.t, initial=0.0), dtype=np.float64
        )
    kp, kd = (np.asarray(gains[k], float) for k in ("kp", "kd"))
    h, q, v = system.physics_dt, log.q - log.q[0], log.v
    command = log.tau + kp * q + kd * v
    # int c v = [c q] - c' int q, with q of both ends and their slopes known
    area = h / 2 * (q[1:] + q[:-1]) - h**2 / 12 * np.diff(v, axis=0)
    pushed = np.diff(command * q - kp * q**2 / 2, axis=0) - np.diff(command, axis=0) / h * area
    damped = np.diff(
        scipy.integrate.cumulative_simpson(kd * v**2, x=log.t, axis=0, initial=0.0), axis=0
    )
    # a saturated motor gives its limit, whatever the command
    limited = np.abs(log.tau) > (1 - 1e-9) * system.arm.column("tau_max")
    clipped = (log.tau[1:] + log.tau[:-1]) / 2 * np.diff(q, axis=0)
    work = np.where(limited[1:] | limited[:-1], clipped, pushed - damped)
    out: Array = np.r_[0.0, np.cumsum(work.sum(axis=-1))]
    return out
