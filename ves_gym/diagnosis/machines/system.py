"""A `System` as a machine with ports: arm, force sensor, weight estimate, admittance, platform.

Every port is the simulator's own component, run alone on measured input.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import scipy

from ves_gym._util.params import Array
from ves_gym._util.signals import differentiated, zero_order_hold
from ves_gym.diagnosis.data.measured_run import Kinematics, Run
from ves_gym.diagnosis.machines.base import WRENCH, Nuisance, Port
from ves_gym.diagnosis.machines.drift import SlowPath
from ves_gym.diagnosis.machines.nuisance_priors import system_nuisances
from ves_gym.diagnosis.machines.platform_response import platform_response
from ves_gym.diagnosis.machines.presliding import Presliding
from ves_gym.diagnosis.machines.torque_balance import torque_residual
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.dynamics import inverse_dynamics, newton_euler
from ves_gym.mechanics.gravity import gravity_vector, gravity_wrench
from ves_gym.mechanics.spatial import AXES, body_wrench, matvec, rate_matrix, twist, twist_rate
from ves_gym.mechanics.vehicle import Oscillator
from ves_gym.system.deviations import Delays, LoopParameters
from ves_gym.system.effect import Effect, joint_torque
from ves_gym.system.system import System

_N, _M = ("N",) * 3 + ("N m",) * 3, ("m",) * 3 + ("rad",) * 3
# Of a channel's own movement: no description is better. A vehicle is never quite six
# coordinates, and what the computer takes in and gives out is known to the last digit.
_FLOOR = {"admittance": 8e-3}
_LEAST = 1e-3
_LOADS = 40  # remembered: both ports of an arm ask, with one law of friction after another
_SEEN = {  # port -> the signal that its residual is a part of
    "joint": "tau",
    "servo": "tau",
    "wrench": "w",
    "gravity": "weight",
    "admittance": "w",
    "platform": "y",
    "base": "w",
}


@dataclass(frozen=True)
class SystemVariant:
    """A system, and what of it has no place in one: courses of drift, forms of friction."""

    system: System
    paths: tuple[SlowPath, ...] = ()
    presliding: tuple[Presliding, ...] = ()


class SystemMachine:
    """Ports of a system in either mode."""

    def __init__(self, system: System) -> None:
        self.system = system
        self.nominal = SystemVariant(system)
        n = system.arm.n
        joints = tuple(f"tau_{i + 1}" for i in range(n))
        self.name = f"{system.arm.name} on {system.vehicle.kind}, {system.mode}"
        ports = [
            Port(
                "joint",
                "motor torque less what the motion takes",
                joints,
                ("N m",) * n,
                ("q", "tau", "y"),
            ),
            Port(
                "servo",
                "motor torque less what the controller asks",
                joints,
                ("N m",) * n,
                ("q_cmd", "v_cmd", "q", "tau", "controller"),
                ("q_cmd", "v_cmd"),
            ),
            Port("wrench", "sensor reading less the arm's wrench", WRENCH, _N, ("q", "y", "w")),
        ]
        if system.mode == "emulated" and system.emulator_settings.operation == "microgravity":
            ports.append(
                Port(
                    "gravity",
                    "weight estimate subtracted less the stated one",
                    WRENCH,
                    _N,
                    ("q", "y", "weight"),
                )
            )
        if system.mode == "emulated":
            ports += [
                Port(
                    "admittance",
                    "wrench taken in less what moves the vehicle",
                    WRENCH,
                    _N,
                    ("w", "weight", "y_cmd"),
                    ("w", "weight"),
                ),
                Port(
                    "platform",
                    "pose less the platform's answer to its command",
                    AXES,
                    _M,
                    ("y", "y_cmd"),
                    ("y_cmd",),
                ),
            ]
        else:
            ports.append(
                Port("base", "arm's wrench less what moves the vehicle", WRENCH, _N, ("y", "w"))
            )
        self.ports = tuple(ports)

    def model(self, effects: Sequence[Effect | SlowPath | Presliding]) -> SystemVariant:
        """Return the description with effects added."""
        paths = tuple(e for e in effects if isinstance(e, SlowPath))
        grown = tuple(e for e in effects if isinstance(e, Presliding))
        added = tuple(e for e in effects if isinstance(e, Effect))
        system = self.system
        if added:
            system = system.replace(effects=(*system.effects, *added))
        return SystemVariant(system, paths, grown)

    def floor(self, run: Run, port: str) -> Array:
        """Return (c,) standard deviation below which a residual of the port means nothing."""
        signal = run[_SEEN[port]]
        size = np.asarray(signal.std(axis=-2))
        kinds = np.array_split(size, max(1, len(size) // 3))  # forces and moments apart
        share = _FLOOR.get(port, _LEAST)
        return share * np.concatenate([np.full(len(k), max(k.max(), 1e-12)) for k in kinds])

    def stretch(self, runs: Sequence[Run]) -> float:
        """Return the part of its stroke that a leg uses at most in the runs; 0 without legs."""
        commands = [np.reshape(run["y_cmd"], (-1, 6)) for run in runs if "y_cmd" in run]
        if self.system.mode != "emulated" or not commands:
            return 0.0
        stewart = self.system.emulator_settings.stewart
        home = stewart.home_lengths
        change = stewart.leg_lengths(np.concatenate(commands)) - home
        room = np.where(change > 0, stewart.length_max - home, home - stewart.length_min)
        return float((np.abs(change) / room).max())

    @cached_property
    def nuisances(self) -> tuple[Nuisance, ...]:
        """Small errors of any description of such a machine."""
        return tuple(
            dataclasses.replace(k, model=SystemVariant(k.model))
            for k in system_nuisances(self.system)
        )

    def residuals(
        self, run: Run, models: Sequence[SystemVariant], ports: Sequence[str]
    ) -> dict[str, Array]:
        """Return (m, ..., T, c) per port, as `Machine.residuals`."""
        systems = [m.system for m in models]
        residual_of = {
            "servo": self._servo,
            "wrench": self._wrench,
            "gravity": self._gravity,
            "admittance": self._vehicle,
            "base": self._vehicle,
        }
        out = {
            name: np.stack([residual_of[name](run, system) for system in systems])
            for name in ports
            if name in residual_of
        }
        if "joint" in ports:
            out["joint"] = np.stack([self._joint(run, model) for model in models])
        if "platform" in ports:
            out["platform"] = self._platform(run, systems)
        for k, model in enumerate(models):
            for path in model.paths if "wrench" in ports else ():
                direction = self._to_wrench[:, path.channel]
                out["wrench"][k] -= path.of(run)[:, None] * direction
        return out

    # ------------------------------------------------------------------- arm

    def _joint(self, run: Run, model: SystemVariant) -> Array:
        """Motor torque less what the motion takes (..., T, n)."""
        q, v, _ = run.joints
        effects, most = model.system.effects, self.system.arm.column("tau_max")

        def laws(tau: Array) -> Array:
            out = joint_torque(effects, q, v, tau, most)
            for p in model.presliding:
                out = out + p.built_up(joint_torque([p.effect], q, v, tau, most), v, run.dt)
            return out

        every = (*effects, *(p.effect for p in model.presliding))
        return torque_residual(run["tau"], self._load(run, model.system)[0], every, laws)

    def _wrench(self, run: Run, system: System) -> Array:
        """Sensor reading less the arm's wrench (..., T, 6)."""
        wrench = self._load(run, system)[1]
        if system.mode == "ideal":
            return np.asarray(run["w"] - wrench)
        return np.asarray(run["w"] - self._sensed(system, wrench, run.dt))

    def _load(self, run: Run, system: System) -> tuple[Array, Array]:
        """Torque that the motors must give (..., T, n), and wrench of the arm (..., T, 6)."""
        arm = system.actual.arm
        old = float(Delays.of(system).measurement[0])
        loads = _memoized(run, "loads", dict)
        if (arm, old) in loads:
            return loads[arm, old]  # type: ignore[no-any-return]
        q, v, a = run.joints
        if old:
            q, v, a = differentiated(run["q"], run.dt, run.band, ahead=old)
        rotors = arm.column("rotor_inertia")
        weighty = system.mode == "emulated"
        balanced = weighty and system.emulator_settings.joint_balance
        links = Kinematics(q, v, a)
        base = _memoized(run, "base", lambda: _base_motion(run.base))
        tau, wrench = _dynamics(arm, links, run.base.x, base, weighty)
        if any(link.gear is not None for link in arm.links):  # links lag their motors
            torque = tau  # what rigid links would take, where no torque is logged
            if "tau" in run:
                torque = run["tau"]
                if balanced:
                    torque = torque + _weight(self.system.arm, q, run.base.x)
            bent = _deflections(arm, torque - rotors * a, run.dt)
            gear_motion = differentiated(bent, run.dt, run.band)
            links = Kinematics(*(x - d for x, d in zip(links, gear_motion, strict=True)))
            tau, wrench = _dynamics(arm, links, run.base.x, base, weighty)
            tau = tau + rotors * (a - links.a)  # rotors move with the motors
        if balanced:
            tau = tau - _weight(self.system.arm, q, run.base.x)
        loads[arm, old] = tau, wrench
        if len(loads) > _LOADS:
            del loads[list(loads)[1]]  # the first is the description's own
        return tau, wrench

    def _servo(self, run: Run, system: System) -> Array:
        """Motor torque less what the controller asks for (..., T, n)."""
        arm = self.system.arm
        gains = run.meta["controller"]
        delays = Delays.of(system)
        command = differentiated(
            run["q_cmd"], run.dt, run.band, ahead=-float(delays.command[0])
        )
        q, v, _ = run.joints
        v = _lagged(v, delays.lag[0], run.dt)
        demand = (command[0] - q) * gains["kp"] + (command[1] - v) * gains["kd"]
        if gains.get("feedforward", False):
            demand = demand + inverse_dynamics(arm, *command)[0]
        most = arm.column("tau_max")
        return np.asarray(run["tau"] - np.clip(demand, -most, most))

    def _sensed(self, system: System, wrench: Array, dt: float) -> Array:
        """Return the sensor's reading of a wrench (..., T, 6)."""
        spec = system.emulator_settings.sensor
        p = (
            LoopParameters.nominal(system.arm, system.emulator_settings, 1)
            .edited(system)
            .sensor
        )
        filtered = _butterworth(wrench, float(p.cutoff[0]), dt)
        to_signal = (np.eye(6) + p.matrix[0]) @ spec.frame
        signal = filtered @ to_signal.T + p.bias[0] - np.array(spec.zero)
        return np.asarray(signal @ self._to_wrench.T)

    @cached_property
    def _to_wrench(self) -> Array:
        """(6, 6) from the sensor's signals to the wrench that is logged."""
        if self.system.mode == "ideal":
            return np.eye(6)
        spec = self.system.emulator_settings.sensor
        return np.asarray(np.linalg.solve(spec.frame, np.array(spec.calibration)))

    def _gravity(self, run: Run, system: System) -> Array:
        """Estimate subtracted by the machine less the stated estimate, (..., T, 6)."""
        spec, q, y = system.emulator_settings, run.joints.x, run.base.x
        p = LoopParameters.nominal(system.arm, spec, 1).edited(system)
        late = float(p.gravity_delay[0])
        if late:
            q, y = (
                differentiated(run[k], run.dt, run.band, ahead=-late)[0] for k in ("q", "y")
            )
        pose = y.copy()
        pose[..., 3:] += p.gravity_tilt[0]
        estimate = gravity_wrench(
            system.arm, q, gravity_vector(pose), p.gravity_mass[0], p.gravity_P[0]
        )
        return np.asarray(run["weight"] - estimate)

    def _vehicle(self, run: Run, system: System) -> Array:
        """Wrench taken in less what moves the vehicle (..., T, 6)."""
        base = system.actual.base
        late = system.emulator_settings.delay if system.mode == "emulated" else 0
        motion, turn, force = _memoized(
            run, ("vehicle", system.mode, late), lambda: _moved(run, system.mode, late)
        )
        y, yd, ydd = motion
        force = force - (ydd @ base.M.T + yd @ base.D.T + y @ base.K.T)
        if base.body is not None:
            force = force - matvec(turn, body_wrench(base.body.spatial(), y, yd, ydd))
        if base.drag is not None:
            force = force - base.drag * np.abs(yd) * yd
        for mass in base.extra:
            way = np.concatenate([mass.direction, np.zeros(3)])
            force = force + _carried(mass, ydd @ way, run.dt)[..., None] * way
        return np.asarray(force)

    def _platform(self, run: Run, systems: Sequence[System]) -> Array:
        """Pose less the platform's answer to its command (m, ..., T, 6), all models at once."""
        copies, length = run["y"].shape[:-2], run.length
        k, m = int(np.prod(copies, dtype=int)), len(systems)
        settings = self.system.emulator_settings
        rows_of = [LoopParameters.nominal(s.arm, settings, k).edited(s) for s in systems]
        p = LoopParameters.stacked(rows_of)

        def rows(name: str) -> Array:
            x = run[name].reshape(k, length, 6)
            return np.broadcast_to(x, (m, k, length, 6)).reshape(m * k, length, 6)

        y, y_cmd = rows("y"), rows("y_cmd")
        delay = p.platform_delay
        command = np.empty((*y_cmd.shape[:2], 12))
        for late in np.unique(delay):
            selected = delay == late
            x, rate, _ = differentiated(y_cmd[selected], run.dt, run.band, ahead=-float(late))
            command[selected] = np.concatenate([x if late else y_cmd[selected], rate], axis=-1)
        start = differentiated(y[:, : 4 * run.window.skip], run.dt, run.band)[1][:, 0]
        out = y - platform_response(self.system, p, command, y[:, 0], start)
        return out.reshape(m, *copies, length, 6)


