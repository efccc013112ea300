"""A `System` as a machine with ports: arm, force sensor, weight estimate, admittance, platform.

Every port is the simulator's own component, run alone on measured input.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ves_gym._util.params import Array
from ves_gym._util.signals import differentiated
from ves_gym.diagnosis.data.measured_run import (
    COMMANDED,
    NEAR,
    Kinematics,
    Run,
    cached,
)
from ves_gym.diagnosis.machines.admittance import force_gap
from ves_gym.diagnosis.machines.arm_load import (
    Load,
    MeasuredMotion,
    base_motion,
    bodies_of,
    motion_load,
    weight_torque,
)
from ves_gym.diagnosis.machines.base import WRENCH, Nuisance, Port
from ves_gym.diagnosis.machines.between_samples import (
    BetweenSamples,
    between_samples,
    butterworth,
)
from ves_gym.diagnosis.machines.causes import CompositeCause, split
from ves_gym.diagnosis.machines.clocks import ClockError, clock_errors
from ves_gym.diagnosis.machines.drift import SlowPath, courses
from ves_gym.diagnosis.machines.gear_deflection import (
    backlash_reaction,
    deflections,
    has_free_play,
)
from ves_gym.diagnosis.machines.nuisance_priors import GAIN, system_nuisances
from ves_gym.diagnosis.machines.platform import followed, platform_gap
from ves_gym.diagnosis.machines.pose_noise import PoseNoise, pose_noise
from ves_gym.diagnosis.machines.presliding import Presliding, remembered_friction
from ves_gym.diagnosis.machines.ringing import loop_rings
from ves_gym.diagnosis.machines.servo import commanded_torque_weight, low_passed, servo_gap
from ves_gym.diagnosis.machines.tolerances import LEAST, StatedErrors, with_known
from ves_gym.diagnosis.machines.torque_balance import (
    in_torque_logged,
    through_gears,
    torque_residual,
    windings,
)
from ves_gym.diagnosis.machines.vehicle_answer import answering_force
from ves_gym.diagnosis.machines.vehicle_force import InnerStart, inner_sizes, vehicle_gap
from ves_gym.effects import BaseExtraMode, JointMemory
from ves_gym.effects.joint_drive import Hardened
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.gravity import gravity_vector, gravity_wrench
from ves_gym.mechanics.spatial import AXES
from ves_gym.mechanics.vehicle import InternalModes
from ves_gym.system.deviations import LoopParameters
from ves_gym.system.effect import BaseEffect, Effect, TorqueEffect, joint_torque
from ves_gym.system.system import System

# Of a channel's movement: a computer's inputs and outputs are exact, but no vehicle is six
# coordinates.
_OF_THE_ADMITTANCE = 8e-3
# Of what a platform that swings within each period does to joints: not known.
_SWUNG = 0.3
_OF_THE_SERVO = (*COMMANDED, "q", "tau", "controller")  # what its port needs
_AT_REST = TorqueEffect, JointMemory  # frictions among them: they turn with noise


@dataclass(frozen=True)
class SystemVariant:
    """A system, and what of it has no place in one: courses of drift, forms of friction.

    `gains` are errors of the servo's kp and kd, relative, one per joint each.
    """

    system: System
    paths: tuple[SlowPath, ...] = ()
    presliding: tuple[Presliding, ...] = ()
    gains: tuple[tuple[float, ...], ...] = ()
    starts: tuple[InnerStart, ...] = ()  # of a vehicle's internal modes, in single runs
    clock: ClockError | None = None  # of a recorder, in a single run


def _ports(system: System) -> Iterator[Port]:
    """Yield the ports of a system in its mode."""
    n = system.arm.n
    tau, v = ((tuple(f"{k}_{i + 1}" for i in range(n))) for k in ("tau", "v"))
    torque = tau, ("N m",) * n
    wrench = WRENCH, ("N",) * 3 + ("N m",) * 3
    needs: tuple[str, ...] = ("q", "tau", "y")
    text = "motor torque less what the motion takes"
    yield Port("joint", text, *torque, needs, COMMANDED, differentiates=True, signal="tau")
    text = "motor torque less what the controller asks"
    yield Port(
        "servo", text, *torque, _OF_THE_SERVO, COMMANDED, differentiates=True, signal="tau"
    )
    text = "rate logged less the rate of the angle logged"
    yield Port("velocity", text, v, ("rad/s",) * n, ("q", "v"), signal="v")
    text, needs = "sensor reading less the arm's wrench", ("q", "y", "w")
    yield Port("wrench", text, *wrench, needs, differentiates=True, signal="w")
    if system.mode == "ideal":
        text = "arm's wrench less what moves the vehicle"
        yield Port(
            "base", text, *wrench, ("y", "w"), differentiates=True, answers=True, signal="w"
        )
        return
    settings = system.emulator_settings
    if settings.operation == "microgravity":
        text, needs = "weight estimate subtracted less the stated one", ("q", "y", "weight")
        yield Port("gravity", text, *wrench, needs, signal="weight")
    if settings.operation != "position":
        beside = ("q", "controller") if settings.payload_compensation else ()
        text, exact = "wrench taken in less what moves the vehicle", ("w", "weight", "q")
        needs = ("w", "weight", "y_cmd", *beside)
        yield Port("admittance", text, *wrench, needs, exact, signal="wg")
    text, units = "pose less the platform's answer to its command", ("m",) * 3 + ("rad",) * 3
    yield Port("platform", text, AXES, units, ("y", "y_cmd"), ("y_cmd",), signal="y")


class SystemMachine:
    """Ports of a system in either mode."""

    def __init__(self, system: System, stated: StatedErrors | None = None) -> None:
        system.arm.require_rigid("a diagnosis")
        system.arm.require_turning("a diagnosis")
        system.arm.require_uncoupled("a diagnosis")
        self._stated = stated or StatedErrors()
        self.system = system
        self.nominal = SystemVariant(system)
        self.name = f"{system.arm.name} on {system.vehicle.kind}, {system.mode}"
        self.ports = tuple(_ports(system))

    def model(
        self, effects: Sequence[Effect | SlowPath | Presliding | CompositeCause]
    ) -> SystemVariant:
        """Return the description with effects added."""
        effects = split(effects)
        paths = tuple(e for e in effects if isinstance(e, SlowPath))
        grown = tuple(e for e in effects if isinstance(e, Presliding))
        added = tuple(e for e in effects if isinstance(e, Effect))
        system = self.system
        if added:
            system = system.replace(effects=(*system.effects, *added))
        return SystemVariant(system, paths, grown)

    def passing(self, model: SystemVariant) -> SystemVariant:
        """Return a model without torques that it adds at joints, and with all clocks right."""
        if model.clock is not None:
            model = dataclasses.replace(model, clock=None)
        moving = tuple(e for e in model.system.effects if not isinstance(e, _AT_REST))
        if len(moving) == len(model.system.effects) and not model.presliding:
            return model
        system = model.system.replace(effects=moving)
        return dataclasses.replace(model, system=system, presliding=())

    def floor(self, run: Run, port: str) -> Array:
        """Return (c,) standard deviation below which a residual of the port means nothing."""
        signal = next(p.signal for p in self.ports if p.name == port)
        size = np.asarray(run["w" if signal == "wg" else signal].std(axis=-2))
        kinds = np.array_split(size, max(1, len(size) // 3))  # forces and moments apart
        share = _OF_THE_ADMITTANCE if port == "admittance" else LEAST
        least = share * np.concatenate([np.full(len(k), max(k.max(), 1e-12)) for k in kinds])
        if port in ("joint", "velocity"):
            between = self._between(run)
            swung = between.torque if port == "joint" else between.rate
            least = np.hypot(least, _SWUNG * swung.std(axis=0))
        return least

    def rings(self, runs: Sequence[Run], frequency: float) -> bool:
        """Return True if the system as described rings at a frequency."""
        angles = [run["q"][k] for run in runs for k in (0, -1)]
        return loop_rings(self.system, runs[0].servo, angles, frequency)

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

    def travel(self, runs: Sequence[Run]) -> tuple[float, ...]:
        """Return what each joint covers in the runs [rad]."""
        angles = np.concatenate([np.reshape(run["q"], (-1, self.system.arm.n)) for run in runs])
        return tuple(np.ptp(angles, axis=0).tolist())

    @cached_property
    def nuisances(self) -> tuple[Nuisance, ...]:
        """Small errors of any description of such a machine."""
        usual = (
            dataclasses.replace(k, model=SystemVariant(k.model))
            for k in system_nuisances(self.system)
        )
        every = itertools.chain(usual, self._of_the_servo())
        return with_known(every, self._stated.known, self._stated.scale)

    def _of_the_servo(self) -> Iterator[Nuisance]:
        """Yield small errors of the gains that a controller is said to have."""
        n = self.system.arm.n
        for i in range(n):
            off = tuple(0.01 if k == i else 0.0 for k in range(n))
            none = (0.0,) * n
            for name, gains in (("kp", (off, none)), ("kd", (none, off))):
                model = SystemVariant(self.system, gains=gains)
                yield Nuisance(
                    f"{name} of joint {i + 1}", ("servo", "joint"), model, 0.01, GAIN
                )

    def unknowns(self, run: Run) -> tuple[Nuisance, ...]:
        """Return what a run may have of its own.

        Clocks that are not in step; in the laboratory the course of a described drift of the
        force sensor; in space how the vehicle's internal modes moved when the run began.
        """
        system, emulated, out = self.system, self.system.mode == "emulated", list[Nuisance]()

        def unknown(
            name: str, ports: tuple[str, ...], size: float, scales: bool = False, **of: Any
        ) -> None:
            variant = SystemVariant(system, **of)
            out.append(Nuisance(name, ports, variant, 1.0, float(size), scales))

        for name, error, std in clock_errors(run, self._stated.clocks, emulated):
            ports = tuple(p.name for p in self.ports if set(error.signals) & set(p.needs))
            unknown(f"{name} in {run.name}", ports, std, True, clock=error)
        if emulated:
            sensor = system.loop_parameters.sensor
            for path, size in courses(run, sensor.drift[0], float(sensor.drift_time[0])):
                name = f"drift of {WRENCH[path.channel]} in {run.name}"
                unknown(name, ("wrench",), size, paths=(path,))
        elif (modes := system.actual.base.internal) and "y" in run and "w" in run:
            for i, size in enumerate(np.maximum(inner_sizes(run, modes), 1e-12)):
                name = f"state {i + 1} of the internal modes where {run.name} begins"
                unknown(name, ("base", "wrench"), size, starts=(InnerStart(run.name, i),))
        return tuple(out)

    def residuals(
        self, run: Run, models: Sequence[SystemVariant], ports: Sequence[str]
    ) -> dict[str, Array]:
        """Return (m, ..., T, c) per port, as `Machine.residuals`."""
        if any(m.clock is not None for m in models):
            stamped = [run if m.clock is None else m.clock.undone(run) for m in models]
            single = [
                self.residuals(k, [dataclasses.replace(m, clock=None)], ports)
                for k, m in zip(stamped, models, strict=True)
            ]
            return {p: np.concatenate([k[p] for k in single]) for p in ports}
        systems = [m.system for m in models]
        residual_of: dict[str, Callable[[], Any]] = {
            "joint": lambda: [self._joint(run, m) for m in models],
            "servo": lambda: [self._servo(run, m) for m in models],
            "velocity": lambda: [self._velocity(run, s) for s in systems],
            "wrench": lambda: [self._wrench(run, s) for s in systems],
            "gravity": lambda: [self._gravity(run, s) for s in systems],
            "base": lambda: [self._base(run, s)[0] for s in systems],
            "admittance": lambda: force_gap(run, systems, self.system),
            "platform": lambda: platform_gap(run, systems, self.system),
        }
        out = {port: np.stack(residual_of[port]()) for port in ports}
        for k, model in enumerate(models):
            for path in model.paths if "wrench" in ports else ():
                direction = self._to_wrench[:, path.channel]
                out["wrench"][k] -= path.of(run)[:, None] * direction
            for start in model.starts:
                without_modes = _without_new_modes(model.system)[0]
                force = start.force(run, without_modes.actual.base)
                if "base" in ports:
                    out["base"][k] += force
                if "wrench" in ports:
                    out["wrench"][k] -= self._seen_in_wrench(run, without_modes, force)
        return out

    # ------------------------------------------------------------------- arm

    def _joint(self, run: Run, model: SystemVariant) -> Array:
        """Motor torque less what the motion takes (..., T, n).

        Where the controller is known, what it asked tells the torque, too, and often better:
        a wrist's by its angle times a small gain.
        """
        effects, v = model.system.effects, run.turning_rate
        between = self._between(run)

        def laws(tau: Array) -> Array:
            out = self._added(run, effects, tau)
            for p in model.presliding:
                built_up = self._law(run, [p.effect], p.sliding(v), tau)
                out = out + p.built_up(built_up, v, run.dt)
            return out

        every = (*effects, *(p.effect for p in model.presliding))
        needed = self._load(run, model.system)[0] + between.torque
        if self.system.mode == "ideal" and "w" in run:
            needed = needed + self._seen_in_torque(run, model.system)
        balance = torque_residual(run["tau"], needed, every, laws)
        gears = windings(model.system.actual.arm, run)
        balance = balance - self._told_too_much(run, model)
        return in_torque_logged(balance, gears)

    def _law(self, run: Run, effects: Sequence[Effect], v: Array, tau: Array) -> Array:
        """Return what laws of rates v (..., T, n) add to torques at joints (..., T, n)."""
        most = self.system.arm.column("tau_max")
        # joints that swing within a period rub by the mean of it
        rates = [v + swing for swing in self._between(run).swings] or [v]
        per_rate = (joint_torque(effects, run.joints.x, rate, tau, most) for rate in rates)
        return np.asarray(sum(per_rate) / len(rates))

    def _added(self, run: Run, effects: Sequence[Effect], tau: Array) -> Array:
        """Return what effects add to the motors' torques (..., T, n)."""
        out = self._law(run, effects, run.turning_rate, tau)
        return np.asarray(out + remembered_friction(run, effects))

    def _told_too_much(self, run: Run, model: SystemVariant) -> Array:
        """Return what a log's torques are above the best estimate of them (..., T, n) [N m].

        A controller that is known tells them, too.
        """
        share = self._commanded_torque_weight(run)
        return share * self._servo(run, model) if share.any() else np.zeros(())

    def _commanded_torque_weight(self, run: Run) -> Array:
        """Return (n,) what the asked counts for beside the log; none where it is not known."""
        if run.by_log or not all(k in run for k in _OF_THE_SERVO):
            return np.zeros(self.system.arm.n)
        return run.derived("share of the asked", (), lambda: commanded_torque_weight(run))

    def _wrench(self, run: Run, system: System) -> Array:
        """Sensor reading less the arm's wrench (..., T, 6)."""
        wrench = self._load(run, system)[1]
        if system.mode == "ideal":
            force, without_modes = self._base(run, system)
            return np.asarray(
                run["w"] - wrench - self._seen_in_wrench(run, without_modes, force)
            )
        return np.asarray(run["w"] - self._sensed(system, wrench, run))

    def _seen_in_torque(self, run: Run, system: System) -> Array:
        """Return what the pose's noise does at port `joint`, by the residual at `wrench`."""
        arm, noise = system.actual.arm, self._pose_noise(run)
        *how, geared = self._told_load(run, system, arm)
        key: tuple[Hashable, ...] = noise, arm if geared else bodies_of(arm), *how
        if geared and has_free_play(arm, run):  # what moves the wrench
            key = *key, system.effects

        def in_the_torque() -> Array:
            return noise.in_torque(arm, run["w"] - self._load(run, system)[1])

        return cached(run.memory, "seen in torque", key, in_the_torque)

    def _base(self, run: Run, system: System) -> tuple[Array, System]:
        """Return the arm's wrench less what moves the vehicle (..., T, 6).

        Modes that are no part of a vehicle's own model answer to the wrench; the rest moves as
        measured. That is returned, too: the pose's noise shows through it alone.
        """
        without_modes, new = _without_new_modes(system)
        base = without_modes.actual.base
        gap = cached(
            run.memory, "vehicle's gaps", _moved(without_modes), lambda: vehicle_gap(run, base)
        )
        if new is None:
            return gap, without_modes

        def answer() -> Array:
            return gap + answering_force(run, system.actual.base, new)

        return cached(run.memory, "beside new modes", _moved(system), answer), without_modes

    def _seen_in_wrench(self, run: Run, system: System, force: Array) -> Array:
        """Return what the pose's noise does at port `wrench`, by a residual at port `base`."""
        actual = system.actual
        return self._pose_noise(run).in_wrench(actual.arm, _moved(system), actual.base, force)

    def _pose_noise(self, run: Run) -> PoseNoise:
        """Estimates of what the noise of the measured pose does in mode ideal."""
        return pose_noise(run, lambda: self.floor(run, "wrench"))

    def _between(self, run: Run) -> BetweenSamples:
        """Effect of the platform's swing, as described, between the samples of a log."""
        signals = {*followed(run, self.system), "q"}
        return run.derived(
            "between samples", signals, lambda: between_samples(run, self.system), near=True
        )

    def _reading_between(self, run: Run, system: System, loop: LoopParameters) -> Array:
        """Return what the sensor reads of the platform's swing between samples (T, 6)."""
        cutoff, platform = float(loop.sensor.cutoff[0]), _platform_of(loop)
        key = cutoff, platform
        near: dict[Any, Array] = run.memory.get(NEAR, {}).get("swing", {})

        def read() -> Array:
            between = self._between(run)
            if platform != _platform_of(self.system.loop_parameters):
                between = between.on(run, system)
            return between.reading(cutoff)

        return near[key] if key in near else cached(run.memory, "swing", key, read)

    def _load(self, run: Run, system: System) -> Load:
        """Torque that the motors must give (..., T, n), and wrench of the arm (..., T, 6)."""
        arm = system.actual.arm
        tau, wrench = self._load_of(run, system, arm)
        if "tau" not in run or not has_free_play(arm, run):
            return tau, wrench

        def computed() -> Load:
            torque = run["tau"] - self._told_too_much(run, SystemVariant(system))
            imbalance = torque + self._added(run, system.effects, torque) - tau
            return backlash_reaction(
                arm, imbalance, run, 1 - self._commanded_torque_weight(run)
            )

        key = arm, *self._told_load(run, system, arm), system.effects
        reactions = cached(run.memory, "felt of flights", key, computed)
        return tau + reactions[0], wrench + reactions[1]

    def _told_load(self, run: Run, system: System, arm: Arm) -> tuple[Any, ...]:
        """Return all that a load depends on beside run and arm, last whether gears give."""
        delays = system.delays()
        geared = any(link.gear is not None for link in arm.links)
        command_delay: tuple[Any, ...] = ()  # what tells the torques that wind gears up
        if geared and not run.by_log:
            command_delay = float(delays.command[0]), tuple(delays.lag[0].tolist())
        return float(delays.measurement[0]), command_delay, _hardening(system), geared

    def _load_of(self, run: Run, system: System, arm: Arm) -> Load:
        old, *_, geared = how = self._told_load(run, system, arm)

        def load() -> Load:
            moved = cached(run.memory, "motions", old, lambda: self._motion(run, old), most=3)
            return self._load_of_geared(run, system, arm, moved) if geared else moved.load(arm)

        return cached(run.memory, "loads", (arm, *how), load)

    def _motion(self, run: Run, old: float) -> MeasuredMotion:
        """Return the motion of a run whose joint measurements are this old [s]."""
        joints = run.joints_ahead(old) if old else run.joints
        base = cached(run.memory, "base", (), lambda: base_motion(run.base))
        weighty = self.system.mode == "emulated"
        balanced = weighty and self.system.emulator_settings.joint_balance
        return MeasuredMotion(joints, run.base.x, base, weighty, balanced)

    def _load_of_geared(
        self, run: Run, system: System, arm: Arm, motion: MeasuredMotion
    ) -> Load:
        """As `_load`, where links lag their motors."""
        tau, _ = motion.load(arm)
        rotors, links = arm.column("rotor_inertia"), motion.joints
        torque = tau  # what rigid links would take, where no torque is logged
        if "tau" in run:
            torque = run["tau"] - self._told_too_much(run, SystemVariant(system))
        winding = torque - rotors * links.a
        # what carries the weight at the links themselves carries that of the arm as it is
        carried = np.zeros(())
        if motion.balanced:
            carried = weight_torque(arm, links.x, run.base.x)

        taken = tau - rotors * links.a  # by links that follow their motors

        def lagging(winding: Array) -> Load:
            bent = deflections(arm, winding, taken, run, _hardening(system))
            late = differentiated(bent, run.dt, run.band)
            behind = Kinematics(*(x - d for x, d in zip(links, late, strict=True)))
            tau, wrench = motion_load(arm, behind, motion.base, motion.fall)
            # rotors move with the motors
            return tau - carried + rotors * (links.a - behind.a), wrench

        tau, wrench = lagging(winding)
        gears = windings(arm, run) if "tau" in run else []
        if gears:  # others feel what the link feels, not what else the torque logged has
            own_share = 1 - self._commanded_torque_weight(run)
            through = through_gears(winding, torque - tau, gears, run, own_share)
            others, wrench = lagging(through)
            geared_joints = [g.joint for g in gears]
            others[..., geared_joints] = tau[..., geared_joints]
            tau = others
        return tau, wrench

    def _servo(self, run: Run, model: SystemVariant) -> Array:
        """Motor torque less what the controller asks for (..., T, n)."""
        delays = model.system.delays()
        key = float(delays.command[0]), tuple(delays.lag[0].tolist()), model.gains

        def gap() -> Array:
            swing = self._between(run).rate
            return servo_gap(run, model.system, self.system.arm, model.gains, swing)

        return cached(run.memory, "servo", key, gap)

    def _velocity(self, run: Run, system: System) -> Array:
        """Rate logged less the rate of the angle logged (..., T, n) [rad/s]."""
        logged, lag = run["v"], system.delays().lag[0]
        rate = run.angles.v + self._between(run).rate
        return np.asarray(logged - low_passed(rate, lag, run.dt, logged[..., 0, :]))

    def _sensed(self, system: System, wrench: Array, run: Run) -> Array:
        """Return the sensor's reading of a wrench (..., T, 6)."""
        spec = system.emulator_settings.sensor
        loop = system.loop_parameters
        p, swing = loop.sensor, self._reading_between(run, system, loop)
        filtered = butterworth(wrench, float(p.cutoff[0]), run.dt) + swing
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
        q, y = run.angles.x, run.base.x
        p = system.loop_parameters
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


def _platform_of(loop: LoopParameters) -> tuple[float, float]:
    """Return how much faster, and more damped, a platform is than stated."""
    return float(loop.bandwidth[0]), float(loop.damping[0])


def _moved(system: System) -> Hashable:
    """Return a key of a system's base: its vehicle and the effects on it."""
    return system.vehicle, tuple(e for e in system.effects if isinstance(e, BaseEffect))


def _without_new_modes(system: System) -> tuple[System, InternalModes | None]:
    """Return a system without modes that are no part of its vehicle's own model, and those."""
    new = [e for e in system.effects if isinstance(e, BaseExtraMode) and e.mass]
    if not new:
        return system, None
    kept_effects = tuple(e for e in system.effects if not isinstance(e, BaseExtraMode))
    return system.replace(effects=kept_effects), InternalModes.of(
        tuple(e.oscillator for e in new)
    )


def _hardening(system: System) -> tuple[int, ...]:
    """Return the joints whose springs harden."""
    compliances = [e.compliance for e in system.effects if isinstance(e, Hardened)]
    return tuple({i for soft in compliances for i, x in enumerate(soft) if x})
