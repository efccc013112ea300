"""A `System` as a machine with ports: arm, force sensor, weight estimate, admittance, platform.

Every port is the simulator's own component, run alone on measured input.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import scipy

from ves_gym.core.arm import Arm
from ves_gym.core.dynamics import inertia, inverse_dynamics, newton_euler
from ves_gym.core.effect import Effect, joint_torque
from ves_gym.core.gravity import GravityModel, gravity_vector, minimal_model
from ves_gym.core.laboratory import Laboratory, Parameters
from ves_gym.core.params import Array
from ves_gym.core.platform import PoseFollower, PoseServo
from ves_gym.core.spatial import body_wrench, matvec, rate_matrix, twist, twist_rate
from ves_gym.core.system import System
from ves_gym.core.vehicle import Oscillator
from ves_gym.discrepancy.machine import Nuisance, Port
from ves_gym.discrepancy.runs import Kinematics, Run
from ves_gym.discrepancy.signals import differentiated, held
from ves_gym.effects import (
    BaseDamping,
    BaseExtraMode,
    BaseStiffness,
    BaseVirtualMass,
    GravityMass,
    GravityMoment,
    JointCoulomb,
    JointDriveGain,
    JointRotorInertia,
    JointTorqueOffset,
    JointViscous,
    PlatformBandwidth,
    PlatformDamping,
    SensorBias,
    SensorCalibration,
    SensorDrift,
    SensorLag,
)

_WRENCH = ("F_x", "F_y", "F_z", "M_x", "M_y", "M_z")
_POSE = ("x", "y", "z", "phi_x", "phi_y", "phi_z")
_N, _M = ("N",) * 3 + ("N m",) * 3, ("m",) * 3 + ("rad",) * 3
# Of a channel's own movement: no description is better. A vehicle is never quite six
# coordinates, and what the computer takes in and gives out is known to the last digit.
_FLOOR = {"admittance": 8e-3}
_LEAST = 1e-3

# Tolerances of a careful description, as standard deviations: 0.6 of the bound one would state.
_MASS, _INERTIA, _GAIN, _FILTER = 0.0006, 0.006, 0.0006, 0.006  # relative
_COM, _FRICTION, _OFFSET = 1.2e-4, 0.03, 0.018  # m; N m; N, N m
_WEIGHT, _MOMENT = 0.03, 0.006  # kg, kg m, of the weight estimate
_INNER, _RESIDUAL = (8.0, 8.5, 9.5), 0.7  # Hz, kg: modes that the vehicle's model leaves out
_BASE, _LOSS = 0.0012, 0.006  # relative, of the base's mass and stiffness; of its damping


@dataclass(frozen=True)
class SlowPath:
    """One course that a drifting sensor signal took: per run, weights of slow cosines."""

    channel: int
    weights: tuple[tuple[str, tuple[float, ...]], ...]  # run -> weight of each

    def of(self, run: Run) -> Array:
        """(T,) in this run; none in one it does not know."""
        weights = dict(self.weights).get(run.name, ())
        t = (np.arange(run.length) + 0.5) / run.length
        waves = (w * np.cos(np.pi * (k + 1) * t) for k, w in enumerate(weights))
        return np.asarray(sum(waves, np.zeros(run.length)))

    @property
    def effect(self) -> SensorDrift:
        """A drift of this size (root mean square over the runs)."""
        power = [sum(w * w for w in each) / 2 for _, each in self.weights]
        signal = np.zeros(6)
        signal[self.channel] = np.sqrt(np.mean(power))
        return SensorDrift(force=tuple(signal[:3].tolist()), moment=tuple(signal[3:].tolist()))


@dataclass(frozen=True)
class Variant:
    """A system, and what drift did to it in these runs."""

    system: System
    paths: tuple[SlowPath, ...] = ()


class SystemMachine:
    """Ports of a system in either mode."""

    def __init__(self, system: System) -> None:
        self.system = system
        self.nominal = Variant(system)
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
                ("q_cmd", "v_cmd", "q", "tau"),
                ("q_cmd", "v_cmd"),
            ),
            Port(
                "wrench", "sensor reading less the arm's wrench", _WRENCH, _N, ("q", "y", "w")
            ),
        ]
        if system.mode == "emulated":
            ports += [
                Port(
                    "gravity",
                    "weight estimate subtracted less the stated one",
                    _WRENCH,
                    _N,
                    ("q", "y", "weight"),
                ),
                Port(
                    "admittance",
                    "wrench taken in less what moves the vehicle",
                    _WRENCH,
                    _N,
                    ("w", "weight", "y_cmd"),
                    ("w", "weight"),
                ),
                Port(
                    "platform",
                    "pose less the platform's answer to its command",
                    _POSE,
                    _M,
                    ("y", "y_cmd"),
                    ("y_cmd",),
                ),
            ]
        else:
            ports.append(
                Port(
                    "base", "arm's wrench less what moves the vehicle", _WRENCH, _N, ("y", "w")
                )
            )
        self.ports = tuple(ports)

    def model(self, effects: Sequence[Effect | SlowPath]) -> Variant:
        """The description with effects added."""
        paths = tuple(e for e in effects if isinstance(e, SlowPath))
        more = tuple(e for e in effects if not isinstance(e, SlowPath))
        system = self.system
        if more:
            system = system.replace(effects=(*system.effects, *more))
        return Variant(system, paths)

    def floor(self, run: Run, port: str) -> Array:
        """(c,) standard deviation below which a residual of the port means nothing."""
        signal = {
            "joint": "tau",
            "servo": "tau",
            "wrench": "w",
            "gravity": "w",
            "base": "w",
            "platform": "y",
        }
        signal |= {"gravity": "weight", "admittance": "w"}
        seen = run[signal[port]]
        size = np.asarray(seen.std(axis=-2))
        kinds = np.array_split(size, max(1, len(size) // 3))  # forces and moments apart
        share = _FLOOR.get(port, _LEAST)
        return share * np.concatenate([np.full(len(k), max(k.max(), 1e-12)) for k in kinds])

    @cached_property
    def nuisances(self) -> tuple[Nuisance, ...]:
        """Small errors of any description of such a machine."""
        return tuple(
            dataclasses.replace(k, model=Variant(k.model)) for k in _nuisances(self.system)
        )

    def residuals(
        self, run: Run, models: Sequence[Variant], ports: Sequence[str]
    ) -> dict[str, Array]:
        """(m, ..., T, c) per port: the residual under each of m models."""
        systems = [m.system for m in models]
        out: dict[str, Array] = {}
        if "joint" in ports or "wrench" in ports:
            for name, port in (("joint", self._joint), ("wrench", self._wrench)):
                if name in ports:
                    out[name] = np.stack([port(run, s) for s in systems])
        if "wrench" in ports:
            for k, model in enumerate(models):
                for path in model.paths:
                    out["wrench"][k, ..., path.channel] -= path.of(run)
        if "gravity" in ports:
            out["gravity"] = np.stack([self._gravity(run, s) for s in systems])
        if "servo" in ports:
            out["servo"] = np.stack([self._servo(run, s) for s in systems])
        for name in ("base", "admittance"):
            if name in ports:
                out[name] = np.stack([self._vehicle(run, s) for s in systems])
        if "platform" in ports:
            out["platform"] = self._batched(run, systems, self._platform)
        return out

    # ------------------------------------------------------------------- arm

    def _joint(self, run: Run, system: System) -> Array:
        """Motor torque less what the motion takes (..., T, n)."""
        q, v, _ = run.joints
        tau, most = run["tau"], self.system.arm.column("tau_max")
        return np.asarray(
            tau + joint_torque(system.effects, q, v, tau, most) - self._load(run, system)[0]
        )

    def _wrench(self, run: Run, system: System) -> Array:
        """Sensor reading less the arm's wrench (..., T, 6)."""
        wrench = self._load(run, system)[1]
        if system.mode == "ideal":
            return np.asarray(run["w"] - wrench)
        return np.asarray(run["w"] - self._sensed(system, wrench, run.dt))

    def _load(self, run: Run, system: System) -> tuple[Array, Array]:
        """Torque that the motors must give (..., T, n), and wrench of the arm (..., T, 6)."""
        arm = system.actual.arm
        old = _total(system, "joint/measurement_delay", "delay")
        plain = arm is self.system.actual.arm and not old
        if plain and self in run.memory:
            return run.memory[self]  # type: ignore[no-any-return]
        q, v, a = run.joints
        if old:
            q, v, a = differentiated(run["q"], run.dt, run.band, ahead=old)
        rotors = arm.column("rotor_inertia")
        weighty = system.mode == "emulated"
        links = Kinematics(q, v, a)
        tau, wrench = _dynamics(arm, links, run.base, weighty)
        if any(link.gear is not None for link in arm.links):  # links lag their motors
            bent = _deflections(arm, q, tau - rotors * a, run.dt)
            more = differentiated(bent, run.dt, run.band)
            links = Kinematics(*(x - d for x, d in zip(links, more, strict=True)))
            tau, wrench = _dynamics(arm, links, run.base, weighty)
            tau = tau + rotors * (a - links.a)  # rotors move with the motors
        if weighty and system.laboratory.joint_balance:
            tau = tau - _weight(self.system.arm, Kinematics(q, v, a), run.base)
        if plain:
            run.memory[self] = tau, wrench
        return tau, wrench

    def _servo(self, run: Run, system: System) -> Array:
        """Motor torque less what the controller asks for (..., T, n)."""
        arm = self.system.arm
        told = run.meta["controller"]
        late = _total(system, "command/delay", "delay")
        command = differentiated(run["q_cmd"], run.dt, run.band, ahead=-late)
        q, v, _ = run.joints
        asked = (command[0] - q) * told["kp"] + (command[1] - v) * told["kd"]
        if told.get("feedforward", False):
            asked = asked + inverse_dynamics(arm, *command)[0]
        most = arm.column("tau_max")
        return np.asarray(run["tau"] - np.clip(asked, -most, most))

    def _sensed(self, system: System, wrench: Array, dt: float) -> Array:
        """What the sensor would report of a wrench (..., T, 6)."""
        spec = system.laboratory.sensor
        p = Parameters.nominal(system.arm, system.laboratory, 1).edited(system).sensor
        filtered = _butterworth(wrench, float(p.cutoff[0]), dt)
        to_signal = (np.eye(6) + p.matrix[0]) @ spec.frame
        to_wrench = np.linalg.solve(spec.frame, np.array(spec.calibration))
        signal = filtered @ to_signal.T + p.bias[0] - np.array(spec.zero)
        return np.asarray(signal @ to_wrench.T)

    def _gravity(self, run: Run, system: System) -> Array:
        """Estimate subtracted by the machine less the stated estimate, (..., T, 6)."""
        lab = Laboratory(system, 1, [np.random.default_rng(0)])
        shape = run["q"].shape[:-1]
        q, y = run.joints.x.reshape(-1, system.arm.n), run.base.x.reshape(-1, 6)
        p = lab.parameters
        if p.gravity_delay[0] > 0:
            q, y = (self._late(k, shape, p.gravity_delay[0] / run.dt) for k in (q, y))
        lab_rows = np.zeros(len(q), np.intp)
        estimate = lab._estimate(q, y, lab_rows)
        return np.asarray(run["weight"] - estimate.reshape(*shape, 6))

    @staticmethod
    def _late(x: Array, shape: tuple[int, ...], samples: float) -> Array:
        whole = x.reshape(*shape, -1)
        at = np.arange(shape[-1])
        late = np.clip(at - samples, 0, None)
        low = np.floor(late).astype(int)
        part = (late - low)[:, None]
        high = np.minimum(low + 1, shape[-1] - 1)
        mixed = (1 - part) * whole[..., low, :] + part * whole[..., high, :]
        return np.asarray(mixed.reshape(-1, x.shape[-1]))

    def _vehicle(self, run: Run, system: System) -> Array:
        """Wrench taken in less what moves the vehicle (..., T, 6)."""
        base = system.actual.base
        if system.mode == "ideal":
            motion, force = run.base, run["w"]
        else:
            told = run["y_cmd"]
            motion = Kinematics(*differentiated(told, run.dt, run.band))
            force = run["w"] - run["weight"]
        turn = np.swapaxes(rate_matrix(motion.x), -1, -2)
        force = matvec(turn, force)
        if system.mode == "emulated":  # a reading acts for one period, `delay` periods later
            late = (system.laboratory.delay) * run.dt
            force = held(force, run.dt, run.band, late)
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

    # -------------------------------------------------------------- tick loop

    def _batched(
        self, run: Run, systems: Sequence[System], port: Callable[..., Array]
    ) -> Array:
        """One tick loop for all models and all copies of the run."""
        copies = run["y_cmd"].shape[:-2]
        k = int(np.prod(copies, dtype=int))
        m = len(systems)
        everyone = [s for s in systems for _ in range(k)]
        lab = Laboratory(self.system, m * k, [np.random.default_rng(0)] * (m * k))
        if any(s.effects for s in systems):
            lab.prepare(np.arange(m * k), everyone)()

        def rows(name: str) -> Array:
            x = run[name].reshape(k, *run[name].shape[-2:])
            return np.broadcast_to(x, (m, *x.shape)).reshape(m * k, *x.shape[1:])

        out = port(run, lab, rows)
        return out.reshape(m, *copies, *out.shape[1:])

    def _platform(self, run: Run, lab: Laboratory, rows: Callable[[str], Array]) -> Array:
        y, told = rows("y"), rows("y_cmd")
        delay = lab.parameters.platform_delay
        command = np.empty((*told.shape[:2], 12))
        for late in np.unique(delay):
            some = delay == late
            x, rate, _ = differentiated(told[some], run.dt, run.band, ahead=-float(late))
            command[some] = np.concatenate([x if late else told[some], rate], axis=-1)
        start = differentiated(y[:, : 4 * run.window.skip], run.dt, run.band)[1][:, 0]
        everyone = np.arange(lab.n)
        lab.reset(everyone, np.zeros((lab.n, self.system.arm.n)), y[:, 0], start)
        short = np.flatnonzero(
            (lab.parameters.platform_travel > 0) | (lab.parameters.platform_speed > 0)
        )
        for k in range(run.length) if len(short) else ():
            command[short, k] = lab.within_reach(command[short, k], short)
            lab.state.told[short] = command[short, k]
        lab.follower.reset(everyone, y[:, 0], start)
        out = np.zeros_like(y)
        if isinstance(lab.follower, PoseFollower):
            found = lab.follower.poses(command[:, 1:, :6], command[:, 1:, 6:])
            out[:, 1:] = y[:, 1:] - found
            return out
        for k in range(1, run.length):
            lab.follower.advance(command[:, k, :6], command[:, k, 6:])
            out[:, k] = y[:, k] - lab.follower.measured()
        return out