def _memoized(run: Run, key: Any, make: Callable[[], Any]) -> Any:
    """Return a quantity that follows from a run's signals alone, computed once."""
    if key not in run.memory:
        run.memory[key] = make()
    return run.memory[key]


def _lagged(v: Array, lag: Array, dt: float) -> Array:
    """Rates (..., T, n) through a first-order low-pass each, of time constants (n,) [s]."""
    out = v.copy()
    for i in np.flatnonzero(lag):
        low = ([1.0], [float(lag[i]), 1.0])
        b, a, _ = scipy.signal.cont2discrete(low, dt, method="foh")
        first = v[..., :1, i]  # at rest under the first rate
        zi = scipy.signal.lfilter_zi(np.ravel(b), a) * first
        out[..., i] = scipy.signal.lfilter(np.ravel(b), a, v[..., i], axis=-1, zi=zi)[0]
    return out


def _moved(run: Run, mode: str, late: int) -> tuple[Kinematics, Array, Array]:
    """Return the vehicle's motion, the wrench along its rates (..., T, 6), and their map."""
    if mode == "ideal":
        motion, force = run.base, run["w"]
    else:
        motion = Kinematics(*differentiated(run["y_cmd"], run.dt, run.band))
        force = run["w"] - run["weight"]
    turn = np.swapaxes(rate_matrix(motion.x), -1, -2)
    force = matvec(turn, force)
    if mode == "emulated":  # a reading acts for one period, `late` periods later
        force = zero_order_hold(force, run.dt, run.band, late * run.dt)
    return motion, turn, force


