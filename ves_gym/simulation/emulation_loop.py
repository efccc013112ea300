"""The laboratory at work: reading -> admittance -> platform, n times, once per period.

`EmulationLoop` is the tick loop of thesis 2.4.2 (Figure 2-8): a list of blocks and the wires
between them, vectorised over simulations. It never touches the engine: `Simulator` carries its
commands there and the wrench back.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from typing import Any, NamedTuple

import numpy as np

from ves_gym._util.array_functions import NUMPY
from ves_gym._util.params import Array, Index, Mask, ParameterError, Rows
from ves_gym.engine.batch_parameters import Bodies, ParameterRows, bodies_of
from ves_gym.engine.kernel.maps import WeightMap
from ves_gym.hardware.admittance import Nonlinear, admittance_matrices
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.base_model import BaseModel
from ves_gym.simulation.blocks.block import Noted
from ves_gym.simulation.blocks.compiled_loop import CompiledLoop
from ves_gym.simulation.blocks.memory import NamedArrays
from ves_gym.simulation.blocks.payload_compensation import ArmInertia
from ves_gym.simulation.blocks.platform import Safety
from ves_gym.simulation.loop_wiring import LoopParts, Needs
from ves_gym.system.deviations import LoopParameters
from ves_gym.system.effect import BaseEffect
from ves_gym.system.system import System

_BODIES = {field.name for field in fields(Bodies)}


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


class EmulationLoop:
    """n emulators at work on one system.

    Args:
        system: an emulated one.
        n: simulations.
        generators: of their random numbers.
        admittance: g(X, W) in place of the system's vehicle.
        compiled: run the blocks as compiled code where they can be traced.
    """

    def __init__(
        self,
        system: System,
        n: int,
        generators: list[np.random.Generator],
        admittance: Nonlinear | None = None,
        *,
        compiled: bool = False,
    ) -> None:
        emulator, arm = system.emulator_settings, system.arm
        self.system, self.n, self.spec = system, n, emulator
        self.generators, self.custom = generators, admittance
        self.parameters = LoopParameters.nominal(arm, emulator, n).edited(system)
        self.dt = system.control_dt
        _require_vehicle(system, admittance)
        self.compensating = emulator.payload_compensation and emulator.operation != "position"
        base = system.actual.base  # the arm's model, in what follows, is the description
        self._linear = base.body is None and admittance is None
        self._sampled = self._linear and not self.compensating  # a coupled one is not
        self._arm = system.replace(effects=())  # what the compensation goes by
        self._names = ParameterRows(self._arm) if self.compensating else None
        self._inertia = ArmInertia(self._arm, n) if self.compensating else None
        self._weights = WeightMap(system.actual.arm)
        self._bodies = self._row(system, "own system").repeated(n)
        self._systems = [system] * n
        self._own_bases: set[int] = set()  # simulations with another than their system's
        self._start: LoopParameters | None = (
            None  # one row before effects, of the last arm asked
        )
        self._noisy = self.parameters.sensor.random()
        self._compiled = compiled
        self.table: Array | None = None  # (n, m, 6): replaces the estimate, row by row
        self.events: list[Event] = []
        self.time = np.zeros(n)  # s since the reset
        self._needs = self._asked()
        self._build()
        self._load()

    # ------------------------------------------------------------------ wiring

    def _build(self) -> None:
        """Wire the blocks; what they remember goes on under its name."""
        parts = LoopParts(self.system, self._needs, self._inertia, self.custom)
        self.shape, self.wiring = parts.shape, parts.wiring
        self.platform, self.sensor, self.estimate = parts.platform, parts.sensor, parts.estimate
        earlier = getattr(self, "memory", None)
        names = getattr(self, "_carried", ())
        self._carried = self.wiring.carried(self.shape)
        self._code: CompiledLoop | None = None
        if self._compiled and all(block.compiles for block in self.wiring.blocks):
            self.memory = NamedArrays(self.wiring.everything(self.shape), self.n, lanes=True)
            self._code = CompiledLoop(self.wiring, self.memory)
        else:
            self.memory = NamedArrays(self._carried, self.n, lanes=False)
        if earlier is not None:
            self._remember(earlier.copied(names))

    def _asked(self) -> Needs:
        """What parameters and table ask of the blocks."""
        return Needs.of(
            self.parameters,
            self.dt,
            compensating=self.compensating,
            tabulated=self.table is not None,
        )

    def _remember(self, earlier: Mapping[str, Array]) -> None:
        """Carry memory over from a wiring with other arrays, or shorter or longer ones."""
        for name, shape in self._carried.items():
            if name.startswith("platform_model.") and name not in earlier:
                value = earlier[name.replace("platform_model", "platform")]
            elif name in earlier:
                value = earlier[name]
            else:
                continue
            if value.shape[1:] != shape:  # another length of the past
                missing = max(0, shape[0] - value.shape[1])  # as the oldest that is known
                oldest = value[:, -1:] if value.shape[1] else earlier["command_sent"][:, None]
                value = np.concatenate([value, np.repeat(oldest, missing, axis=1)], axis=1)
                value = value[:, : shape[0]]
            self.memory[name] = value

    def _load(self) -> None:
        """Take the parameters of all simulations to the blocks."""
        self.p: dict[str, dict[str, Array]] = {}
        self._sources: dict[str, set[str]] = {}  # block -> what its parameters follow from
        for block in self.wiring.blocks:
            sources = self._sources[block.name] = set()
            noted: Any = [Noted(k, sources) for k in (self.parameters, self._bodies)]
            values = block.parameters(*noted)
            # of its own, in plain order: products of stacks round by the layout of memory
            self.p[block.name] = {k: np.array(v, order="C") for k, v in values.items()}
        if self._code is not None:
            self._code.load(self.p)

    # ------------------------------------------------------------- assignment

    def _row(self, system: System, which: str) -> Bodies:
        """Arm and vehicle of a system as one row."""
        numbers = np.empty(0)
        if self._names is not None and system.arm is self.system.arm:
            numbers = self._names.values  # those of the arm: a vehicle is the loop's alone
        elif self._names is not None:
            numbers = self._names.of(system.replace(effects=()), which)
        return Bodies.of(system, self._linear, self._sampled, numbers)

    def prepare(self, ids: Index, systems: Sequence[System]) -> Callable[[], None]:
        """Check systems of their own for some simulations; the result installs them.

        Memory stays: until the next reset it is that of the system before.

        Args:
            ids: (k,) which.
            systems: k of them.
        """
        pairs = list(zip(ids.tolist(), systems, strict=True))
        p = LoopParameters.stacked([self._parameters_of(system) for system in systems])
        others = [
            (i, k)
            for i, k in pairs
            if i in self._own_bases or _all_bodies(k) != _all_bodies(self._systems[i])
        ]
        if self.custom is not None and any(
            k.vehicle is not self.system.vehicle for _, k in pairs
        ):
            raise ParameterError(
                "an `admittance` takes the place of every simulation's vehicle: assign systems"
                " with the vehicle of the simulator's own"
            )
        rows_of: dict[tuple[int, ...], Bodies] = {}  # a row of each arm and vehicle seen
        for i, k in others:
            if _all_bodies(k) not in rows_of:
                rows_of[_all_bodies(k)] = self._row(k, f"system of simulation {i}")

        def install() -> None:
            for i, system in others:
                self._bodies.put(i, rows_of[_all_bodies(system)])
                if self._inertia is not None:
                    self._inertia.tell_apart().arms[i] = system.arm
            for i, system in pairs:
                self._systems[i] = system
                self._own_bases.discard(i)
            self._derive(self._rows(ids), self._put(ids, p) | (_BODIES if others else set()))

        return install

    def _parameters_of(self, system: System) -> LoopParameters:
        """One row."""
        return self.described(system.arm).copy().edited(system)

    def described(self, arm: Arm) -> LoopParameters:
        """Return a row of parameters before any effect.

        Args:
            arm: the arm.
        """
        if self._start is None or self._start.arm is not arm:
            self._start = LoopParameters.nominal(arm, self.spec, 1)
        return self._start

    def install(
        self, ids: Index, p: LoopParameters | None, bases: BaseModel | None = None
    ) -> None:
        """Put parameters in place, with all that follows from them; memory stays.

        Args:
            ids: (m,) which simulations.
            p: of m simulations; None: as they are.
            bases: M, D, K (m, 6, 6) and drag (m, 6) of their vehicles; None: as they are.
        """
        changed = set() if p is None else self._put(ids, p)
        rows = self._rows(ids)
        if bases is not None:
            for name in ("M", "D", "K", "drag"):
                getattr(self._bodies, name)[rows] = getattr(bases, name)
            if self._sampled:
                form = self.spec.admittance_form
                for i, M, D, K in zip(ids.tolist(), bases.M, bases.D, bases.K, strict=True):
                    sampled = admittance_matrices(BaseModel(M, D, K), self.dt, form)
                    self._bodies.phi[i], self._bodies.gamma[i] = sampled
            self._own_bases.update(ids.tolist())
            changed |= _BODIES
        self._derive(rows, changed)

    def _put(self, ids: Index, p: LoopParameters) -> set[str]:
        """Replace parameters of some simulations; names of those that have changed."""
        changed = self.parameters.put(self._rows(ids), p)
        self._noisy = self.parameters.sensor.random()
        self._rewire()
        return changed

    def _derive(self, rows: Rows, changed: set[str]) -> None:
        """Bring the blocks' parameters of some simulations up to date.

        Args:
            rows: which simulations.
            changed: fields of `parameters` and bodies.
        """
        p, bodies = self.parameters.rows(rows), self._bodies.rows(rows)
        others: dict[str, list[str]] = {}
        for block in self.wiring.blocks:
            if not changed & self._sources[block.name]:
                continue
            mine = self.p[block.name]
            for name, values in block.parameters(p, bodies).items():
                if not np.array_equal(mine[name][rows], values):
                    mine[name][rows] = values
                    others.setdefault(block.name, []).append(name)
        if self._code is not None:
            self._code.change(rows, self.p, others)

    def _rewire(self) -> None:
        """Build the wiring anew where parameters need blocks or memory that it lacks."""
        needs = self._asked().joined(self._needs)
        if needs != self._needs:
            self._needs = needs
            self._build()
            self._load()

    # ------------------------------------------------------------------ state

    def reset(self, ids: Index, q: Array, y: Array, yd: Array, kp: Array, kd: Array) -> None:
        """Put platforms at a pose, moving, sensors at rest under the arm's weight.

        Args:
            ids: (m,) which.
            q: (m, joints) angles [rad].
            y, yd: (m, 6) pose [m, rad] and its rate.
            kp, kd: (m, joints) gains of the joint servo.
        """
        rows = self._rows(ids)
        u = {"q": q, "X": np.concatenate([y, yd], axis=-1), "kp": kp, "kd": kd}
        u["true_weight"] = self._true_weight(q, y, rows)
        u["start_draws"] = self._drawn(ids, 6, 2)  # start as noisy as it goes on
        if self.table is not None:
            u["table"] = self.table[rows, 0]
        if self._inertia is not None:
            u["inertia"] = self._inertia.rows(self._of(self._inertia.name, rows), q, ids)
        if self.system.actual.base.m:
            bases = [self._systems[i].actual.base for i in ids.tolist()]
            for name, part in (("attached", y), ("attached_rate", yd)):
                u[name] = np.stack([b.attached(k) for b, k in zip(bases, part, strict=True)])
        if self.events:
            begun = set(ids.tolist())
            self.events = [e for e in self.events if e.simulation not in begun]
        self.time[rows] = 0.0
        for block in self.wiring.blocks:
            x, outputs = block.start(self._of(block.name, rows), u)
            u |= outputs
            for name, values in x.items():
                self.memory.put(rows, f"{block.name}.{name}", values)
        for name in self.wiring.delayed:
            self.memory.put(rows, name, u[name])
        if self.spec.zero_at_start:
            self.zero(ids)

    def _rows(self, ids: Index) -> Rows:
        """The same simulations; all of them in order as a slice, which copies nothing."""
        everyone = len(ids) == self.n and (ids == np.arange(self.n)).all()
        return slice(None) if everyone else ids

    def _of(self, block: str, rows: Rows) -> dict[str, Array]:
        """Parameters of a block for some simulations."""
        return {name: values[rows] for name, values in self.p[block].items()}

    def _drawn(self, ids: Index, *shape: int) -> Array:
        """(m, *shape) standard normal numbers; zeros where nothing is noisy."""
        out = np.zeros((len(ids), *shape))
        for i, row, noisy in zip(ids.tolist(), out, self._noisy[ids].tolist(), strict=True):
            if noisy:  # the others draw no numbers
                self.generators[i].standard_normal(out=row)
        return out

    def get_state(self) -> Any:
        """Everything needed to continue exactly from here; picklable."""
        others = copy.deepcopy((self.time, self.events, self.table))
        return self.memory.copied(self._carried), others

    def set_state(self, state: Any) -> None:
        """Return to a state handed out by `get_state`."""
        memory, others = state
        self.time, self.events, self.table = copy.deepcopy(others)
        self._rewire()
        self._remember(memory)

    # ------------------------------------------------------------------- tick

    def command(
        self,
        q: Array,
        kp: Array,
        kd: Array,
        y_engine: Array,
        yd_engine: Array,
        platform: tuple[Array, Array] | None = None,
    ) -> Array:
        """From the present readings to what the engine's platform is given next.

        Args:
            q: (n, joints) measured joint angles [rad].
            kp, kd: (n, joints) gains of the joint servo.
            y_engine, yd_engine: (n, 6) pose and rate of the engine's platform.
            platform: pose and rate (n, 6) to follow, under position control only.

        Returns:
            (n, k + 1, 6) acceleration Y'' at the period's nodes.
        """
        external = {"q": q, "kp": kp, "kd": kd, "y_engine": y_engine, "yd_engine": yd_engine}
        if self.spec.operation == "position":
            sent = self.memory["command_sent"][:, :6]
            where = (sent, np.zeros_like(sent)) if platform is None else platform
            external["motion"] = np.concatenate(where, axis=-1)
        if self.estimate is None:
            external["weight"] = np.zeros((self.n, 6))
        before = self.frozen
        acceleration = self._run("before", external, "acceleration")
        new = self.frozen & ~before
        if new.any():
            self._report(np.flatnonzero(new), self.memory["reading"])
        return acceleration

    def _report(self, ids: Index, reading: Array) -> None:
        """Note why platforms were frozen: a stop leaves the pose as it was.

        Args:
            ids: (m,) which.
            reading: (n, 6) of the force sensor then [N, N m].
        """
        safety, memory = self.wiring.block("safety"), self.memory
        assert isinstance(safety, Safety)
        for i in ids.tolist():
            sent, command = (memory[k][i] for k in ("command_sent", "command"))
            reason = safety.reason(sent, command, reading[i])
            self.events.append(Event(i, float(self.time[i]), reason))

    def sense(self, wrench: Array, q: Array) -> None:
        """Take in one period's true wrench; read the sensors.

        Args:
            wrench: (n, k + 1, 6) at the period's nodes [N, N m].
            q: (n, joints) measured angles [rad].
        """
        self.time = self.time + self.dt
        external = {"wrench": wrench, "draws": self.draws(), "q": q}
        if self.table is not None:
            external["table"] = self.table[:, 0]
            if self.table.shape[1] > 1:
                self.table = self.table[:, 1:]
        self._run("after", external, "reading")

    def draws(self) -> Array:
        """(n, 18) standard normal numbers that the sensors take in a period."""
        return self._drawn(np.arange(self.n), 18)

    @property
    def code(self) -> CompiledLoop | None:
        """The blocks in compiled code; None where they run in NumPy."""
        return self._code

    def ran_elsewhere(self, reading: Array | None) -> None:
        """A program of its own has run both halves of a period (`CompiledLoop.piece`).

        Args:
            reading: (n, 6) of the force sensor before the period [N, N m], to tell why
                platforms are frozen of which no event tells; None: there are none.
        """
        if reading is not None:
            earlier = {event.simulation for event in self.events}
            new = [i for i in np.flatnonzero(self.frozen).tolist() if i not in earlier]
            self._report(np.array(new, np.intp), reading)
        self.time = self.time + self.dt

    def _run(self, half: str, external: dict[str, Array], output: str) -> Array:
        """Run the blocks before or after the engine, and return one of their signals."""
        if self._code is not None:
            self._code(half, external)
            return self._code.signal(output)
        blocks = self.wiring.before if half == "before" else self.wiring.after
        x = {name: self.memory[name] for name in self._carried}
        changed, out = self.wiring.run(blocks, NUMPY, self.p, x, external)
        for name, values in changed.items():
            self.memory[name] = values
        return out[output]

    def use_table(self, table: Array | None) -> None:
        """Take the weight from a table.

        Args:
            table: (n, m, 6) [N, N m], a row per reading, the last one held; None: the model.
        """
        self.table = table
        self._rewire()

    # ---------------------------------------------------------------- readings

    @property
    def readings(self) -> Readings:
        """Signals of the controller at this instant."""
        zero = np.zeros((self.n, 6))
        weight = zero if self.estimate is None else self.memory["weight"]
        sent = self.memory["command_sent"][:, :6]
        parts = (self.memory["reading"], weight, self.memory["y_measured"], sent)
        return Readings(*(np.array(k) for k in parts))

    @property
    def y_measured(self) -> Array:
        """(n, 6) pose by the sensors of the platform [m, rad]."""
        return np.array(self.memory["y_measured"])

    @property
    def frozen(self) -> Mask:
        """(n,) platforms that a safety stop holds."""
        return np.not_equal(self.memory["frozen"], 0)

    @property
    def vehicle_state(self) -> Array:
        """(n, 12) pose and rate of the emulated vehicle; at rest where a stop holds it."""
        sent = self.memory["command_sent"][:, :6]
        still = np.concatenate([sent, np.zeros_like(sent)], axis=-1)
        name = "command" if self.spec.operation == "position" else "admittance.X"
        return np.where(self.frozen[:, None], still, self.memory[name])

    @property
    def carried(self) -> tuple[Array, Array]:
        """Coordinates and rates (n, m) of the oscillators that the vehicle carries."""
        if not self.system.actual.base.m or self.spec.operation == "position":
            return np.zeros((self.n, 0)), np.zeros((self.n, 0))
        block: Any = self.wiring.block("admittance")
        at, moving = block.oscillators
        coupled = self.memory["admittance.coupled"]
        return coupled[:, at].copy(), coupled[:, moving].copy()

    def zero(self, ids: Index) -> None:
        """Set the sensors' zero from the gravity estimate (App. E step 9)."""
        wrench = np.zeros((len(ids), 6))
        if self.estimate is not None:
            wrench = self.memory["weight"][ids]
        p = self._of(self.sensor.name, ids)
        x = {k: self.memory[f"{self.sensor.name}.{k}"][ids] for k in self.sensor.memory}
        x["zero"] = self.sensor.zero_to(p, x, wrench)
        self.memory.put(ids, f"{self.sensor.name}.zero", x["zero"])
        self.memory.put(ids, "reading", self.sensor.reading(NUMPY, p, x))

    def warm_up(self) -> None:
        """Drift as it is long after the sensors were reset."""
        draws = np.stack([g.standard_normal(6) for g in self.generators])
        drift = np.where(self.parameters.sensor.drift > 0, draws, 0.0)
        self.memory[f"{self.sensor.name}.drift"] = drift

    def silence(self) -> None:
        """No more noise and drift, for good."""
        errors = self.parameters.sensor
        errors.noise[:], errors.drift[:] = 0.0, 0.0
        self._noisy = errors.random()
        self._load()

    def freeze(self, ids: Index, reason: str) -> None:
        """Stop platforms where they are commanded to be, until they are reset (App. E rule 1).

        Args:
            ids: (m,) which.
            reason: of the event.
        """
        new = ids[~self.frozen[ids]]
        self.memory.put(new, "frozen", np.ones(len(new)))
        for i in new.tolist():
            self.events.append(Event(i, float(self.time[i]), reason))

    # ---------------------------------------------------------------- helpers

    def _true_weight(self, q: Array, y: Array, rows: Rows) -> Array:
        """True static wrench (m, 6) of the arm on the platform."""
        return self._weights(q, y, self._bodies.mass[rows], self._bodies.P[rows])


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