def _nuisances(system: System) -> Iterator[Nuisance]:
    """What any description of such a machine is off by: its tolerances."""
    arm = system.arm
    both = ("joint", "wrench")

    def heavier(i: int, **changes: Any) -> System:
        links = list(arm.links)
        own = dataclasses.replace(links[i].inertial, **changes)
        links[i] = dataclasses.replace(links[i], inertial=own)
        return system.replace(arm=dataclasses.replace(arm, links=tuple(links)))

    def effect(name: str, ports: str, step: float, std: float, *made: Effect) -> Nuisance:
        model = system.replace(effects=(*system.effects, *made))
        return Nuisance(name, tuple(ports.split()), model, step, std)

    for i, link in enumerate(arm.links):
        body, where = link.inertial, f"of link {i + 1}"
        more = heavier(i, mass=1.01 * body.mass)
        yield Nuisance(f"mass {where}", both, more, 0.01, _MASS)
        moments = np.array(body.inertia) * 1.1
        grown = heavier(i, inertia=tuple(map(tuple, moments.tolist())))
        yield Nuisance(f"inertia {where}", both, grown, 0.1, _INERTIA)
        for k, axis in enumerate("xyz"):
            com = list(body.com)
            com[k] += 1e-3
            shifted = heavier(i, com=tuple(com))
            yield Nuisance(f"centre of mass {axis} {where}", both, shifted, 1e-3, _COM)

        def one(value: float, i: int = i) -> tuple[float, ...]:
            return tuple(value if k == i else 0.0 for k in range(arm.n))

        where, joint = f"of joint {i + 1}", "joint"
        small = 0.1 * link.rotor_inertia + 1e-3
        yield effect(
            f"rotor {where}",
            joint,
            small,
            _INERTIA * link.rotor_inertia + 1e-6,
            JointRotorInertia(added=one(small)),
        )
        yield effect(f"gain {where}", joint, 0.01, _GAIN, JointDriveGain(error=one(0.01)))
        yield effect(f"friction {where}", joint, 0.1, _FRICTION, JointCoulomb(torque=one(0.1)))
        yield effect(f"damping {where}", joint, 0.1, _FRICTION, JointViscous(damping=one(0.1)))
        yield effect(f"zero {where}", joint, 0.1, _FRICTION, JointTorqueOffset(torque=one(0.1)))
    base = dataclasses.replace(arm.base, mass=1.01 * arm.base.mass)
    whole = system.replace(arm=dataclasses.replace(arm, base=base))
    yield Nuisance("mass of the arm's foot", ("wrench",), whole, 0.01, _MASS)
    if system.mode == "emulated":
        yield from _laboratory_nuisances(system, effect)
    for k, axis in enumerate("xyz"):  # a vehicle of six coordinates has no inner modes
        way = tuple(float(i == k) for i in range(3))
        for rate in _INNER:
            mode = BaseExtraMode(mass=1.0, frequency=rate, direction=way)
            name = f"inner mode along {axis} near {rate:g} Hz"
            yield effect(name, "base admittance", 1.0, _RESIDUAL, mode)
    for what, kind in (
        ("stiffness", BaseStiffness),
        ("mass", BaseVirtualMass),
        ("damping", BaseDamping),
    ):
        std = _BASE if what != "damping" else _LOSS
        yield effect(f"{what} of the base", "base admittance", 0.01, std, kind(error=0.01))


