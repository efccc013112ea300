"""`Simulator`: n copies of one System in lockstep. A single simulation is a batch of one."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, Index, ParameterError
from ves_gym.engine.backends.registry import make_backend
from ves_gym.hardware.admittance import Nonlinear
from ves_gym.mechanics.servo import FREE, OWN_GAINS, JointServo
from ves_gym.mechanics.spatial import matvec, rate_matrix
from ves_gym.mechanics.vehicle import has_jets
from ves_gym.simulation.arguments import broadcast, numbers, simulation_ids
from ves_gym.simulation.assigned_systems import AssignedSystems
from ves_gym.simulation.base_actuators import BaseActuators
from ves_gym.simulation.capture import Capture, Cargo
from ves_gym.simulation.charts import Charts, is_free
from ves_gym.simulation.divergence import Divergence, describe, tumbled
from ves_gym.simulation.emulation_loop import EmulationLoop
from ves_gym.simulation.joint_delays import joint_delays_of
from ves_gym.simulation.loop_linearisation import warn_if_unstable
from ves_gym.simulation.loop_reports import Event, Readings
from ves_gym.simulation.stable_step import require_stable_step
from ves_gym.simulation.state import Snapshot, State
from ves_gym.simulation.touch import Touch
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
        if not isinstance(n, (int, np.integer)) or isinstance(n, bool) or n < 1:
            raise ParameterError(f"n must be a whole number >= 1, got {n!r}")
        if (
            not isinstance(threads, (int, np.integer))
            or isinstance(threads, bool)
            or threads < 0
        ):
            raise ParameterError(f"threads must be a whole number >= 0, got {threads!r}")
        if on_divergence not in ("raise", "mark"):
            raise ParameterError(f"on_divergence must be raise or mark, got {on_divergence!r}")
        if system.mode == "ideal" or system.actual.arm.geared:
            require_stable_step(system.actual)
        if system.mode == "ideal" and admittance is not None:
            raise ParameterError("an admittance needs mode emulated, got mode ideal")
        self.system, self.n = system, int(n)
        self.joints = system.arm.n
        self.backend = make_backend(backend, system.actual, self.n, threads)
        self.assigned_systems = AssignedSystems(self)
        self.joint_delays = joint_delays_of(system, self.n)  # None where there can be none
        free = system.mode == "ideal" and is_free(system.actual.base)
        self._charts = Charts(self.n) if free else None
        self.base_actuators: BaseActuators | None = None  # wheels and jets
        acts = has_jets(system.vehicle) or bool(system.base.carried)
        if system.mode == "ideal" and acts:
            self.base_actuators = BaseActuators(system, self.n)
        self.on_divergence = on_divergence
        self.generators: list[np.random.Generator] = []
        self.seed(seed)
        self.emulation_loop: EmulationLoop | None = None
        if system.mode == "emulated":
            compiled = compiled and self.backend.name == "kernel"
            self.emulation_loop = EmulationLoop(
                system, self.n, self.generators, admittance, compiled=compiled
            )
        if servo is not None and system.drive == "motor":
            servo = servo.for_arm(system.arm)
        self.servo = servo if servo is not None else FREE
        self._kp = np.zeros((n, self.joints))
        self._kd = np.zeros((n, self.joints))
        if system.drive == "motor" and servo is not None:
            self.set_gains(servo.kp, servo.kd)
        if self.emulation_loop is not None and warn_at is not None and admittance is None:
            warn_if_unstable(type(self), system, warn_at, servo)
        self.diverged = np.zeros(n, bool)
        self._last_state: State | None = None
        self.touch: Touch | None = None  # contact at the tool
        if self.backend.contact is not None:
            self.touch = Touch(self.backend, self.n, self._charts)
        self.payload = None if system.payload is None else Cargo(self)
        self.reset()

    # ------------------------------------------------------------------ state

    @property
    def backend_name(self) -> str:
        """The engine that runs, as in `engine.backends.registry.BACKENDS` but for auto."""
        return self.backend.name

    @property
    def last_state(self) -> State:
        """State after the last step or reset."""
        if self._last_state is None:
            self._last_state = self.state
        return self._last_state

    @last_state.setter
    def last_state(self, state: State) -> None:
        self._last_state = state

    def stepped_elsewhere(self) -> None:
        """The engine has been stepped by a program of its own (`KernelBackend.pieces`)."""
        self._last_state = None

    def note_gains(self, kp: Array, kd: Array) -> None:
        """Take note of servo gains that such a program has set.

        Args:
            kp, kd: (n, joints) [N m/rad], [N m s/rad].
        """
        self._kp[:], self._kd[:] = kp, kd

    def note_divergence(self) -> None:
        """Look for simulations that such a program has left beyond the meaningful range."""
        note = getattr(self.backend, "note_faults", None)
        if note is not None:
            note()
        self._watch()

    @property
    def state(self) -> State:
        """A copy of the present state."""
        time, z, zd = self.backend.read()
        y, yd = z[:, :6], zd[:, :6]
        if self._charts is not None:
            y, yd = self._charts.outside(y, yd)
        return State(time, y, yd, z[:, 6:], zd[:, 6:])

    def seed(self, seed: int) -> None:
        """Restart the random generators."""
        if not isinstance(seed, (int, np.integer)) or isinstance(seed, bool) or seed < 0:
            raise ParameterError(f"seed must be a whole number >= 0, got {seed!r}")
        self.generators[:] = [
            np.random.Generator(np.random.PCG64(np.random.SeedSequence((int(seed), i))))
            for i in range(self.n)
        ]

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
        self.backend.write(
            index,
            clock,
            np.hstack([full["y"], full["q"]]),
            np.hstack([full["yd"], full["v"]]),
        )
        if self._charts is not None:
            self._charts.reset(index)
        self._reset_carried(index, wheel_speed)
        if self.joint_delays is not None:
            self.joint_delays.reset(index, full["q"], full["v"])
        if self.emulation_loop is not None:
            gains = self._kp[index], self._kd[index]
            self.emulation_loop.reset(index, full["q"], full["y"], full["yd"], *gains)
        if self.touch is not None:
            self.touch.framed(index)
        if self.payload is not None:
            self.payload.reset(index)
        self.diverged[index] = False
        self.last_state = self.state
        if self.base_actuators is not None:
            self.base_actuators.reset(index, self.last_state, self.backend)
        return self.last_state

    def _reset_carried(self, index: Index, wheel_speed: npt.ArrayLike) -> None:
        """Set the speeds of reaction wheels, everything else that the base carries at rest."""
        wheels = 0 if self.base_actuators is None else len(self.base_actuators.wheels)
        if not wheels:
            if np.any(wheel_speed):
                raise ParameterError(
                    "wheel_speed needs a vehicle with reaction wheels, got"
                    f" {type(self.system.vehicle).__name__}"
                )
            return
        speed = broadcast(wheel_speed, "wheel_speed", (len(index), wheels))
        rates = np.zeros((len(index), len(self.system.base.carried)))
        rates[:, :wheels] = speed
        self.backend.set_carried(index, np.zeros_like(rates), rates)

    @property
    def wheel_speed(self) -> Array:
        """(n, w) speeds of the reaction wheels against the satellite [rad/s]."""
        if self.base_actuators is None:
            return np.zeros((self.n, 0))
        arm, wheels = self.system.actual.arm, len(self.base_actuators.wheels)
        first = len(arm.geared) + arm.bends
        return self.backend.internal_state()[1][:, first : first + wheels]

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
        return Snapshot(
            self.system.hash,
            self.backend.name,
            self.backend.get_state(),
            tuple(copy.deepcopy(g.bit_generator.state) for g in self.generators),
            (self._kp.copy(), self._kd.copy()),
            self.diverged.copy(),
            None if self.emulation_loop is None else self.emulation_loop.get_state(),
            self.assigned_systems.systems,
            None if self.joint_delays is None else self.joint_delays.get_state(),
            None if self._charts is None else self._charts.get_state(),
            None if self.payload is None else self.payload.get_state(),
            None if self.base_actuators is None else self.base_actuators.get_state(),
        )

    def restore(self, snapshot: Snapshot) -> None:
        """Return to a snapshot of the same system and the same n, and to what it assigned."""
        if snapshot.system_hash != self.system.hash or len(snapshot.diverged) != self.n:
            raise ParameterError(
                f"snapshot is of system {snapshot.system_hash[:12]} with n ="
                f" {len(snapshot.diverged)}, this is {self.system.hash[:12]} with n = {self.n}"
            )
        if snapshot.backend_name != self.backend.name:
            raise ParameterError(
                f"snapshot is of backend {snapshot.backend_name}, this is {self.backend.name}"
            )
        self.assigned_systems.restore(snapshot.assigned)
        self.backend.set_state(snapshot.backend)
        if self.system.drive == "motor":
            self.set_gains(*snapshot.gains)
        for generator, state in zip(self.generators, snapshot.generators, strict=True):
            generator.bit_generator.state = copy.deepcopy(state)
        if self.emulation_loop is not None:
            self.emulation_loop.set_state(snapshot.emulation_loop)
        if self.joint_delays is not None:
            self.joint_delays.set_state(snapshot.joint_delays)
        if self._charts is not None:
            self._charts.set_state(snapshot.charts)
        if self.payload is not None:
            self.payload.set_state(snapshot.payload)
        if self.base_actuators is not None:
            self.base_actuators.set_state(snapshot.base_actuators, self.backend)
        self.diverged = snapshot.diverged.copy()
        self.last_state = self.state

    @property
    def systems(self) -> tuple[System, ...]:
        """The n systems in force: the simulator's own, or what `assign` has put there."""
        assigned = self.assigned_systems.systems
        return tuple(assigned.get(i, self.system) for i in range(self.n))

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
        self.assigned_systems.assign(systems, simulation_ids(ids, self.n))

    def assign_effects(self, rows: EffectRows, ids: npt.ArrayLike | None = None) -> None:
        """Give simulations effects with parameters of their own, as `assign` does, but at once.

        Much faster where the effects take arrays (`EffectRows.together`) and leave the arm
        alone; otherwise this is `assign` with a system per simulation.

        Args:
            rows: of the simulator's own system, one row for each of ids.
            ids: which simulations, or None for all.

        Raises:
            ParameterError: as `assign`.
        """
        self.assigned_systems.assign_effects(rows, simulation_ids(ids, self.n))

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
        self._kp[index] = broadcast(kp, "kp", shape)
        self._kd[index] = broadcast(kd, "kd", shape)
        self.backend.set_gains(index, self._kp[index], self._kd[index])

    # ----------------------------------------------------------------- payload

    def grasp(
        self, ids: npt.ArrayLike | None = None, *, directions: object = None
    ) -> list[Capture]:
        """Close the latch on the payload, see `Cargo.grasp`.

        Args:
            ids: which simulations, or None for all.
            directions: of the relative twist that close, None for all.
        """
        return self._cargo().grasp(ids, directions=directions)

    def release(self, ids: npt.ArrayLike | None = None) -> list[Capture]:
        """Open the latch, see `Cargo.release`.

        Args:
            ids: which simulations, or None for all.
        """
        return self._cargo().release(ids)

    def _cargo(self) -> Cargo:
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
        torque = broadcast(command, "command", (self.n, self.joints))
        end = None if until is None else broadcast(until, "until", torque.shape)
        if self.emulation_loop is not None:
            if base_wrench is not None or wheel_torque is not None:
                given = "wheel_torque" if base_wrench is None else "base_wrench"
                raise ParameterError(f"{given} needs mode ideal, got mode emulated")
            self._ride(self._nodes(torque, end), self._platform(platform, 1))
        else:
            if platform is not None:
                raise ParameterError("platform needs mode emulated, got mode ideal")
            self._recentre()
            push = self._base_force(base_wrench, wheel_torque)
            if self.joint_delays is not None and self.joint_delays.busy:
                self._drive(self._nodes(torque, end), push)
            else:
                self.backend.step(torque, end, push, self.system.substeps, self._running())
            if self.base_actuators is not None:
                self.base_actuators.advanced(self.system.substeps)
        if self.payload is not None:
            self.payload.advance(self.system.control_dt, self._running())
        self._watch()
        self.last_state = self.state
        return self.last_state

    def _nodes(self, command: Array, end: Array | None) -> Array:
        """(n, k + 1, joints) at the physics steps of a period, held or linear to `end`."""
        nodes = np.repeat(command[:, None], self.system.substeps + 1, axis=1)
        if end is not None:
            share = np.arange(self.system.substeps + 1) / self.system.substeps
            nodes += (end - command)[:, None] * share[:, None]
        return nodes

    def servo_command(self, q: Array, v: Array, tau: Array | float = 0.0) -> Array:
        """Return the command that makes the servo track a motion.

        Args:
            q, v: (n, ..., joints) angles [rad] and rates [rad/s].
            tau: feed-forward torque [N m].

        Returns:
            (n, ..., joints) [N m].
        """
        middle = (slice(None), *(None,) * (np.ndim(q) - 2))
        command: Array = self._kp[middle] * q + self._kd[middle] * v + tau
        return command

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
        self.last_state = self.state
        if self.emulation_loop is not None:
            periods, remainder = divmod(nodes.shape[1] - 1, self.system.substeps)
            if remainder:
                raise ParameterError(
                    f"in mode emulated commands must cover whole control periods of"
                    f" {self.system.substeps} physics steps, got {nodes.shape[1] - 1} steps"
                )
            self._ride(nodes, self._platform(platform, periods))
        elif self._charts is None:
            self._play(nodes)
        else:  # looked at every control period, as in `step`
            first, last, acts = 0, nodes.shape[1] - 1, self.base_actuators
            while first < last:
                steps = min(self.system.substeps, last - first)
                if acts is None or acts.due:
                    self._recentre()
                if acts is not None:
                    steps = min(acts.steps_left, last - first)
                    if acts.due:
                        acts.prepare(self.state, self.wheel_speed, self.backend)
                    acts.advanced(steps)
                self._play(nodes[:, first : first + steps + 1])
                first += steps
        self._watch()

    def _play(self, nodes: Array) -> None:
        """In space, through commands linear over each step."""
        if self.joint_delays is not None and self.joint_delays.busy:
            self._drive(nodes, None)
        else:
            self.backend.step_sequence(nodes, self._running())
        if self.payload is not None:
            time = (nodes.shape[1] - 1) * self.system.physics_dt
            self.payload.advance(time, self._running())

    def _drive(self, nodes: Array, push: Array | None) -> None:
        """In space, with delays between joint controller and drives."""
        assert self.joint_delays is not None
        gains = self._kp, self._kd
        self.joint_delays.drive(self.backend, nodes, push, self._running(), *gains)

    def _recentre(self) -> None:
        """Keep the engine's angles of free bodies away from where they end."""
        if self._charts is not None:
            moved = self._charts.recentre(self.backend, np.flatnonzero(self.diverged))
            if self.touch is not None and len(moved):
                self.touch.framed(moved)
                if self.payload is not None:
                    self.payload.reframed(moved)

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
        return self._seen(state.q, state.v)

    def _seen(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Angles and rates (n, joints) as measured, where delays are between."""
        return (q, v) if self.joint_delays is None else self.joint_delays.measured(q, v)

    def _ride(self, nodes: Array, platform: Array | None) -> None:
        """Control period by control period: laboratory -> engine -> laboratory."""
        lab, k = self.emulation_loop, self.system.substeps
        assert lab is not None
        ids = self._running()
        for i in range((nodes.shape[1] - 1) // k):
            _, z, zd = self.backend.read()
            angles, _ = self._seen(z[:, 6:], zd[:, 6:])
            prescribed = None if platform is None else (platform[:, i, :6], platform[:, i, 6:])
            gains = self._kp, self._kd
            base = lab.command(angles, *gains, z[:, :6], zd[:, :6], prescribed)
            sent = nodes[:, i * k : (i + 1) * k + 1]
            if self.joint_delays is not None and self.joint_delays.busy:
                wrench = self.joint_delays.on_platform(self.backend, sent, base, ids, *gains)
            else:
                wrench = self.backend.step_on_platform(sent, base, ids)
            _, z, zd = self.backend.read()
            lab.sense(wrench, self._seen(z[:, 6:], zd[:, 6:])[0])

    def _platform(self, platform: npt.ArrayLike | None, periods: int) -> Array | None:
        assert self.emulation_loop is not None
        operation = self.emulation_loop.spec.operation
        if platform is None:
            return None
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

    @property
    def readings(self) -> Readings:
        """Mode emulated: what force sensor, gravity estimate and platform report now."""
        if self.emulation_loop is None:
            raise ParameterError("readings need mode emulated, got mode ideal")
        return self.emulation_loop.readings

    @property
    def events(self) -> list[Event]:
        """Safety stops since the resets: platforms that froze, when and why."""
        return [] if self.emulation_loop is None else list(self.emulation_loop.events)

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
        if self.emulation_loop is None:
            raise ParameterError("zero_sensor needs mode emulated, got mode ideal")
        self.emulation_loop.zero(simulation_ids(ids, self.n))

    def freeze(self, ids: npt.ArrayLike | None = None) -> None:
        """Press the platforms' panic buttons: they stand until reset (thesis App. E rule 1)."""
        if self.emulation_loop is None:
            raise ParameterError("freeze needs mode emulated, got mode ideal")
        self.emulation_loop.freeze(simulation_ids(ids, self.n), "panic button")

    def evaluate(self, command: npt.ArrayLike) -> tuple[Array, Array]:
        """Drive torque (n, joints) [N m] and base acceleration Y'' (n, 6) at this state.

        The torque is what the drives are told by what has arrived there, the acceleration
        what there really is.
        """
        at_drives = broadcast(command, "command", (self.n, self.joints))
        friction: Array | float = 0.0
        if self.joint_delays is not None and self.joint_delays.busy:
            at_drives = self.joint_delays.arrived(at_drives)
            if self.joint_delays.measurements_late:
                q, v = self.state.q, self.state.v
                at_drives = (
                    at_drives + self.joint_delays.correction(q, v, self._kp, self._kd)[0]
                )
            if self.joint_delays.rubs:
                friction = self.joint_delays.friction
        if self.base_actuators is not None and self.base_actuators.due:
            self.base_actuators.look(self.state, self.wheel_speed, self.backend)
        torque, acceleration = self.backend.evaluate(at_drives + friction)
        torque = torque - friction
        ydd = acceleration[:, :6]
        if self._charts is not None:
            _, z, zd = self.backend.read()
            ydd = self._charts.acceleration(z[:, :6], zd[:, :6], ydd)
        return torque, ydd

    # ----------------------------------------------------------------- helpers

    def _running(self) -> Index | None:
        return np.flatnonzero(~self.diverged) if self.diverged.any() else None

    def _watch(self) -> None:
        new = self.backend.faults()
        if self.system.base.body is not None:
            new |= tumbled(self.system, self.backend)
        if not new.any():
            return
        new &= ~self.diverged
        if not new.any():
            return
        self.diverged |= new
        if self.on_divergence == "raise":
            raise Divergence(
                self.describe_divergence(int(np.flatnonzero(new)[0])), np.flatnonzero(new)
            )

    def describe_divergence(self, i: int) -> str:
        """One line naming simulation, time and the worst coordinate while it was finite."""
        return describe(i, self.system, self.backend, self.last_state)

    def _base_force(
        self, wrench: npt.ArrayLike | None, torque: npt.ArrayLike | None
    ) -> Array | None:
        """Tell jets and wheels; the jets' force on Y where the engine has none that turn."""
        acts, jets, motors = self.base_actuators, None, None
        kind = type(self.system.vehicle).__name__
        if wrench is not None:
            if not has_jets(self.system.vehicle):
                raise ParameterError(
                    f"base_wrench needs a vehicle with thrusters or jets, got {kind}"
                )
            jets = broadcast(wrench, "base_wrench", (self.n, 6))
        if torque is not None:
            if acts is None or not acts.wheels:
                raise ParameterError(
                    f"wheel_torque needs a vehicle with reaction wheels, got {kind}"
                )
            motors = broadcast(torque, "wheel_torque", (self.n, len(acts.wheels)))
        if acts is not None:
            if jets is not None or motors is not None:
                acts.command(jets, motors, self.wheel_speed, self.backend)
            elif acts.due:
                acts.prepare(self.state, self.wheel_speed, self.backend)
            return None
        if jets is None:
            return None
        return matvec(np.swapaxes(rate_matrix(self.state.y), -1, -2), jets)
