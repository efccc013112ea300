"""The laboratory at work: reading -> admittance -> platform, n times, once per period.

`EmulationLoop` is the tick loop of thesis 2.4.2 (Figure 2-8), vectorised over simulations.
It never touches the engine: `Simulator` carries its commands there and the wrench back.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ves_gym._util.params import Array, Index, Mask, ParameterError
from ves_gym.engine.batch_parameters import Bodies, Inertias, ParameterRows, bodies_of
from ves_gym.engine.kernel.maps import InertiaMap
from ves_gym.hardware.admittance import (
    Nonlinear,
    admittance_matrices,
    implicit_step,
    integrate,
    rigid_bodies,
    rigid_body,
)
from ves_gym.hardware.force_sensor import LowPass, Sensor
from ves_gym.hardware.leg_servo import Legs, LegServo
from ves_gym.hardware.platform import Follower, PoseFollower, PoseServo
from ves_gym.mechanics.gravity import GravityModel, gravity_vector, gravity_wrench
from ves_gym.mechanics.spatial import matvec, rate_matrix
from ves_gym.system.deviations import ARRAYS, LoopParameters
from ves_gym.system.effect import BaseEffect
from ves_gym.system.system import System

_REFINE = 3  # rounds of scaling a pose to the legs' reach
_STEP = 1e-6  # of the differences that linearise a vehicle [m, rad] and their rates


class Event(NamedTuple):
    """A safety check that froze the platform (thesis 2.4.2)."""

    simulation: int
    time: float  # s
    reason: str

    def __str__(self) -> str:
        return f"platform frozen at t = {self.time:.4f} s: {self.reason}"


class Readings(NamedTuple):
    """Signals of the controller at one instant. Leading axis n."""

    wrench: Array  # (n, 6) sensor reading, platform frame [N, N m]
    gravity: Array  # (n, 6) estimate of its static part
    y: Array  # (n, 6) measured pose
    y_cmd: Array  # (n, 6) commanded pose


@dataclass
class _State:
    """Memory of the tick loop; every array has the leading axis n."""

    X: Array  # (n, 12) admittance: Y, Y' (thesis eq. 2.4)
    command_sent: Array  # (n, 12) command the platform follows
    queue: Array  # (n, delay, 12) commands on their way
    # (n, m, 12) earlier `command_sent`, newest first, where the platform hears late
    command_history: Array
    command_received: Array  # (n, 12) what the platform heard last, where it cannot follow all
    reading: Array  # (n, 6)
    estimate: Array  # (n, 6) gravity wrench in use
    estimate_history: Array  # (n, m, 6) earlier estimates, newest first
    coupled_state: Array  # (n, 2 (joints + m)) the joints' answer to the base's motion, in the
    #              admittance, and the m oscillators that the vehicle carries
    arm_response: Array  # (n, 2 joints) the same by the model of the platform
    payload: Array  # (n, 6, 2) predicted inertia wrench of the arm, as the sensor shows it
    frozen: Mask  # (n,)
    time: Array  # (n,) s since the reset


class EmulationLoop:
    """n emulators at work on one system."""

    def __init__(
        self,
        system: System,
        n: int,
        generators: list[np.random.Generator],
        admittance: Nonlinear | None = None,
    ) -> None:
        emulator, arm = system.emulator_settings, system.arm
        self.system, self.n, self.spec = system, n, emulator
        self.generators = generators
        self.parameters = p = LoopParameters.nominal(arm, emulator, n).edited(system)
        self.dt, self.nodes = (
            system.control_dt,
            np.arange(system.substeps + 1) * np.float64(system.physics_dt),
        )
        self.sensor = Sensor(emulator.sensor, p.sensor, self.nodes)
        self.follower = self._follower(p)
        self.custom = admittance
        self._nonlinear = admittance
        _require_vehicle(system, admittance)
        base = system.actual.base  # the arm's model, in what follows, is the description
        if base.body is not None and admittance is None:
            self._nonlinear = rigid_body(base.body, base)
        self.compensating = emulator.payload_compensation and emulator.operation != "position"
        self._linear = None
        if self._nonlinear is None:
            self._linear = admittance_matrices(base, self.dt, emulator.admittance_form)
        # a machine as stated is its own model: one of them does for both
        nominal = LoopParameters.nominal(arm, emulator, n)
        self.model = self.follower if p.as_stated else self._follower(nominal)
        self._model_filter = LowPass(np.full(n, emulator.sensor.cutoff), self.nodes)
        self._weight = (1 + p.payload_scale)[:, None, None]
        self._lag = emulator.lag(self.dt)
        self._inertia = InertiaMap(system, n) if self.compensating else None
        self._moving = arm.n if system.drive == "motor" else 0  # joints that give way
        self._carried = len(base.extra)
        self._wide = np.array(base.widened())
        self._ages = self._oldest()
        self._short = self._falling_short()
        self._systems = [system] * n
        self._bodies: Bodies | None = None  # where arms or vehicles differ
        self._inertias: Inertias | None = None
        self._start: LoopParameters | None = (
            None  # one row before effects, of the last arm asked
        )
        self.kp, self.kd = np.zeros((2, n, arm.n))  # of the joint servo, for the compensation
        self.table: Array | None = None  # (n, m, 6): replaces the estimate, row by row
        self.events: list[Event] = []
        zero = np.zeros
        self.state = _State(
            X=zero((n, 12)),
            command_sent=zero((n, 12)),
            queue=zero((n, emulator.delay, 12)),
            command_history=zero((n, self._oldest_command(), 12)),
            command_received=zero((n, 12)),
            reading=zero((n, 6)),
            estimate=zero((n, 6)),
            estimate_history=zero((n, self._ages + 1, 6)),
            coupled_state=zero((n, 2 * (self._moving + self._carried))),
            arm_response=zero((n, 2 * self._moving)),
            payload=zero((n, 6, 2)),
            frozen=zero(n, bool),
            time=zero(n),
        )

    def _follower(self, p: LoopParameters) -> Follower:
        servo, system = self.spec.platform, self.system
        if isinstance(servo, LegServo):
            return Legs(servo, self.spec.stewart, self.n, system.control_dt, system.physics_dt)
        return PoseFollower(
            servo,
            self.n,
            self.nodes,
            bandwidth=servo.bandwidth * (1 + p.bandwidth),
            damping_ratio=servo.damping_ratio * (1 + p.damping),
        )

    def _oldest(self) -> int:
        """Number of estimates to look back over, in control periods."""
        return int(np.ceil(self.parameters.gravity_delay.max() / self.dt - 1e-9)) + 1

    def _oldest_command(self) -> int:
        """Number of commands to look back over: none where platforms hear at once."""
        delay = float(self.parameters.platform_delay.max())
        return int(np.ceil(delay / self.dt - 1e-9)) + 1 if delay > 0 else 0

    def _falling_short(self) -> Index:
        """Platforms whose legs cannot do all they should."""
        p = self.parameters
        return np.flatnonzero((p.platform_travel > 0) | (p.platform_speed > 0))

    # ------------------------------------------------------------- assignment

    def prepare(self, ids: Index, systems: Sequence[System]) -> Callable[[], None]:
        """Check systems of their own for some simulations; the result installs them.

        Memory stays: until the next reset it is that of the system before.

        Args:
            ids: (k,) which.
            systems: k of them.
        """
        pairs = list(zip(ids.tolist(), systems, strict=True))
        p = LoopParameters.stacked([self._parameters_of(system) for system in systems])
        others = [(i, k) for i, k in pairs if _all_bodies(k) != _all_bodies(self._systems[i])]
        if self.custom is not None and any(
            k.vehicle is not self.system.vehicle for _, k in pairs
        ):
            raise ParameterError(
                "an `admittance` takes the place of every simulation's vehicle: assign systems"
                " with the vehicle of the simulator's own"
            )
        bodies, inertias = self._bodies, self._inertias
        rows_of: dict[tuple[int, ...], Bodies] = {}  # a row of each arm and vehicle seen
        if others:
            names = ParameterRows(self.system) if self.compensating else None

            def row(system: System, which: str) -> Bodies:
                nothing = np.empty(0)
                numbers = nothing if names is None else names.of(system, which, laws=False)
                return Bodies.of(system, self._linear is not None, numbers)

            for i, k in others:
                if _all_bodies(k) not in rows_of:
                    rows_of[_all_bodies(k)] = row(k, f"system of simulation {i}")
            if bodies is None:
                bodies = row(self.system, "own system").repeated(self.n)
                inertias = Inertias(self.system, self.n) if self.compensating else None

        def install() -> None:
            self._bodies, self._inertias = bodies, inertias
            for i, system in others:
                assert bodies is not None
                bodies.put(i, rows_of[_all_bodies(system)])
                if inertias is not None:
                    inertias.arms[i] = system.arm
            for i, system in pairs:
                self._systems[i] = system
            self.install(ids, p)

        return install

    def _parameters_of(self, system: System) -> LoopParameters:
        """One row."""
        if self._start is None or self._start.arm is not system.arm:
            self._start = LoopParameters.nominal(system.arm, self.spec, 1)
        return self._start.copy().edited(system)

    def install(self, ids: Index, p: LoopParameters) -> None:
        """Put parameters in place, with all that follows from them; memory stays.

        Args:
            ids: (m,) which simulations.
            p: of m simulations.
        """
        for name in ARRAYS:
            getattr(self.parameters, name)[ids] = getattr(p, name)
        self.sensor.put(ids, p.sensor)
        self._weight[ids] = (1 + p.payload_scale)[:, None, None]
        servo = self.spec.platform
        if self.model is self.follower and not p.as_stated:  # the model stays as stated
            nominal = LoopParameters.nominal(self.system.arm, self.spec, self.n)
            self.model = self._follower(nominal)
            self.model.set_state(self.follower.get_state())
        separate = self.model is not self.follower
        if (
            separate
            and isinstance(self.follower, PoseFollower)
            and isinstance(servo, PoseServo)
        ):
            w = servo.bandwidth * (1 + p.bandwidth)
            self.follower.put(ids, w, servo.damping_ratio * (1 + p.damping))
        self._ages, self._short = self._oldest(), self._falling_short()
        s = self.state
        missing = self._ages + 1 - s.estimate_history.shape[1]
        if missing > 0:
            # the oldest that is known
            older = np.repeat(s.estimate_history[:, -1:], missing, axis=1)
            s.estimate_history = np.concatenate([s.estimate_history, older], axis=1)
        missing = self._oldest_command() - s.command_history.shape[1]
        if missing > 0:
            oldest = (
                s.command_history[:, -1:]
                if s.command_history.shape[1]
                else s.command_sent[:, None]
            )
            s.command_history = np.concatenate(
                [s.command_history, np.repeat(oldest, missing, axis=1)], axis=1
            )

    # ------------------------------------------------------------------ state

    def reset(self, ids: Index, q: Array, y: Array, yd: Array) -> None:
        """Put platforms at a pose, moving, sensors at rest under the arm's weight.

        Args:
            ids: (m,) which.
            q: (m, joints) angles [rad].
            y, yd: (m, 6) pose [m, rad] and its rate.
        """
        s = self.state
        X = np.concatenate([y, yd], axis=-1)
        s.X[ids], s.command_sent[ids], s.queue[ids] = X, X, X[:, None]
        s.command_history[ids], s.command_received[ids] = X[:, None], X
        s.coupled_state[ids], s.arm_response[ids], s.payload[ids] = 0.0, 0.0, 0.0
        if self._carried:
            at, moving = self._carrying
            for i, row, rate in zip(ids.tolist(), y, yd, strict=True):
                carried = self._systems[i].actual.base
                s.coupled_state[i, at], s.coupled_state[i, moving] = (
                    carried.attached(row),
                    carried.attached(rate),
                )
        s.frozen[ids], s.time[ids] = False, 0.0
        self.events = [e for e in self.events if e.simulation not in set(ids.tolist())]
        self.follower.reset(ids, y, yd)
        if self.model is not self.follower:
            self.model.reset(ids, y, yd)
        self.sensor.reset(ids, self._weight_of(q, y, ids), self.generators)
        estimate = self._estimate(q, self.follower.measured()[ids], ids)
        s.estimate_history[ids] = estimate[:, None]
        s.estimate[ids] = estimate
        if self.compensating:  # the state runs behind by what the platform is told ahead
            H = self._arm_inertia(q, ids)
            free = np.zeros((len(ids), 6))
            M, D, K, state, W = self._coupled(H, X, s.coupled_state[ids], free, ids)
            s.X[ids], s.coupled_state[ids] = self._split(
                implicit_step(M, D, K, state, W, -self._lag)
            )
        if self.spec.zero_at_start:
            self.zero(ids)
        s.reading[ids] = self.sensor.reading()[ids]

    def get_state(self) -> Any:
        """Everything needed to continue exactly from here; picklable."""
        memory = self.state, self.sensor.state, self.events, self.table
        return copy.deepcopy(memory), self.follower.get_state(), self.model.get_state()

    def set_state(self, state: Any) -> None:
        """Return to a state handed out by `get_state`."""
        memory, follower, model = state
        self.state, self.sensor.state, self.events, self.table = copy.deepcopy(memory)
        self.model.set_state(model)
        self.follower.set_state(follower)  # last: the two may be one

    # ------------------------------------------------------------------- tick

    def command(
        self, q: Array, platform: tuple[Array, Array] | None = None
    ) -> tuple[Array, Array, Array]:
        """From the present readings to the platform's next period: Y, Y', Y'' at its nodes.

        Args:
            q: (n, joints) measured joint angles [rad].
            platform: pose and rate (n, 6) to follow, under position control only.
        """
        s = self.state
        H = self._arm_inertia(q) if self.compensating else np.empty(0)
        if self.spec.operation != "position":
            fresh = self._admit(H)
        elif platform is not None:
            fresh = np.concatenate(platform, axis=-1)
        else:  # nowhere else to go
            fresh = np.concatenate([s.command_sent[:, :6], np.zeros((self.n, 6))], axis=-1)
        s.queue = np.concatenate([s.queue, fresh[:, None]], axis=1)
        command = s.queue[:, 0]
        s.queue = s.queue[:, 1:]
        self._check(command)
        standstill = np.concatenate(
            [s.command_sent[:, :6], np.zeros_like(s.command_sent[:, 6:])], axis=-1
        )
        s.command_sent = np.where(s.frozen[:, None], standstill, command)
        s.X = np.where(s.frozen[:, None], standstill, s.X)
        heard = self._heard()
        path = self.follower.advance(heard[:, :6], heard[:, 6:])
        if self.compensating:
            same = self.model is self.follower
            self._predict(
                H,
                path
                if same
                else self.model.advance(s.command_sent[:, :6], s.command_sent[:, 6:]),
            )
        return path

    def _heard(self) -> Array:
        """(n, 12) the command as it reaches the platforms: late, or as far as they can go."""
        s, p = self.state, self.parameters
        out = s.command_sent
        if s.command_history.shape[1]:
            nodes = np.concatenate([out[:, None], s.command_history], axis=1)
            age = p.platform_delay / self.dt
            low, rows = np.floor(age).astype(int), np.arange(self.n)
            part = (age - low)[:, None]
            delayed = (1 - part) * nodes[rows, low] + part * nodes[rows, low + 1]
            out = np.where(age[:, None] > 0, delayed, out)
            s.command_history = nodes[:, :-1]
        if len(self._short):
            out = out.copy()
            out[self._short] = self.within_reach(out[self._short], self._short)
        s.command_received = out
        return out

    def within_reach(self, command: Array, ids: Index) -> Array:
        """Return commands held back on their way, as far as the legs go.

        Args:
            command: (m, 12) pose and rate.
            ids: (m,) which.
        """
        p, stewart, before = (
            self.parameters,
            self.spec.stewart,
            self.state.command_received[ids],
        )
        travel, speed = p.platform_travel[ids], p.platform_speed[ids]
        pose = self.shortened(command[:, :6], travel)
        step = np.abs(stewart.leg_lengths(pose) - stewart.leg_lengths(before[:, :6])).max(
            axis=1
        )
        haste = step / (self.dt * stewart.speed_max * (1 - speed))
        slower = before[:, :6].T + (pose - before[:, :6]).T / haste.clip(1)
        pose = np.where((speed > 0) & (haste > 1), slower, pose.T).T
        shortened = (pose != command[:, :6]).any(axis=1)[:, None]
        rate = np.where(shortened, (pose - before[:, :6]) / self.dt, command[:, 6:])
        return np.concatenate([pose, rate], axis=-1)

    def shortened(self, pose: Array, travel: Array) -> Array:
        """Return poses on their way from home, where legs lack a part of their stroke.

        Args:
            pose: (m, 6) [m, rad].
            travel: (m,) share of the stroke that is missing.
        """
        beyond = (travel > 0) & (self._excess(pose, travel) > 1)
        for _ in range(_REFINE):  # legs stretch almost in proportion
            excess = np.where(beyond, self._excess(pose, travel), 1.0)
            pose = pose / excess[:, None]
        return pose

    def _excess(self, pose: Array, travel: Array) -> Array:
        """(m,) how far poses stretch a leg, in units of what its short stroke allows."""
        stewart = self.spec.stewart
        home = stewart.home_lengths
        stretch = stewart.leg_lengths(pose) - home
        room = np.where(stretch > 0, stewart.length_max - home, home - stewart.length_min)
        out: Array = (np.abs(stretch) / (room * (1 - travel[:, None]))).max(axis=1)
        return out

    def sense(self, wrench: Array, q: Array) -> None:
        """Take in one period's true wrench; read the sensors.

        Args:
            wrench: (n, k + 1, 6) at the period's nodes [N, N m].
            q: (n, joints) measured angles [rad].
        """
        s = self.state
        s.time = s.time + self.dt
        self.sensor.advance(wrench, self.generators)
        s.reading = self.sensor.reading()
        everyone = np.arange(self.n)
        fresh = self._estimate(q, self.follower.measured(), everyone)
        if self.table is not None and self.table.shape[1] > 1:
            self.table = self.table[:, 1:]
        s.estimate_history = np.concatenate(
            [fresh[:, None], s.estimate_history[:, :-1]], axis=1
        )
        if self._ages > 1:
            age = self.parameters.gravity_delay / self.dt
            low = np.floor(age).astype(int)
            part = (age - low)[:, None]
            older, newer = (s.estimate_history[everyone, k] for k in (low + 1, low))
            delayed = (1 - part) * newer + part * older
            s.estimate = np.where(age[:, None] > 0, delayed, fresh)
        else:
            s.estimate = fresh

    @property
    def readings(self) -> Readings:
        """Signals of the controller at this instant."""
        s = self.state
        y = self.follower.measured()
        return Readings(
            s.reading.copy(), s.estimate.copy(), y.copy(), s.command_sent[:, :6].copy()
        )

    @property
    def _carrying(self) -> tuple[slice, slice]:
        """Coordinates and rates of the vehicle's oscillators, as slices of `coupled_state`."""
        m, e = self._moving, self._carried
        return slice(m, m + e), slice(2 * m + e, 2 * (m + e))

    @property
    def carried(self) -> tuple[Array, Array]:
        """Coordinates and rates (n, m) of the oscillators that the vehicle carries."""
        at, moving = self._carrying
        return self.state.coupled_state[:, at].copy(), self.state.coupled_state[
            :, moving
        ].copy()

    def zero(self, ids: Index) -> None:
        """Set the sensors' zero from the gravity estimate (App. E step 9)."""
        wrench = self.state.estimate[ids]
        if self.spec.operation != "microgravity":
            wrench = np.zeros_like(wrench)
        self.sensor.zero_to(ids, wrench)
        self.state.reading = self.sensor.reading()

    # ---------------------------------------------------------------- helpers

    def _arm_inertia(self, q: Array, ids: Index | None = None) -> Array:
        """(n, 6 + m, 6 + m) of the compensation: with the joints, if a servo holds them."""
        size = 6 + self._moving
        assert self._inertia is not None  # only the compensation asks
        if self._inertias is None or self._bodies is None:
            H = self._inertia(q)[:, :size, :size]
        else:
            rows = np.arange(self.n) if ids is None else ids
            H = self._inertias(q, rows, self._bodies.numbers[rows])[:, :size, :size]
        weight = self._weight if ids is None else self._weight[ids]
        return np.multiply(weight, H, dtype=np.float64)

    def _weight_of(self, q: Array, y: Array, ids: Index) -> Array:
        """True static wrench (m, 6) of the arm on the platform."""
        arm, bodies = self.system.actual.arm, self._bodies
        if bodies is None:
            return GravityModel.of(arm).wrench(arm, q, y)
        return gravity_wrench(arm, q, gravity_vector(y), bodies.mass[ids], bodies.P[ids])

    def _drag(self, ids: Index) -> Array | None:
        """Quadratic damping (m, 6) of the vehicles; None where no vehicle has any."""
        bodies = self._bodies
        if bodies is None:
            drag = self.system.actual.base.drag
            return None if drag is None else np.broadcast_to(drag, (len(ids), 6))
        return bodies.drag[ids] if bodies.drag.any() else None

    def _vehicle(self, ids: Index) -> Nonlinear:
        """g(X, W) of nonlinear vehicles `ids` (m,)."""
        assert self._nonlinear is not None
        bodies = self._bodies
        if bodies is None or self.custom is not None:
            return self._nonlinear
        return rigid_bodies(bodies.body[ids], bodies.M[ids], bodies.D[ids], bodies.K[ids])

    def _estimate(self, q: Array, y: Array, ids: Index) -> Array:
        """Gravity estimate (m, 6) from measured joints and pose (thesis eq. 3.5, 3.9)."""
        if self.spec.operation != "microgravity":
            return np.zeros((len(ids), 6))
        if self.table is not None:
            row: Array = self.table[ids, 0]
            return row
        p = self.parameters
        pose = y.copy()
        pose[:, 3:] += p.gravity_tilt[ids]
        return gravity_wrench(
            self.system.arm, q, gravity_vector(pose), p.gravity_mass[ids], p.gravity_P[ids]
        )

    def _admit(self, H: Array) -> Array:
        """Move the vehicle's state one period on, under the wrench read now.

        Returns:
            (n, 12) what the platform is told: that state, or with compensation where the
            vehicle will be once the platform is there.
        """
        s = self.state
        T = rate_matrix(s.X[:, :6])
        turned = np.swapaxes(T, -1, -2)
        if self.compensating:
            force = matvec(turned, s.reading - s.estimate + s.payload[..., 0])
            return self._admit_together(H, force)
        elif self._linear is not None:
            bodies = self._bodies
            phi, gamma = self._linear if bodies is None else (bodies.phi, bodies.gamma)
            force = matvec(turned, s.reading - s.estimate)
            drag = self._drag(np.arange(self.n))
            if drag is not None:
                force = force - drag * np.abs(s.X[:, 6:]) * s.X[:, 6:]
            # row by row: one matrix product over the batch would round by its size
            if self._carried:
                at, moving = self._carrying
                parts = (
                    s.X[:, :6],
                    s.coupled_state[:, at],
                    s.X[:, 6:],
                    s.coupled_state[:, moving],
                )
                state = matvec(phi, np.concatenate(parts, axis=-1)) + matvec(gamma, force)
                y, s.coupled_state[:, at], yd, s.coupled_state[:, moving] = np.split(
                    state, np.cumsum([6, self._carried, 6]), axis=-1
                )
                s.X = np.concatenate([y, yd], axis=-1)
            else:
                s.X = matvec(phi, s.X) + matvec(gamma, force)
        else:
            force = matvec(turned, s.reading - s.estimate)
            s.X = integrate(self._vehicle(np.arange(self.n)), s.X, force, self.dt)
        return s.X

    def _admit_together(self, H: Array, force: Array) -> Array:
        """One period of vehicle and arm together (docs/physics.md, payload compensation)."""
        s = self.state
        M, D, K, X, W = self._coupled(H, s.X, s.coupled_state, force, np.arange(self.n))
        X = implicit_step(M, D, K, X, W, self.dt)
        s.X, s.coupled_state = self._split(X)
        # sensor, computer and platform delay motion by a known time: send it ahead by that
        return self._split(implicit_step(M, D, K, X, W, self._lag))[0]

    def _coupled(
        self, H: Array, X: Array, coupled_state: Array, force: Array, ids: Index
    ) -> tuple[Array, Array, Array, Array, Array]:
        """Matrices, state and force of vehicle and servo-held joints as one linear system."""
        base, bodies, m = self.system.actual.base, self._bodies, self._moving
        k = m + self._carried
        M, D, K = np.zeros((3, len(ids), 6 + k, 6 + k))
        turn = np.broadcast_to(np.eye(6 + m), H.shape).copy()
        turn[:, :6, :6] = rate_matrix(X[:, :6])
        M[:, : 6 + m, : 6 + m] = np.swapaxes(turn, -1, -2) @ H @ turn
        if self._nonlinear is None:
            parts = (base.M, base.D, base.K)
            if bodies is not None:
                parts = (bodies.M[ids], bodies.D[ids], bodies.K[ids])
            M[:, :6, :6] += parts[0]
            D[:, :6, :6], K[:, :6, :6] = parts[1:]
            drag = self._drag(ids)
            if drag is not None:  # by its secant
                D[:, range(6), range(6)] += drag * np.abs(X[:, 6:])
        else:  # linearised about this instant; a force held would feed energy into a spring
            mobility, offset, by_y, by_yd = _linearised(
                self._vehicle(ids), X, stacked=self.custom is None
            )
            body = np.linalg.inv(mobility).astype(np.float64)
            M[:, :6, :6] += body
            K[:, :6, :6], D[:, :6, :6] = -body @ by_y, -body @ by_yd
            offset = offset - matvec(by_y, X[:, :6]) - matvec(by_yd, X[:, 6:])
            force = np.add(force, matvec(body, offset))
        joints = np.arange(6, 6 + m)
        D[:, joints, joints], K[:, joints, joints] = self.kd[ids, :m], self.kp[ids, :m]
        if self._carried:
            at = np.r_[:6, 6 + m : 6 + k]
            wide = (
                self._wide[:, None] if bodies is None else np.swapaxes(bodies.wide[ids], 0, 1)
            )
            for part, block in zip((M, D, K), wide, strict=True):
                part[:, at[:, None], at] += block
        state = np.concatenate(
            [X[:, :6], coupled_state[:, :k], X[:, 6:], coupled_state[:, k:]], axis=-1
        )
        return M, D, K, state, np.concatenate([force, np.zeros((len(ids), k))], axis=-1)

    def _split(self, X: Array) -> tuple[Array, Array]:
        """State of the vehicle (n, 12) and of all else (n, 2m) from that of both."""
        m = self._moving + self._carried
        base = np.concatenate([X[:, :6], X[:, 6 + m : 12 + m]], axis=-1)
        return base, np.concatenate([X[:, 6 : 6 + m], X[:, 12 + m :]], axis=-1)

    def _predict(self, H: Array, path: tuple[Array, Array, Array]) -> None:
        """Predict the reading that the arm's inertia causes, by models of platform and sensor.

        The inertia holds over the period, so it may act after the sensor's filter.
        """
        s, m = self.state, self._moving
        y, yd, ydd = path
        T = rate_matrix(y[:, 0])
        steady = np.zeros((self.n, 6))
        if m:
            mean = matvec(T, (yd[:, -1] - yd[:, 0]) / self.dt)
            across, gains = H[:, :6, 6:], np.zeros((2, self.n, m, m))
            gains[0, :, range(m), range(m)], gains[1, :, range(m), range(m)] = (
                self.kd.T,
                self.kp.T,
            )
            push = -matvec(np.swapaxes(across, -1, -2), mean)
            arm_response = implicit_step(
                H[:, 6:, 6:], gains[0], gains[1], s.arm_response, push, self.dt
            )
            steady = matvec(across, (arm_response[:, m:] - s.arm_response[:, m:]) / self.dt)
            s.arm_response = arm_response
        s.payload = self._model_filter.carry(s.payload, ydd, H[:, :6, :6] @ T, steady)

    def _check(self, command: Array) -> None:
        """Freeze platforms that may not go on, and say why (thesis 2.4.2)."""
        s, spec, stewart = self.state, self.spec, self.spec.stewart
        poses = np.stack([s.command_sent[:, :6], command[:, :6]])
        before, after = stewart.leg_lengths(poses)
        outside, far, length = stewart.beyond(after)
        hasty, fast, speed = stewart.too_fast(before, after, self.dt)
        force = np.linalg.norm(s.reading[:, :3], axis=1)
        moment = np.linalg.norm(s.reading[:, 3:], axis=1)
        # asked this way round, what is not a number counts as unsafe
        safe = ~(outside | hasty) & (force <= spec.force_max) & (moment <= spec.moment_max)
        for i in np.flatnonzero(~safe & ~s.frozen).tolist():
            if outside[i]:
                reason = (
                    f"leg {far[i] + 1} would be {length[i]:.3f} m long, its range is"
                    f" {stewart.length_min:.3f} to {stewart.length_max:.3f} m (outside the"
                    " workspace)"
                )
            elif not force[i] <= spec.force_max:
                reason = f"force {force[i]:.0f} N is above the limit of {spec.force_max:g} N"
            elif not moment[i] <= spec.moment_max:
                limit = f"{spec.moment_max:g} N m"
                reason = f"moment {moment[i]:.0f} N m is above the limit of {limit}"
            else:
                reason = (
                    f"leg {fast[i] + 1} would move at {speed[i]:.2f} m/s, its limit is"
                    f" {stewart.speed_max:g} m/s"
                )
            self.freeze(np.array([i]), reason)

    def freeze(self, ids: Index, reason: str) -> None:
        """Stop platforms where they are commanded to be, until they are reset (App. E rule 1).

        Args:
            ids: (m,) which.
            reason: of the event.
        """
        s = self.state
        for i in ids[~s.frozen[ids]].tolist():
            s.frozen[i] = True
            self.events.append(Event(i, float(s.time[i]), reason))