def _laboratory_nuisances(
    system: System, effect: Callable[..., Nuisance]
) -> Iterator[Nuisance]:
    weight = GravityModel.of(system.arm).wrench(system.arm, np.zeros(system.arm.n), np.zeros(6))
    rest = system.laboratory.sensor.frame @ weight
    for i in range(6):

        def six(value: float, i: int = i) -> dict[str, tuple[float, ...]]:
            out = [value if k == i else 0.0 for k in range(6)]
            return {"force": tuple(out[:3]), "moment": tuple(out[3:])}

        axis = _WRENCH[i]
        yield effect(f"zero of {axis}", "wrench", 0.1, _OFFSET, SensorBias(**six(0.1)))
        error = np.zeros((6, 6))
        error[i, i] = 0.01
        gain = SensorCalibration(error=tuple(map(tuple, error.tolist())))
        zero = SensorBias(**six(-0.01 * float(rest[i])))  # it was zeroed under the arm
        yield effect(f"gain of {axis}", "wrench", 0.01, _GAIN, gain, zero)
    yield effect("sensor filter", "wrench", 0.01, _FILTER, SensorLag(error=0.01))
    if system.laboratory.operation == "microgravity":
        yield effect("weight estimate", "gravity", 0.1, _WEIGHT, GravityMass(error=0.1))
        minimal = minimal_model(system.arm)
        for k, name in enumerate(minimal.names):
            moment = tuple(0.1 if i == k else 0.0 for i in range(minimal.size))
            yield effect(
                f"moment {name} of the estimate",
                "gravity",
                0.1,
                _MOMENT,
                GravityMoment(error=moment),
            )
    if isinstance(system.laboratory.platform, PoseServo):
        for kind, name in ((PlatformBandwidth, "bandwidth"), (PlatformDamping, "damping")):
            yield effect(f"platform {name}", "platform", 0.01, _FILTER, kind(error=0.01))


