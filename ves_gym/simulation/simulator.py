"""`Simulator`: n copies of one System in lockstep. A single simulation is a batch of one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, Index, Mask, ParameterError, integer
from ves_gym.engine.backends import make_backend
from ves_gym.engine.backends.base import Backend
from ves_gym.hardware.admittance import Nonlinear
from ves_gym.mechanics.servo import FREE, OWN_GAINS, JointServo
from ves_gym.mechanics.vehicle import has_jets, orbit_of
from ves_gym.simulation.assigned_systems import assign, assign_effects
from ves_gym.simulation.base_actuators import BaseActuators
from ves_gym.simulation.capture import Capture, PayloadHandler
from ves_gym.simulation.emulation_loop import EmulationLoop
from ves_gym.simulation.gravity_gradient import GravityGradient
from ves_gym.simulation.joint_delays import JointDelays, joint_delays_of
from ves_gym.simulation.loop_linearisation import warn_if_unstable
from ves_gym.simulation.machines import ControlPeriod, Divergence, Machines, Part
from ves_gym.simulation.stable_step import require_stable_step
from ves_gym.simulation.state import (
    Event,
    Readings,
    Snapshot,
    State,
    broadcast,
    generator_arrays,
    numbers,
    set_generators,
    simulation_ids,
)
from ves_gym.simulation.tool_contact import ToolContact
from ves_gym.system.effect_rows import EffectRows
from ves_gym.system.system import System


class Simulator:
    """n simulations of one system, or of systems that differ in numbers (`assign`).

    Args:
        system: what to simulate.
        n: number of simulations, >= 1.
        servo: joint servo, or None for bare torque input; ignored by a prescribed drive.
        backend: engine, "auto" (the compiled kernel wherever it can be had), "kernel",
            "mujoco", or "gpu-kernel" (the same equations on a GPU; "gpu-kernel-float32": in
            single precision); `backend_name` says which one runs.
        threads: threads of the engine, 0 = one per processor.
        seed: root of the per-simulation random generators; simulation i draws the same
            numbers whatever n is.
        on_divergence: "raise" a `Divergence` that names simulation, time and joint, or
            "mark" it in `diverged` and leave that simulation where it is.
        admittance: mode emulated: a nonlinear vehicle g(X, W) -> X' that takes the place of
            the linear one, X (n, 12) = (Y, Y'), W (n, 6) conjugate to Y (thesis eq. 2.2).
        warn_at: mode emulated: joint angles at which the loop's stability is judged; an
            unstable one is an `EmulationWarning`. None: not judged.
        compiled: mode emulated: the kernel runs the loop's blocks as compiled code; False: in
            NumPy, quicker for a few periods of a loop whose code there is not yet.
    """

    def __init__(
        self,
        system: System,
        n: int = 1,
        *,
        servo: JointServo | None = OWN_GAINS,
        backend: str = "auto",
        threads: int = 0,
        seed: int = 0,
        on_divergence: str = "raise",
        admittance: Nonlinear | None = None,
        warn_at: npt.ArrayLike | None = 0.0,
        compiled: bool = True,
    ) -> None:
        self.system, self.n = system, integer(n, "n", 1)
        if on_divergence not in ("raise", "mark"):
            raise ParameterError(f"on_divergence must be raise or mark, got {on_divergence!r}")
        none = (0.0,) * system.arm.n
        self._judged = JointServo(kp=none, kd=none)  # the highest gains so far
        if servo is not None and system.drive == "motor":
            servo = self._judged = servo.for_arm(system.arm, system.vehicle)
        require_stable_step(system.actual, self._judged)
        if system.mode == "ideal" and admittance is not None:
            raise ParameterError("an admittance needs mode emulated, got mode ideal")
        self.joints, self.on_divergence = system.arm.n, on_divergence
        self.backend = make_backend(backend, system.actual, self.n, integer(threads, "threads"))
        self.machines = machines = Machines(system, self.n, self.backend)
        self.generators: list[np.random.Generator] = []
        self.seed(seed)
        self.joint_delays = joint_delays_of(machines)
        self._drives: Backend | JointDelays = self.joint_delays or self.backend
        self.base_actuators: BaseActuators | None = None  # wheels and jets
        if system.mode == "ideal" and (has_jets(system.vehicle) or system.base.carried):
            self.base_actuators = BaseActuators(machines)
        self.emulation_loop: EmulationLoop | None = None
        if system.mode == "emulated":
            compiled = compiled and self.backend.name == "kernel"
            self.emulation_loop = EmulationLoop(
                system, self.n, self.generators, admittance, compiled=compiled
            )
        self.contact = None if self.backend.contact is None else ToolContact(machines)
        orbit = orbit_of(system.vehicle)
        self.gravity_gradient = None if orbit is None else GravityGradient(machines, orbit)
        self.payload: PayloadHandler | None = None
        if system.payload is not None:
            self.payload = PayloadHandler(machines, self.contact, lambda: self.base_modes)
        optional = (
            machines.charts if machines.charts.free else None,
            self.joint_delays, self.emulation_loop, self.contact, self.payload,
            self.base_actuators, self.gravity_gradient,
        )  # fmt: skip
        # in this order they act, before and after the engine
        self.parts: tuple[Part, ...] = tuple(k for k in optional if k is not None)
        self._by_period = any(part.periodic for part in self.parts)
        self._shares = np.arange(system.substeps + 1)[:, None] / system.substeps
        if servo is not None and system.drive == "motor":
            self.set_gains(servo.kp, servo.kd)
        self.servo = servo if servo is not None else FREE
        if self.emulation_loop is not None and warn_at is not None and admittance is None:
            warn_if_unstable(type(self), system, warn_at, servo)
        self.reset()

    # ------------------------------------------------------------------ state

    @property
    def backend_name(self) -> str:
        """The engine that runs, as in `engine.backends.BACKENDS` but for auto."""
        return self.backend.name

    @property
    def diverged(self) -> Mask:
        """(n,) simulations that left the meaningful range and stay where they are."""
        return self.machines.diverged

    @property
    def last_state(self) -> State:
        """State after the last step or reset."""
        return self.machines.last_state

    @property
    def state(self) -> State:
        """A copy of the present state."""
        return self.machines.state

    def stepped_elsewhere(self) -> None:
        """The engine has been stepped by a program of its own (`KernelBackend.pieces`)."""
        self.machines.changed()

    def rows_of(self, ids: Index) -> dict[str, Array]:
        """All that simulations have from their assignment and reset, by name.

        Args:
            ids: (k,) which; of a compiled engine, with nothing in Python beside it.
        """
        engine: Any = self.backend
        parts = {part.name: part.rows_of(ids) for part in (self.machines, *self.parts)}
        parts["engine"] = engine.rows_of(ids)
        return {f"{part}.{k}": v for part, rows in parts.items() for k, v in rows.items()}

    def begin_with(self, ids: Index, rows: Mapping[str, Array]) -> None:
        """Begin simulations as others have begun, see `rows_of`.

        Args:
            ids: (k,) which.
            rows: (k, ...) by name; of simulations that no system is assigned to,
                "engine.x" will do.
        """
        engine: Any = self.backend
        of: dict[str, dict[str, Array]] = {}
        for name, values in rows.items():
            owner, _, attribute = name.partition(".")
            of.setdefault(owner, {})[attribute] = values
        engine.begin_with(ids, of["engine"])
        for part in (*self.parts, self.machines):
            part.begin_with(ids, of.get(part.name, {}))

    def note_gains(self, kp: Array, kd: Array) -> None:
        """Take note of servo gains that such a program has set.

        Args:
            kp, kd: (n, joints) [N m/rad], [N m s/rad].
        """
        self.machines.kp[:], self.machines.kd[:] = kp, kd

    def note_divergence(self) -> None:
        """Look for simulations that such a program has left beyond the meaningful range."""
        note = getattr(self.backend, "note_faults", None)
        if note is not None:
            note()
        self._watch()

    def seed(self, seed: int) -> None:
        """Restart the random generators."""
        root = integer(seed, "seed")
        self.generators[:] = [np.random.default_rng((root, i)) for i in range(self.n)]

    def reset(
        self,
        *,
        q: npt.ArrayLike = 0.0,
        v: npt.ArrayLike = 0.0,
        y: npt.ArrayLike = 0.0,
        yd: npt.ArrayLike = 0.0,
        wheel_speed: npt.ArrayLike = 0.0,
        spread: Mapping[str, npt.ArrayLike] | None = None,
        ids: npt.ArrayLike | None = None,
        time: npt.ArrayLike = 0.0,
    ) -> State:
        """Put all or some simulations in the given state, appendages at rest.

        Args:
            q, v: joint angles and rates, broadcast to (k, joints).
            y, yd: base pose and its rate, broadcast to (k, 6).
            wheel_speed: of a satellite's reaction wheels, broadcast to (k, w) [rad/s].
            spread: standard deviation of a normal draw added to any of q, v, y, yd.
            ids: which simulations (k of them), or None for all.
            time: that their clocks show, broadcast to (k,) [s].
        """
        index = simulation_ids(ids, self.n)
        clock = broadcast(time, "time", (len(index),))
        values = {"q": q, "v": v, "y": y, "yd": yd}
        unknown = [key for key in spread or {} if key not in values]
        if unknown:
            raise ParameterError(f"spread: unknown key {unknown[0]!r}; known: q, v, y, yd")
        full = {}
        for name, value in values.items():
            width = self.joints if name in "qv" else 6
            full[name] = broadcast(value, name, (len(index), width)).copy()
            if spread and name in spread:
                scale = broadcast(spread[name], f"spread[{name!r}]", (len(index), width))
                for row, i in enumerate(index):
                    full[name][row] += scale[row] * self.generators[i].standard_normal(width)
        start = State(clock, full["y"], full["yd"], full["q"], full["v"])
        z, zd = np.hstack([start.y, start.q]), np.hstack([start.yd, start.v])
        self.backend.write(index, clock, z, zd)
        self._set_wheels(index, wheel_speed)
        machines = self.machines
        machines.diverged[index], machines.steps = False, 0
        for part in self.parts:
            part.reset(machines, index, start)
        machines.changed()
        return self.last_state

    def _set_wheels(self, index: Index, wheel_speed: npt.ArrayLike) -> None:
        """Set the speeds of reaction wheels, everything else that the base carries at rest."""
        machines = self.machines
        if not machines.wheels and np.any(wheel_speed):
            raise ParameterError(
                "wheel_speed needs a vehicle with reaction wheels, got"
                f" {type(self.system.vehicle).__name__}"
            )
        if machines.wheels:
            rates = np.zeros((len(index), machines.carried))
            shape = (len(index), machines.wheels)
            rates[:, : machines.wheels] = broadcast(wheel_speed, "wheel_speed", shape)
            self.backend.set_carried(index, np.zeros_like(rates), rates)

    @property
    def wheel_speed(self) -> Array:
        """(n, w) speeds of the reaction wheels against the satellite [rad/s]."""
        return self.machines.wheel_speed

    def point(self, attitude: npt.ArrayLike, ids: npt.ArrayLike | None = None) -> None:
        """Set the attitude that the satellite's pointing holds from the next period on.

        Args:
            attitude: (k, 4) unit quaternions, scalar first, or one for all.
            ids: which simulations (k of them), None for all.
        """
        if self.base_actuators is None or self.base_actuators.pointing is None:
            raise ParameterError(
                "point needs a satellite with pointing, got"
                f" {type(self.system.vehicle).__name__}"
            )
        index = simulation_ids(ids, self.n)
        target = broadcast(attitude, "attitude", (len(index), 4))
        if (np.abs(np.linalg.norm(target, axis=1) - 1) > 1e-6).any():
            raise ParameterError(f"attitude must be unit quaternions, got {target.tolist()}")
        self.base_actuators.target[index] = target

    def snapshot(self) -> Snapshot:
        """The complete state, random generators included; picklable."""
        machines = self.machines
        arrays = {part.name: part.get_state() for part in (machines, *self.parts)}
        arrays |= {
            "engine": self.backend.get_state(),
            "generators": generator_arrays(self.generators),
        }
        return Snapshot(self.system.hash, self.backend.name, self.n, machines.assigned, arrays)

    def restore(self, snapshot: Snapshot) -> None:
        """Return to a snapshot of the same system and the same n, and to what it assigned.

        Raises:
            ParameterError: a snapshot of something else; nothing has changed then.
        """
        theirs = (snapshot.system_hash[:12], snapshot.n, snapshot.backend_name)
        ours = (self.system.hash[:12], self.n, self.backend.name)
        if theirs != ours:
            both = ("system {} with n = {} on backend {}".format(*k) for k in (theirs, ours))
            raise ParameterError("snapshot is of {}, this is {}".format(*both))
        machines, live, then = self.machines, self.machines.assigned, snapshot.assigned
        ids = [i for i in sorted(then.keys() | live.keys()) if then.get(i) is not live.get(i)]
        if ids:
            self.assign([then.get(i, self.system) for i in ids], np.array(ids))
        self.backend.set_state(snapshot.arrays["engine"])
        set_generators(self.generators, snapshot.arrays["generators"])
        for part in (machines, *self.parts):
            part.set_state(snapshot.arrays[part.name])
        machines.changed()

    @property
    def systems(self) -> tuple[System, ...]:
        """The n systems in force: the simulator's own, or what `assign` has put there."""
        return self.machines.systems

    def assign(self, systems: Sequence[System], ids: npt.ArrayLike | None = None) -> None:
        """Give simulations systems of their own, which differ from the simulator's in numbers.

        Simulation i then runs as in a simulator of that system alone; its neighbours run on
        untouched, and nothing is compiled anew, unless an emulation loop lacks what an effect
        asks for (a delay, short legs). What may differ: masses, centres of mass,
        inertias, rotors and torque limits of the arm, the vehicle's M, D, K (or a satellite's
        body) and the values of the effects, which are the same kinds in the same order.

        Takes effect at once and leaves the state, servo gains included, where it is. Call
        `reset` after it, as an environment does: the memory of sensors and platforms is that
        of the machine before. Stability of an emulation (`warn_at`) is not judged again.

        The kernel leaves out of its code what is zero in the simulator's own system. So its
        own system is a template: a number (of the arm, of M, D, K in mode ideal, of a torque
        law; not of an effect on the laboratory) that is zero there is zero in all of them.

        Args:
            systems: one for each of ids. Fastest where arm and vehicle are the very objects
                that the simulation had, as `system.replace(effects=...)` leaves them.
            ids: which simulations, or None for all.

        Raises:
            ParameterError: a system differs in more than numbers, or in a structural zero;
                nothing has been assigned then.
        """
        assign(self.machines, self.parts, systems, simulation_ids(ids, self.n), self._judged)

    def assign_effects(self, rows: EffectRows, ids: npt.ArrayLike | None = None) -> None:
        """Give simulations effects with parameters of their own, as `assign` does, but at once.

        Much faster where the effects take arrays (`EffectRows.together`) and leave arm, vehicle
        and delays alone; otherwise this is `assign` with a system per simulation.

        Args:
            rows: of the simulator's own system, one row for each of ids.
            ids: which simulations, or None for all.

        Raises:
            ParameterError: as `assign`.
        """
        assign_effects(
            self.machines, self.parts, rows, simulation_ids(ids, self.n), self._judged
        )

    def set_gains(
        self, kp: npt.ArrayLike, kd: npt.ArrayLike, ids: npt.ArrayLike | None = None
    ) -> None:
        """Set servo gains.

        Args:
            kp, kd: [N m/rad], [N m s/rad], broadcast to (k, joints).
            ids: which simulations (k of them), None for all.
        """
        if self.system.drive != "motor":
            raise ParameterError("a prescribed drive has no servo gains to set")
        index = simulation_ids(ids, self.n)
        shape = (len(index), self.joints)
        gains = broadcast(kp, "kp", shape), broadcast(kd, "kd", shape)
        self.require_stable(*gains)
        self.machines.set_gains(index, *gains)

    def require_stable(self, kp: npt.ArrayLike, kd: npt.ArrayLike) -> None:
        """Refuse gains that are too fast for the physics step.

        Args:
            kp, kd: [N m/rad], [N m s/rad], broadcast to (k, joints).

        Raises:
            ParameterError: it names the step that they need.
        """
        before = self._judged.kp, self._judged.kd
        rows = np.atleast_2d(kp), np.atleast_2d(kd)
        top = [np.maximum(k.max(axis=0), b) for k, b in zip(rows, before, strict=True)]
        if any((k > b).any() for k, b in zip(top, before, strict=True)):
            highest = JointServo(kp=tuple(top[0].tolist()), kd=tuple(top[1].tolist()))
            require_stable_step(self.system.actual, highest)
            self._judged = highest

    # ----------------------------------------------------------------- payload

    def grasp(
        self, ids: npt.ArrayLike | None = None, *, directions: object = None
    ) -> list[Capture]:
        """Close the latch on the payload, see `PayloadHandler.grasp`.

        Args:
            ids: which simulations, or None for all.
            directions: of the relative twist that close, None for all.
        """
        return self._handler().grasp(ids, directions=directions)

    def release(self, ids: npt.ArrayLike | None = None) -> list[Capture]:
        """Open the latch, see `PayloadHandler.release`.

        Args:
            ids: which simulations, or None for all.
        """
        return self._handler().release(ids)

    def _handler(self) -> PayloadHandler:
        if self.payload is None:
            raise ParameterError("the system has no payload: give System(payload=...)")
        return self.payload

    # ---------------------------------------------------------------- stepping

    def step(
        self,
        command: npt.ArrayLike = 0.0,
        *,
        until: npt.ArrayLike | None = None,
        base_wrench: npt.ArrayLike | None = None,
        wheel_torque: npt.ArrayLike | None = None,
        platform: npt.ArrayLike | None = None,
    ) -> State:
        """Advance one control period, the command held or running linearly to another.

        Args:
            command: (n, joints), broadcast. Motor drive: torque [N m] on top of what the
                servo gains give around zero position and rate (see `servo_command`).
                Prescribed drive: joint acceleration [rad/s^2].
            until: (n, joints) command at the end of the period, linear until there;
                None: held.
            base_wrench: (n, 6) jets' wrench in the platform frame [N, N m]; only a
                vehicle with thrusters or jets accepts it, and jets make of it what their
                thrust and whole pulses allow.
            wheel_torque: (n, w) of the reaction wheels' motors on the rotors [N m], within
                their torque and momentum limits.
            platform: pose (n, 6), or pose and rate (n, 12), that the platform shall
                follow; emulators under position control only.
        """
        start = np.ascontiguousarray(broadcast(command, "command", (self.n, self.joints)))
        # a held command as a view of length k + 1: the kernel copies nothing then, and
        # `np.broadcast_to` would take a tenth of a step
        shape = (self.n, self.system.substeps + 1, self.joints)
        row, column = start.strides
        nodes: Array = np.ndarray(shape, np.float64, start, 0, (row, 0, column))
        if until is not None:
            end = broadcast(until, "until", start.shape)
            nodes = start[:, None] + (end - start)[:, None] * self._shares
        follow = None if platform is None else self._platform(platform, 1)
        commands = self._commands(base_wrench, wheel_torque)
        self.machines.steps = 0  # whatever `play` has left of a period
        self._run(nodes, follow, *commands)
        return self.last_state

    def _commands(
        self, wrench: npt.ArrayLike | None, torque: npt.ArrayLike | None
    ) -> tuple[Array | None, Array | None]:
        """Return commands of jets (n, 6) and wheels (n, w), None where there are none."""
        if wrench is None and torque is None:
            return None, None
        vehicle, wheels = self.system.vehicle, self.machines.wheels
        for name, value, possible, kind in (
            ("wheel_torque", torque, wheels, "reaction wheels"),
            ("base_wrench", wrench, has_jets(vehicle), "thrusters or jets"),
        ):
            if value is not None and self.system.mode == "emulated":
                raise ParameterError(f"{name} needs mode ideal, got mode emulated")
            if value is not None and not possible:
                got = type(vehicle).__name__
                raise ParameterError(f"{name} needs a vehicle with {kind}, got {got}")
        return (
            None if wrench is None else broadcast(wrench, "base_wrench", (self.n, 6)),
            None if torque is None else broadcast(torque, "wheel_torque", (self.n, wheels)),
        )

    def servo_command(self, q: Array, v: Array, tau: Array | float = 0.0) -> Array:
        """Return the command that makes the servo track a motion.

        Args:
            q, v: (n, ..., joints) angles [rad] and rates [rad/s].
            tau: feed-forward torque [N m].

        Returns:
            (n, ..., joints) [N m].
        """
        middle = (slice(None), *(None,) * (np.ndim(q) - 2))
        return self.machines.kp[middle] * q + self.machines.kd[middle] * v + tau

    def play(self, commands: Array, platform: npt.ArrayLike | None = None) -> None:
        """Advance k physics steps.

        In mode emulated k must be complete control periods.

        Args:
            commands: (n, k + 1, joints), linear over each step.
            platform: (n, periods, 12) pose and rate to follow from each period's start, under
                position control.
        """
        expected = (
            f"commands must be numbers of shape ({self.n}, k + 1, {self.joints}), k >= 1, got"
        )
        sent = numbers(commands, expected)
        if sent.ndim != 3 or sent.shape[1] < 2:
            raise ParameterError(f"{expected} {sent.shape}")
        nodes = broadcast(sent, "commands", (self.n, sent.shape[1], self.joints))
        periods, remainder = divmod(nodes.shape[1] - 1, self.system.substeps)
        if remainder and self.emulation_loop is not None:
            raise ParameterError(
                f"in mode emulated commands must cover whole control periods of"
                f" {self.system.substeps} physics steps, got {nodes.shape[1] - 1} steps"
            )
        self._run(nodes, None if platform is None else self._platform(platform, periods))

    def _run(
        self,
        nodes: Array,
        platform: Array | None = None,
        base_wrench: Array | None = None,
        wheel_torque: Array | None = None,
    ) -> None:
        """Advance by commands (n, k + 1, joints), by periods where a part acts in each."""
        machines, drives, substeps = self.machines, self._drives, self.system.substeps
        _ = self.last_state  # tells a divergence what was before
        running, done, total = machines.running, 0, nodes.shape[1] - 1
        while done < total:
            at = machines.steps
            steps = min(total - done, substeps - at) if self._by_period else total - done
            after = (at + steps) % substeps
            period = ControlPeriod(
                nodes[:, done : done + steps + 1],
                running,
                begins=at == 0,
                ends=after == 0,
                base_wrench=base_wrench,
                wheel_torque=wheel_torque,
                platform=None if platform is None else platform[:, done // substeps],
            )
            for part in self.parts:
                part.before(machines, period)
            if period.acceleration is None:
                drives.step_sequence(period.commands, running)
            else:
                period.wrench = drives.step_on_platform(
                    period.commands, period.acceleration, running
                )
            for part in self.parts:
                part.after(machines, period)
            machines.steps = after
            done += steps
        self._watch()
        machines.changed()

    @property
    def base_modes(self) -> tuple[Array, Array] | None:
        """u and u' (n, m) of flexures and of what the described base has, None of none.

        Its wheels and appendages, then its internal modes.

        Deflections of the p flexures of an arm that bends come first. In mode emulated the
        platform is behind the vehicle model by its lag: internal modes are deflected from the
        platform as the model's are from the model's own flange, for strain between the two is
        in no spring (it raised E_mean by 11 % on `bent`). None in position control, where
        nothing moves the modes.
        """
        m = self.system.arm.bends + self.system.base.hidden
        at, rate = self.internal_state
        first = len(self.system.actual.arm.geared)  # effects add modes after the base's own
        if not m or at.shape[1] < first + m:
            return None
        u, ud = at[:, first : first + m].copy(), rate[:, first : first + m].copy()
        if (loop := self.emulation_loop) is not None:
            base, vehicle = self.system.base, loop.vehicle_state
            _, z, zd = self.backend.read()
            u[:, -base.m :] += base.attached(z[:, :6] - vehicle[:, :6])
            ud[:, -base.m :] += base.attached(zd[:, :6] - vehicle[:, 6:])
        return u, ud

    @property
    def internal_state(self) -> tuple[Array, Array]:
        """Coordinates and rates (n, g + p + m) beside (Y, q).

        Deflections of the gears that give way and of the flexures [rad], then the oscillators
        that the vehicle carries [m] (`arm.Gear`, `vehicle.Oscillator`).
        """
        at, rate = self.backend.internal_state()
        if self.emulation_loop is None:
            return at, rate
        u, ud = self.emulation_loop.carried
        return np.concatenate([at, u], axis=1), np.concatenate([rate, ud], axis=1)

    @property
    def measured(self) -> tuple[Array, Array]:
        """Joint angles and rates (n, joints) as controller and log see them."""
        state = self.state
        return self.machines.measured_of(state.q, state.v)

    def _platform(self, platform: npt.ArrayLike, periods: int) -> Array:
        """(n, periods, 12) pose and rate that the platform shall follow."""
        operation = self._laboratory("platform needs").spec.operation
        if operation != "position":
            raise ParameterError(
                f"platform needs an emulator under position control, got {operation}"
            )
        pose = numbers(platform, "platform must be numbers of shape (n, 6) or (n, 12), got")
        if pose.ndim < 3:
            if pose.ndim and pose.shape[-1] == 6:
                pose = np.concatenate([pose, np.zeros_like(pose)], axis=-1)
            wide = broadcast(pose, "platform", (self.n, 12))
            return np.repeat(wide[:, None], periods, axis=1)
        return broadcast(pose, "platform", (self.n, periods, 12))

    # --------------------------------------------------------------- laboratory

    def _laboratory(self, needs: str) -> EmulationLoop:
        """The emulation loop, or a ParameterError of what needs one."""
        if self.emulation_loop is None:
            raise ParameterError(f"{needs} mode emulated, got mode ideal")
        return self.emulation_loop

    @property
    def readings(self) -> Readings:
        """Mode emulated: what force sensor, gravity estimate and platform report now."""
        return self._laboratory("readings need").readings

    @property
    def events(self) -> list[Event]:
        """Safety stops since the resets: platforms that froze, when and why."""
        return [] if self.emulation_loop is None else self.emulation_loop.events

    def use_gravity(self, table: npt.ArrayLike | None) -> None:
        """Take the gravity wrench from a table (n, m, 6) instead of the model.

        One row per reading from the next on, the last held (Learning Method, thesis 3.3);
        None returns to the model.
        """
        if self.emulation_loop is None or self.emulation_loop.spec.operation != "microgravity":
            raise ParameterError("use_gravity needs mode emulated, operation microgravity")
        if table is None:
            self.emulation_loop.use_table(None)
            return
        rows = max(1, np.shape(table)[1]) if np.ndim(table) == 3 else 1
        self.emulation_loop.use_table(broadcast(table, "table", (self.n, rows, 6)).copy())

    def zero_sensor(self, ids: npt.ArrayLike | None = None) -> None:
        """Set the force sensors' zero from the gravity estimate (thesis App. E, step 9)."""
        self._laboratory("zero_sensor needs").zero(simulation_ids(ids, self.n))

    def freeze(self, ids: npt.ArrayLike | None = None) -> None:
        """Press the platforms' panic buttons: they stand until reset (thesis App. E rule 1)."""
        ids = simulation_ids(ids, self.n)
        self._laboratory("freeze needs").freeze(ids, "panic button")

    def evaluate(self, command: npt.ArrayLike) -> tuple[Array, Array]:
        """Drive torque (n, joints) [N m] and base acceleration Y'' (n, 6) at this state.

        The torque is the drives' command by what has arrived there, the acceleration
        what there really is.
        """
        sent = broadcast(command, "command", (self.n, self.joints))
        for part in self.parts:
            part.before_evaluation(self.machines)
        torque, acceleration = self._drives.evaluate(sent)
        return torque, self.machines.acceleration(acceleration[:, :6])

    # ----------------------------------------------------------------- helpers

    def _watch(self) -> None:
        new = self.backend.faults()
        if self.system.base.body is not None:
            new |= self.machines.tumbled
        if new.any():
            new &= ~self.diverged
        if not new.any():
            return
        self.machines.diverged |= new
        if self.on_divergence == "raise":
            ids = np.flatnonzero(new)
            raise Divergence(self.describe_divergence(int(ids[0])), ids)

    def describe_divergence(self, i: int) -> str:
        """One line naming simulation, time and the worst coordinate while it was finite."""
        return self.machines.describe_divergence(i)