def _base_motion(base: Kinematics) -> tuple[Array, Array, Array]:
    """Spin, its rate, and acceleration of the platform's origin, platform axes; (..., T, 3)."""
    y, yd, ydd = base
    v, vd = twist(y, yd), twist_rate(y, yd, ydd)
    spin, turn = v[..., 3:], vd[..., 3:]
    return spin, turn, vd[..., :3] + np.cross(spin, v[..., :3])


def _columns(x: Array) -> Any:
    return tuple(np.moveaxis(x, -1, 0))


def _dynamics(
    arm: Arm, joints: Kinematics, pose: Array, base: tuple[Array, ...], weighty: bool
) -> Any:
    """Torque (..., T, n) and wrench on the base (..., T, 6) of a measured motion."""
    spin, turn, accel = base
    if weighty:
        accel = accel - gravity_vector(pose)
    tau, force, moment = newton_euler(
        arm,
        *(list(_columns(part)) for part in joints),
        spin=_columns(spin),
        turn=_columns(turn),
        accel=_columns(accel),
    )
    shape = joints.x.shape[:-1]
    stack = [
        np.stack([np.broadcast_to(k, shape) for k in part], -1)
        for part in (tau, (*force, *moment))
    ]
    return stack[0], -stack[1]


def _weight(arm: Arm, q: Array, pose: Array) -> Array:
    """Joint torque (..., T, n) that carries the links."""
    still = Kinematics(q, np.zeros_like(q), np.zeros_like(q))
    zeros = np.zeros((*pose.shape[:-1], 3))
    out: Array = _dynamics(arm, still, pose, (zeros, zeros, zeros), True)[0]
    return out