def _all_bodies(system: System) -> tuple[int, ...]:
    """Arm and vehicle as described and as they are."""
    return bodies_of(system) + bodies_of(system.actual)


def _require_vehicle(system: System, admittance: Nonlinear | None) -> None:
    """Refuse effects on a vehicle whose place an `admittance` takes."""
    on_base = [e.kind for e in system.effects if isinstance(e, BaseEffect)]
    if admittance is not None and on_base:
        raise ParameterError(
            f"effect {on_base[0]} would do nothing: an `admittance` takes the vehicle's place"
        )


def _linearised(g: Nonlinear, X: Array, stacked: bool) -> tuple[Array, Array, Array, Array]:
    """Y'' = mobility W + rest of X' = g(X, W) at W = 0, and the rest's slopes along Y and Y'.

    `stacked`: g takes further leading axes, so that one call answers all.

    Returns:
        (n, 6, 6), (n, 6), (n, 6, 6), (n, 6, 6).
    """
    zero = np.zeros((len(X), 6))
    tries = [(X, zero), *((X, zero + push) for push in np.eye(6))]
    tries += [(X + _STEP * way, zero) for way in np.eye(12)]
    if stacked:
        out = g(*(np.stack(part) for part in zip(*tries, strict=True)))[..., 6:]
    else:
        out = np.stack([g(*point) for point in tries])[..., 6:]
    offset = out[0]
    change = np.moveaxis(out[1:] - offset, 0, -1)
    slope = change[..., 6:] / _STEP
    return change[..., :6], offset, slope[..., :6], slope[..., 6:]
