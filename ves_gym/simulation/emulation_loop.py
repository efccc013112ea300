"""The laboratory at work: reading -> admittance -> platform, n times, once per period.

`EmulationLoop` is the tick loop of thesis 2.4.2 (Figure 2-8): a list of blocks and the wires
between them, vectorised over simulations. It never touches the engine: `Simulator` carries its
commands there and the wrench back.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from ves_gym._util.params import Array, Index, Mask, Rows
from ves_gym.engine.kernel.build import LANES
from ves_gym.engine.kernel.compiled_function import put_rows
from ves_gym.engine.kernel.maps import weight_function
from ves_gym.hardware.admittance import Nonlinear
from ves_gym.mechanics.base_model import carried
from ves_gym.simulation.blocks.compiled_loop import CompiledLoop
from ves_gym.simulation.blocks.platform import Safety
from ves_gym.simulation.blocks.wiring import NamedArrays
from ves_gym.simulation.loop_numbers import BODIES, LoopNumbers
from ves_gym.simulation.loop_wiring import LoopParts, Needs
from ves_gym.simulation.machines import ControlPeriod, Machines, NotingPart
from ves_gym.simulation.state import Event, Readings, State
from ves_gym.system.deviations import LoopParameters
from ves_gym.system.effect import LaboratoryEffect
from ves_gym.system.effect_rows import EffectRows
from ves_gym.system.emulator_settings import require_carried
from ves_gym.system.system import System

_AHEAD = 16  # periods whose noise a generator draws at once: a call costs as much as 18 numbers


class EmulationLoop(NotingPart):
    """n emulators at work on one system.

    Args:
        system: an emulated one.
        n: simulations.
        generators: of their random numbers.
        admittance: g(X, W) in place of the system's vehicle.
        compiled: run the blocks as compiled code where they can be traced.
    """

    name = "emulation_loop"
    arrays = ("time", "noise", "next_noise", "history")

    def __init__(
        self,
        system: System,
        n: int,
        generators: list[np.random.Generator],
        admittance: Nonlinear | None = None,
        *,
        compiled: bool = False,
    ) -> None:
        emulator = system.emulator_settings
        require_carried(emulator, system.arm)
        self.system, self.n, self.spec = system, n, emulator
        self.generators, self.custom = generators, admittance
        self.dt = system.control_dt
        self.compensating = emulator.payload_compensation and emulator.operation != "position"
        self.numbers = LoopNumbers(
            system, n, given=admittance is not None, compensating=self.compensating
        )
        self._weights = weight_function(system.actual.arm)
        self._compiled = compiled
        self.table: Array | None = None  # (n, m, 6): replaces the estimate, row by row
        self.history = np.full(n, None)  # of safety stops
        self.forget(np.arange(n))
        self.time = np.zeros(n)  # s since the reset
        self.noise = np.zeros((n, _AHEAD, 18))  # of the coming periods
        self.next_noise = np.full(n, _AHEAD)  # place in it; beyond: none is drawn
        self._needs = self._needed()
        self._build()
        self._load()

    # ------------------------------------------------------------------ wiring

    def _build(self) -> None:
        """Wire the blocks; what they remember goes on under its name."""
        parts = LoopParts(self.system, self._needs, self.numbers.inertia, self.custom)
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
            self.memory.take_over(earlier.copied(names), self._carried)

    def _needed(self) -> Needs:
        """Requirements of parameters and table on the blocks."""
        return Needs.of(self.parameters, self.dt, self.compensating, self.table is not None)

    def _load(self) -> None:
        """Take the parameters of all simulations to the blocks."""
        self.numbers.load(self.wiring.blocks)
        if self._code is not None:
            self._code.load(self.p)

    # ------------------------------------------------------------- assignment

    @property
    def parameters(self) -> LoopParameters:
        """Numbers of the loop that effects add to, a row per simulation."""
        return self.numbers.parameters

    @property
    def p(self) -> dict[str, dict[str, Array]]:
        """Parameters of every block, by name, a row per simulation."""
        return self.numbers.p

    def prepare(
        self, machines: Machines, ids: Index, systems: Sequence[System]
    ) -> Callable[[], None]:
        """See `Part`. Until the next reset the memory is that of the system before."""
        assignment = self.numbers.assignment(ids, systems)

        def install() -> None:
            self.numbers.assign(assignment)
            bodies = BODIES if assignment.bodies else set()
            self._derive(self._rows(ids), self._put(ids, assignment.parameters) | bodies)

        return install

    def prepare_effects(
        self, machines: Machines, ids: Index, rows: EffectRows
    ) -> Callable[[], None]:
        """See `Part`. Memory stays."""
        if not rows.varied(LaboratoryEffect):
            return super().prepare_effects(machines, ids, rows)
        p = rows.loop_parameters(rows.before(self.numbers.described(self.system.arm)))
        return lambda: self._derive(self._rows(ids), self._put(ids, p))

    def _put(self, ids: Index, p: LoopParameters) -> set[str]:
        """Replace parameters of some simulations; names of those that have changed."""
        changed = self.numbers.put(self._rows(ids), p)
        self._rewire()
        return changed

    def _derive(self, rows: Rows, changed: set[str]) -> None:
        """Bring blocks' parameters up to date with the fields of numbers that have changed."""
        others = self.numbers.derive(self.wiring.blocks, rows, changed)
        if self._code is not None:
            self._code.change(rows, self.p, others)

    def _rewire(self) -> None:
        """Build the wiring anew where parameters need blocks or memory that it lacks."""
        needs = self._needed().joined(self._needs)
        if needs != self._needs:
            self._needs = needs
            self._build()
            self._load()

    # ------------------------------------------------------------------ state

    def reset(self, machines: Machines, ids: Index, start: State) -> None:
        """See `Part`. Platforms stand or move; sensors rest under the arm's weight."""
        q, y, yd, kp, kd = start.q, start.y, start.yd, machines.kp[ids], machines.kd[ids]
        rows = self._rows(ids)
        u = {"q": q, "X": np.concatenate([y, yd], axis=-1), "kp": kp, "kd": kd}
        bodies = self.numbers.bodies
        u["true_weight"] = self._weights(q, y, bodies.mass[rows, None], bodies.P[rows])
        u["start_draws"] = self._drawn(ids, 6, 2)  # start as noisy as it goes on
        if self.table is not None:
            u["table"] = self.table[rows, 0]
        if self.numbers.inertia is not None:
            inertia = self.numbers.inertia
            u["inertia"] = inertia.rows(self._of(inertia.name, rows), q)
        if self.system.actual.base.m:
            systems = [self.numbers.systems[i] for i in ids.tolist()]
            distinct = {id(system): system for system in systems}
            couplings = {key: system.actual.base.coupling for key, system in distinct.items()}
            coupling = np.stack([couplings[id(system)] for system in systems])
            u |= {"attached": carried(coupling, y), "attached_rate": carried(coupling, yd)}
        self.forget(ids)
        self.time[rows], self.next_noise[rows] = 0.0, _AHEAD
        for block in self.wiring.blocks:
            x, outputs = block.start(self._of(block.name, rows), u)
            u |= outputs
            for name, values in x.items():
                self.memory.put(rows, f"{block.name}.{name}", values)
        for name in self.wiring.delayed:
            self.memory.put(rows, name, u[name])
        if self.spec.zero_at_start:
            self.zero(ids)

    def rows_of(self, ids: Index) -> dict[str, Array]:
        assert self._code is not None
        block, lane = ids // LANES, ids % LANES
        compiled = self._code.lanes[block, :, lane], self._code.parameters[block, :, lane]
        return dict(zip(("memory", "p"), compiled, strict=True)) | self.numbers.rows_of(ids)

    def begin_with(self, ids: Index, rows: Mapping[str, Array]) -> None:
        assert self._code is not None
        put_rows(self._code.lanes, ids, rows["memory"])
        put_rows(self._code.parameters, ids, rows["p"])
        self.numbers.put_rows(ids, rows)
        self.forget(ids)
        self.time[ids], self.next_noise[ids] = 0.0, _AHEAD

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
        for i, row, noisy in zip(
            ids.tolist(), out, self.numbers.noisy[ids].tolist(), strict=True
        ):
            if noisy:  # the others draw no numbers
                self.generators[i].standard_normal(out=row)
        return out

    def get_state(self) -> dict[str, Array]:
        table = {} if self.table is None else {"table": self.table.copy()}
        return super().get_state() | self.memory.copied(self._carried) | table

    def set_state(self, state: Mapping[str, Array]) -> None:
        super().set_state(state)
        self.use_table(state.get("table"))
        self.memory.take_over(state, self._carried)

    # ------------------------------------------------------------------- tick

    def before(self, machines: Machines, period: ControlPeriod) -> None:
        """From the present readings to what the engine's platform is given next."""
        _, z, zd = machines.backend.read()
        external = {
            "q": machines.measured_of(z[:, 6:], zd[:, 6:])[0],
            "kp": machines.kp,
            "kd": machines.kd,
            "y_engine": z[:, :6],
            "yd_engine": zd[:, :6],
        }
        if self.spec.operation == "position":
            sent = self.memory["command_sent"][:, :6]
            still = np.concatenate([sent, np.zeros_like(sent)], axis=-1)
            external["motion"] = still if period.platform is None else period.platform
        if self.estimate is None:
            external["weight"] = np.zeros((self.n, 6))
        before = self.frozen
        period.acceleration = self._run("before", external, "acceleration")
        new = self.frozen & ~before
        if new.any():
            self._report(np.flatnonzero(new), self.memory["reading"])

    def after(self, machines: Machines, period: ControlPeriod) -> None:
        """Take in the period's true wrench; read the sensors."""
        assert period.wrench is not None
        _, z, zd = machines.backend.read()
        self.time = self.time + self.dt
        q = machines.measured_of(z[:, 6:], zd[:, 6:])[0]
        external = {"wrench": period.wrench, "draws": self.draws(), "q": q}
        if self.table is not None:
            external["table"] = self.table[:, 0]
            if self.table.shape[1] > 1:
                self.table = self.table[:, 1:]
        self._run("after", external, "reading")

    def _report(self, ids: Index, reading: Array) -> None:
        """Note why platforms `ids` were frozen, at readings (n, 6): a stop leaves the pose."""
        safety, memory = self.wiring.block("safety"), self.memory
        assert isinstance(safety, Safety)
        for i in ids.tolist():
            sent, command = (memory[k][i] for k in ("command_sent", "command"))
            reason = safety.reason(sent, command, reading[i])
            self.note(Event(i, float(self.time[i]), reason))

    def draws(self) -> Array:
        """(n, 18) standard normal numbers that the sensors take in a period."""
        spent = np.flatnonzero(self.next_noise == _AHEAD)
        if len(spent):
            self.noise[spent], self.next_noise[spent] = self._drawn(spent, _AHEAD, 18), 0
        out: Array = self.noise[np.arange(self.n), self.next_noise]
        self.next_noise += 1
        return out

    @property
    def code(self) -> CompiledLoop | None:
        """The blocks in compiled code; None where they run in NumPy."""
        return self._code

    def ran_elsewhere(self, reading: Array | None) -> None:
        """A program of its own has run both halves of a period (`CompiledLoop.piece`).

        Args:
            reading: (n, 6) of the force sensor before the period [N, N m], to tell why
                platforms are frozen without an event; None: there are none.
        """
        if reading is not None:
            new = [i for i in np.flatnonzero(self.frozen).tolist() if not self.history[i]]
            self._report(np.array(new, np.intp), reading)
        self.time = self.time + self.dt

    def _run(self, half: str, external: dict[str, Array], output: str) -> Array:
        """Run the blocks before or after the engine, and return one of their signals."""
        if self._code is not None:
            self._code(half, external)
            return self._code.signal(output)
        blocks = self.wiring.before if half == "before" else self.wiring.after
        x = {name: self.memory[name] for name in self._carried}
        changed, out = self.wiring.run(blocks, self.p, x, external)
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
        self.memory.put(ids, "reading", self.sensor.reading(p, x))

    def warm_up(self) -> None:
        """Drift as it is long after the sensors were reset."""
        draws = np.stack([g.standard_normal(6) for g in self.generators])
        drift = np.where(self.parameters.sensor.drift > 0, draws, 0.0)
        self.memory[f"{self.sensor.name}.drift"] = drift

    def silence(self) -> None:
        """No more noise and drift, for good."""
        self.numbers.silence()
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
            self.note(Event(i, float(self.time[i]), reason))