def _total(system: System, kind: str, field: str) -> float:
    """Sum of a number over the effects of a kind."""
    return float(sum(getattr(e, field) for e in system.effects if e.kind == kind))


def _base_motion(base: Kinematics) -> tuple[Array, Array, Array]:
    """Spin, its rate, and acceleration of the platform's origin, platform axes; (..., T, 3)."""
    y, yd, ydd = base
    v, vd = twist(y, yd), twist_rate(y, yd, ydd)
    spin, turn = v[..., 3:], vd[..., 3:]
    return spin, turn, vd[..., :3] + np.cross(spin, v[..., :3])


def _columns(x: Array) -> Any:
    return tuple(np.moveaxis(x, -1, 0))


def _dynamics(arm: Arm, joints: Kinematics, base: Kinematics, weighty: bool) -> Any:
    """Torque (..., T, n) and wrench on the base (..., T, 6) of a measured motion."""
    spin, turn, accel = _base_motion(base)
    if weighty:
        accel = accel - gravity_vector(base.x)
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


def _weight(arm: Arm, joints: Kinematics, base: Kinematics) -> Array:
    """Joint torque (..., T, n) that carries the links."""
    still = Kinematics(joints.x, np.zeros_like(joints.x), np.zeros_like(joints.x))
    rest = Kinematics(base.x, np.zeros_like(base.x), np.zeros_like(base.x))
    out: Array = _dynamics(arm, still, rest, True)[0]
    return out


def _carried(mass: Oscillator, shaken: Array, dt: float) -> Array:
    """Force (..., T) on what carries a mass on a spring and is accelerated, from rest."""
    top = [mass.damping * mass.mass, mass.stiffness * mass.mass]
    system = (top, [mass.mass, mass.damping, mass.stiffness])
    b, a, _ = scipy.signal.cont2discrete(system, dt, method="foh")
    return -np.asarray(scipy.signal.lfilter(np.ravel(b), np.ravel(a), shaken, axis=-1))


def _deflections(arm: Arm, q: Array, load: Array, dt: float) -> Array:
    """Angle by which gears give (..., T, n) under the torque that rigid links would take."""
    from ves_gym.discrepancy.gears import deflection  # numba takes a second to load

    out = np.zeros_like(load)
    H = inertia(arm, q)
    for i, link in enumerate(arm.links):
        if link.gear is not None:
            own = H[..., 6 + i, 6 + i] - link.rotor_inertia
            gear = link.gear
            out[..., i] = deflection(
                np.ascontiguousarray(own),
                np.ascontiguousarray(load[..., i]),
                1 / gear.compliance,
                gear.damping,
                gear.gap / 2,
                dt,
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
