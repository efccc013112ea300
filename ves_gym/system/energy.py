"""Energy transferred to the base: the suite's measure, and the balance that checks it.

E(t) = 1/2 Y'^T M_t Y' + 1/2 Y^T K Y with M_t = M + H_b(q): what the base would keep if
the joints were locked at that instant. Links that bend count with the base, by their strain
and in M_t by the rates of their deflections. `E_mean`, its mean over the motion and the ten
seconds after it, is the primary score; docs/physics.md says why not the end value.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy

from ves_gym._util.params import Array, ParameterError, unit
from ves_gym.mechanics.carried import ReactionWheel, carried_energy
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.flexure import expand
from ves_gym.mechanics.spatial import quadratic, twist
from ves_gym.mechanics.vehicle import BaseModel
from ves_gym.system.runlog import RunLog
from ves_gym.system.system import System

# u and u' (..., p + m): deflections of the arm's p flexures first [rad], then what the vehicle
# carries, then its internal modes
Internal = tuple[Array, Array]


TAIL = 10.0  # s after the motion that E_mean covers
SETTLED = 0.05  # of the peak


class BaseEnergy(NamedTuple):
    """Energy of the base at each sample [J], shape (...,)."""

    strain: Array  # 1/2 Y^T K Y
    kinetic: Array  # 1/2 Y'^T M_t Y'

    @property
    def total(self) -> Array:
        """E(t)."""
        return self.strain + self.kinetic


@dataclass(frozen=True, kw_only=True)
class Measures:
    """Numbers taken from one run, each with its unit."""

    @classmethod
    def units(cls) -> dict[str, str]:
        """Units of the measures, by name."""
        return {f.name: f.metadata["unit"] for f in fields(cls)}

    def __str__(self) -> str:
        units = self.units()
        return ", ".join(f"{k} {v:.4g} {units[k]}" for k, v in asdict(self).items())

    def to_dict(self) -> dict[str, float | None]:
        """Plain numbers; None where a value is not finite."""
        return {k: v if math.isfinite(v) else None for k, v in asdict(self).items()}


@dataclass(frozen=True, kw_only=True)
class Energies(Measures):
    """The energy measures of one run."""

    E_mean: float = unit("J")  # mean of E over the motion and the tail: the primary score
    E_res: float = unit("J")  # E at the end of the motion
    E_peak: float = unit("J")  # largest E
    E_strain_peak: float = unit("J")  # largest strain energy
    E_int: float = unit("J s")  # time integral of the strain energy
    W_port: float = unit("J")  # through the base port: stored in the vehicle + dissipated
    t_5: float = unit("s")  # until E stays below 5 % of its peak; inf if it does not


def base_energy(
    system: System,
    q: npt.ArrayLike,
    y: npt.ArrayLike,
    yd: npt.ArrayLike,
    internal: Internal | None = None,
) -> BaseEnergy:
    """Strain and kinetic energy of the base.

    M_t = M + H_b(q) is that of the one system given, its arm as described. Runs of systems
    of their own (`Simulator.assign`) need a call each, with `Simulator.systems[i]`.

    Args:
        q: (..., n) joint angles. y, yd: (..., 6) base pose and its rate.
        internal: u and u' of a base with such coordinates (`BaseModel.hidden`);
            `internal_motion` estimates those of modes. Wheels count as locked: what they
            store is no motion of the base.

    Raises:
        ParameterError: the base has internal coordinates whose motion is not given.
    """
    pose, rate = np.asarray(y, float), np.asarray(yd, float)
    strain, moving, _ = vehicle_energies(system, pose, rate, internal, locked=True)
    locked = body_energy(system, np.asarray(q, float), pose, rate, internal)
    return BaseEnergy(strain, moving + locked)


def body_energy(
    system: System,
    q: Array,
    y: Array,
    yd: Array,
    internal: Internal | None,
    v: Array | None = None,
) -> Array:
    """Kinetic energy (...) of the arm, its flexures and a satellite's body [J].

    Args:
        system: arm and vehicle.
        q: (..., n) joint angles [rad].
        y, yd: (..., 6) pose of the base and its rate.
        internal: u and u', first those of the p flexures where the arm bends.
        v: (..., n) joint rates [rad/s]; None: the joints are locked.
    """
    rates, H = [twist(y, yd)], inertia(system.arm, q) if not system.arm.bends else None
    if H is None:
        assert internal is not None  # `vehicle_energies` has refused an arm that bends
        d, rate = (part[..., : system.arm.bends] for part in internal)
        rates.append(rate)
        H = expand(system.arm).inertia(q, d)
    if v is not None:
        rates.append(v)
    if system.base.body is not None:
        H[..., :6, :6] += system.base.body.spatial()
    moving = np.concatenate(rates, axis=-1)
    size = moving.shape[-1]
    return quadratic(H[..., :size, :size], moving)


def vehicle_energies(
    system: System, y: Array, yd: Array, internal: Internal | None, locked: bool = False
) -> tuple[Array, Array, Array]:
    """Strain energy of vehicle and flexures, kinetic energy of M and of what it carries, loss.

    Args:
        system: arm and vehicle; a satellite's body is not in it.
        y, yd: (..., 6) pose of the base and its rate.
        internal: u and u' (..., p + m); None: not known.
        locked: wheels count as locked.

    Returns:
        (...) [J], [J], [W].

    Raises:
        ParameterError: motion that is needed is not given.
    """
    base, p = system.base, system.arm.bends
    if p and (internal is None or internal[0].shape[-1] < p):
        raise ParameterError(
            f"the energy of an arm that bends at {p} flexures needs their motion (columns u and"
            " ud of a simulation's log)"
        )
    if base.hidden and internal is None:
        raise ParameterError(
            f"the energy of a base with {base.hidden} internal coordinates (modes, wheels,"
            " appendages) needs their motion"
        )
    strain, kinetic = quadratic(base.K, y), quadratic(base.M, yd)
    power = 2 * quadratic(base.D, yd)
    if base.drag is not None:
        power = power + np.sum(base.drag * np.abs(yd) ** 3, axis=-1)
    if internal is None:
        return strain, kinetic, power
    u, ud = internal
    if p:
        chain = expand(system.arm)
        strain = strain + quadratic(np.diag(chain.stiffness), u[..., :p])
        power = power + 2 * quadratic(np.diag(chain.damping), ud[..., :p])
        u, ud = u[..., p:], ud[..., p:]
    if base.carried:
        k = len(base.carried)
        still = [locked and isinstance(part, ReactionWheel) for part in base.carried]
        turning = np.where(still, 0.0, ud[..., :k])
        parts = carried_energy(base.carried, twist(y, yd), u[..., :k], turning)
        strain, kinetic, power = strain + parts[0], kinetic + parts[1], power + parts[2]
        u, ud = u[..., k:], ud[..., k:]
    if base.internal is not None:
        stretch = (u - base.attached(y)) * base.internal.omega
        strain = strain + 0.5 * np.sum(stretch**2, axis=-1)
        kinetic = kinetic + 0.5 * np.sum(ud**2, axis=-1)
        rates = np.concatenate([yd, ud], axis=-1)
        power = power + 2 * quadratic(base.internal.damping, rates)
    return strain, kinetic, power


def internal_motion(base: BaseModel, t: Array, y: Array, yd: Array) -> Internal:
    """Estimate the motion of internal modes from that of the interface, from rest on it.

    The pose between samples is the cubic through poses and rates; u'' follows from it
    exactly. What a mode did before the first sample is not known, and is not there.

    Args:
        base: with internal modes.
        t: (N,) s, evenly spaced.
        y, yd: (..., N, 6) pose and rate of the interface.

    Returns:
        u and u' (..., N, m).
    """
    modes = base.internal
    if base.carried or modes is None:
        raise ParameterError(
            "the motion of wheels and appendages does not follow from that of the base: record"
            " it (columns u, ud)"
        )
    m, C = modes.m, modes.damping
    h = float(t[-1] - t[0]) / (len(t) - 1)
    # x = (u, u', y and its three derivatives) of a cubic piece, whose third is constant
    size = 2 * m + 24
    A = np.zeros((size, size))
    A[:m, m : 2 * m] = np.eye(m)
    A[m : 2 * m, :m], A[m : 2 * m, m : 2 * m] = -np.diag(modes.omega**2), -C[6:, 6:]
    A[m : 2 * m, 2 * m : 2 * m + 6] = (modes.coupling * modes.omega**2).T
    A[m : 2 * m, 2 * m + 6 : 2 * m + 12] = -C[6:, :6]
    A[2 * m : -6, 2 * m + 6 :] = np.eye(18)
    step = scipy.linalg.expm(A * h)[: 2 * m]
    rise, first, last = np.diff(y, axis=-2), yd[..., :-1, :], yd[..., 1:, :]
    bend = (6 * rise / h - 4 * first - 2 * last) / h
    jerk = (6 * (first + last) - 12 * rise / h) / h**2
    pieces = np.concatenate([y[..., :-1, :], first, bend, jerk], axis=-1)
    driven = pieces @ step[:, 2 * m :].T
    x = np.concatenate([base.attached(y[..., 0, :]), base.attached(yd[..., 0, :])], axis=-1)
    out = [x]
    for k in range(len(t) - 1):
        x = x @ step[:, : 2 * m].T + driven[..., k, :]
        out.append(x)
    stacked = np.stack(out, axis=-2)
    return stacked[..., :m], stacked[..., m:]


def port_energy(
    system: System, y: Array, yd: Array, internal: Internal | None
) -> tuple[Array, Array]:
    """Energy stored in the vehicle and in flexures, and the power that both dissipate."""
    strain, kinetic, power = vehicle_energies(system, y, yd, internal)
    stored = strain + kinetic
    if system.base.body is not None:
        stored = stored + quadratic(system.base.body.spatial(), twist(y, yd))
    return stored, power


def energies(
    system: System,
    t: Array,
    q: Array,
    y: Array,
    yd: Array,
    *,
    duration: float,
    tail: float = TAIL,
    internal: Internal | None = None,
) -> list[Energies]:
    """Energy measures of a stack of runs of one system on one clock.

    Args:
        t: (N,) s from the start of the motion; must reach duration + tail.
        q: (n, N, joints). y, yd: (n, N, 6).
        duration: of the motion [s]. tail: how long after it E_mean reaches [s].
        internal: u and u' (n, N, m) of a base with internal modes; estimated from y and yd
            where they are not given.
    """
    if not (duration >= 0 and tail >= 0):
        raise ParameterError(f"duration and tail must be >= 0 s, got {duration}, {tail}")
    if t[-1] - t[0] < duration + tail - 1e-6:
        raise ParameterError(
            f"E_mean covers the motion and {tail:g} s after it ({duration + tail:g} s), got a"
            f" run of {t[-1] - t[0]:g} s"
        )
    clock = t - t[0]
    if internal is None and system.base.hidden and not system.arm.bends:
        internal = internal_motion(system.base, t, y, yd)
    parts = base_energy(system, q, y, yd, internal)
    total = parts.total
    stored, power = port_energy(system, y, yd, internal)
    work = stored[:, -1] - stored[:, 0] + np.trapezoid(power, clock, axis=-1)
    window = clock <= duration + tail + 1e-9
    end = int(np.searchsorted(clock, duration - 1e-9))
    peak = total.max(axis=-1)
    out = []
    for i in range(len(total)):
        above = np.flatnonzero(total[i] > SETTLED * peak[i])
        last = int(above[-1]) if len(above) else -1
        settled = math.inf if last + 1 >= len(clock) else float(clock[last + 1])
        out.append(
            Energies(
                E_mean=float(np.trapezoid(total[i, window], clock[window]) / clock[window][-1]),
                E_res=float(total[i, end]),
                E_peak=float(peak[i]),
                E_strain_peak=float(parts.strain[i].max()),
                E_int=float(np.trapezoid(parts.strain[i], clock)),
                W_port=float(work[i]),
                t_5=settled,
            )
        )
    return out


def log_energies(log: RunLog, *, duration: float | None = None, tail: float = TAIL) -> Energies:
    """Return the energy measures of a run log, with the system named in its metadata.

    A log without base rates has them differentiated from the pose (second-order differences).

    Args:
        log: the run.
        duration: of the motion [s]; default the log's own.
        tail: time after it that E_mean covers [s].
    """
    system = system_of(log)
    if duration is None:
        duration = motion_end(log)
    yd = base_rate(log)
    modes = internal_of(system, log)
    internal = None if modes is None else (modes[0][None], modes[1][None])
    motion = log.t, log.q[None], log.y[None], yd[None]
    return energies(system, *motion, duration=duration, tail=tail, internal=internal)[0]


def log_base_energy(log: RunLog, system: System | None = None) -> BaseEnergy:
    """Return the base energy of a run log at each sample.

    Internal modes as the log holds them, else as the motion of the base lets one estimate.

    Args:
        log: the run.
        system: that it is of; None: as its metadata say.
    """
    system = system or system_of(log)
    return base_energy(system, log.q, log.y, base_rate(log), internal_of(system, log))


def internal_of(system: System, log: RunLog) -> Internal | None:
    """Motion of internal modes as a log holds it, else estimated; None of a base without.

    Args:
        system: that the log is of.
        log: the run.
    """
    if log.u is not None and log.ud is not None:
        return log.u, log.ud
    if system.base.internal is None or system.arm.bends:
        return None
    return internal_motion(system.base, log.t, log.y, base_rate(log))


def system_of(log: RunLog) -> System:
    """The system that a log's metadata name."""
    if "system" not in log.meta:
        raise ParameterError("the energy of a log needs the entry `system` in its metadata")
    return System.from_dict(log.meta["system"], "log metadata: system")


def motion_end(log: RunLog) -> float:
    """Duration of the commanded motion [s]: metadata, else the last moving command."""
    if "duration" in log.meta:
        return float(log.meta["duration"])
    moving = np.flatnonzero((np.abs(log.v_cmd) > 1e-9).any(axis=1))
    return float(log.t[moving[-1]] - log.t[0]) if len(moving) else 0.0


def base_rate(log: RunLog) -> Array:
    """(N, 6) base pose rate: recorded, or differentiated from the pose."""
    if log.yd is not None:
        return log.yd
    return np.asarray(np.gradient(log.y, log.t, axis=0), dtype=np.float64)