def _carried(mass: Oscillator, shaken: Array, dt: float) -> Array:
    """Force (..., T) on what carries a mass on a spring and is accelerated, from rest."""
    top = [mass.damping * mass.mass, mass.stiffness * mass.mass]
    system = (top, [mass.mass, mass.damping, mass.stiffness])
    b, a, _ = scipy.signal.cont2discrete(system, dt, method="foh")
    return -np.asarray(scipy.signal.lfilter(np.ravel(b), np.ravel(a), shaken, axis=-1))


def _deflections(arm: Arm, torque: Array, dt: float) -> Array:
    """Angle by which gears give (..., T, n) under the torque through them."""
    from ves_gym.diagnosis.machines.recursions import deflection  # numba takes a second to load

    out = np.zeros_like(torque)
    for i, link in enumerate(arm.links):
        if link.gear is not None:
            gear = link.gear
            out[..., i] = deflection(
                torque[..., i], 1 / gear.compliance, gear.damping, gear.gap / 2, dt
            )
    return out


def _butterworth(x: Array, cutoff: float, dt: float) -> Array:
    """Second-order low-pass along time, exact for inputs linear between samples, from rest."""
    b, a, zi = _coefficients(cutoff, dt)
    start = np.moveaxis(x[..., :1, :], -2, -1)  # at rest under the first value
    shape = (*x.shape[:-2], 2, x.shape[-1])
    initial = np.broadcast_to(zi[:, None] * np.swapaxes(start, -1, -2), shape)
    return np.asarray(scipy.signal.lfilter(b, a, x, axis=-2, zi=initial)[0])


@lru_cache(maxsize=64)
def _coefficients(cutoff: float, dt: float) -> tuple[Array, Array, Array]:
    w = 2 * np.pi * cutoff
    system = ([w**2], [1.0, np.sqrt(2) * w, w**2])
    b, a, _ = scipy.signal.cont2discrete(system, dt, method="foh")
    b, a = np.ravel(b), np.ravel(a)
    return b, a, scipy.signal.lfilter_zi(b, a)
