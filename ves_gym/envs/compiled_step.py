"""A control period in compiled code: what `Batch` does in NumPy, to rounding.

An emulated period is one program too: the loop's compiled halves around the engine.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, Index, Mask
from ves_gym.engine.backends.kernel import KernelBackend
from ves_gym.engine.kernel.build import LANES
from ves_gym.engine.kernel.compiled_function import (
    Piece,
    Program,
    aligned,
    everywhere,
    fill,
    numbers,
    unlane,
)
from ves_gym.engine.kernel.maps import scene_function, torque_function
from ves_gym.engine.kernel.numbers import parameters
from ves_gym.envs import compiled
from ves_gym.envs.compiled import WIDEST, Shape, carry_rows, compiles, layout, width
from ves_gym.envs.episode import Episodes, ended_energies, judge
from ves_gym.envs.tail import FreeDecay
from ves_gym.envs.task import Scene, Task
from ves_gym.mechanics.latch import BODY, NUMBERS
from ves_gym.simulation.capture import flight
from ves_gym.simulation.simulator import Simulator

# what is known here of the signals that come from outside the emulation loop
_BEFORE = ("q", "kp", "kd", "y_engine", "yd_engine", "weight")
_AFTER = ("wrench", "draws", "q")


def signals_of(sim: Simulator) -> tuple[tuple[str, ...], tuple[str, ...]] | None:
    """Signals that the loop's halves read; None where they cannot be part of a program."""
    loop = sim.emulation_loop
    if loop is None or loop.code is None:
        return None
    external = set(loop.wiring.external)
    if not external <= {*_BEFORE, *_AFTER} or "admittance.X" not in loop.memory:
        return None
    first, second = (tuple(k for k in names if k in external) for names in (_BEFORE, _AFTER))
    return first, second


def release_still(sim: Simulator, ids: Index) -> None:
    """Open latches where something else holds the payloads from then on (`Task.opens`)."""
    assert sim.payload is not None
    sim.release(ids)
    still = np.zeros((len(ids), 3))
    sim.payload.change(ids, velocity=still, spin=still)


class CompiledStep:
    """The rows of n simulations' episodes, and the programs that bring them on by a period.

    Args:
        sim: whose engine it steps.
        task: what the episodes ask.
        s: of its simulations, for the widths of its parts.

    Raises:
        FormulaError: task or control say that they are formulas, and are not.
    """

    observation: npt.NDArray[np.float32]  # (n, observations) after the last period
    stopped: Mask | None = None  # (n,) platforms that stand still for good, in the laboratory
    ahead = False  # the rows are later than scene and episodes
    _tailed: tuple[Index, Index] | None = None  # where energies after an end stand in the rows
    _made_of: tuple[object, object] = (None, None)  # code of the loop, and its version

    @classmethod
    def possible(cls, sim: Simulator, task: Task) -> bool:
        """True if a period is a program: formulas, the kernel, nothing acts from Python."""
        acts = sim.base_actuators is not None and task.base_control is None
        acts = acts or sim.joint_delays is not None or sim.gravity_gradient is not None
        floats = isinstance(sim.backend, KernelBackend) and sim.backend.floating
        acts = acts or (bool(floats) and not task.interacts)  # its payload is told in Python
        traced = sim.emulation_loop is None or signals_of(sim) is not None
        return traced and not acts and isinstance(sim.backend, KernelBackend) and compiles(task)

    def __init__(self, sim: Simulator, task: Task, s: Scene) -> None:
        self.sim, self.task, self.system, self.n = sim, task, sim.system, sim.n
        backend, system = sim.backend, sim.system
        assert isinstance(backend, KernelBackend)
        self.backend, self._emulated = backend, system.mode == "emulated"
        goal = s.goal.shape[1] if s.goal.shape[1] <= WIDEST else 0
        terms, probe = self._probe(s)
        sizes = backend.coordinates, goal, s.table_values.shape[1]
        self.shape = shape = Shape(task, system, *sizes, terms, signals_of(sim))
        self._functions = functions = compiled.functions(shape, probe)
        blocks, n, m = backend.blocks, shape.joints, system.base.hidden
        space = system.ideal()  # effects have no part in it
        described = everywhere(parameters(space)[1])
        at, outputs = shape.reference, shape.outputs
        rows = lambda k: aligned(blocks, k, LANES)  # noqa: E731
        self._carry, self._ahead = rows(width(shape.carry)), rows(width(shape.carry))
        self._action, self._reference = rows(task.action_width), rows(width(at))
        self._goal, self._inputs = rows(goal), rows(width(shape.inputs))
        self._outputs, tau, extra = rows(width(outputs)), rows(n), rows(n)
        self._scene_rows, self._modes = rows(width(shape.scene)), rows(2 * m)
        self._commands = rows(shape.nodes * (6 + n))
        self._waiting = False  # a simulation is marked as over
        self._stopped = np.flatnonzero(sim.diverged)  # these stay where they are
        self._flags = slice(outputs["last"].start, width(outputs))
        self._observed, self._reward = outputs["observation"], outputs["reward"].start
        self._terms = [(f"reward/{name}", outputs[f"reward/{name}"].start) for name in terms]
        self._clipped = shape.carry["clipped"].start
        self._alone = blocks == 1
        x, z, zd = backend.rows_of_state()
        before = self._carry[:, shape.carry["tau"]]
        gains = backend.rows_of_gains() if task.control.level == "gains" else rows(2 * n)
        measured = self._inputs[:, shape.inputs["y_seen"]] if self._emulated else z[:, :6]
        moved = z, zd, self._carry, self._goal, self._action, self._reference
        first = [
            functions["keep"].piece(self._ahead, self._carry),
            functions["move"].piece(*moved),
        ]
        if shape.feedforward:
            motion = self._reference[:, at["ref"]]
            first.append(torque_function(space).piece(motion, described, extra))
        followed = before, self._reference, extra, self._commands, tau, gains
        first.append(functions["follow"].piece(*followed))
        self._acts = sim.base_actuators
        if self._acts is not None:
            self._acting = rows(width(shape.actuators))
            used = self._scene_rows[:, shape.scene["propellant"]]
            acting = self._action, x, self._acting, self._acting, used
            first.append(functions["actuate"].piece(*acting, *backend.rows_of_actuators()))
        # columns of the engine's state that are the base's internal modes, and their rates
        hidden = 6 + n + len(system.actual.arm.geared) + system.actual.arm.bends
        second = backend.coordinates + hidden
        self.modes = (slice(hidden, hidden + m), slice(second, second + m)) if m else None
        modes = [self._modes[:, :m], self._modes[:, m:]] if m else []
        if m and not self._emulated:  # effects add theirs after the base's own
            modes = [part[:, :m] for part in backend.rows_of_modes()]
        closed = z, zd, x, self._carry, self._reference, tau, self._goal, self._inputs
        inputs = z, zd, measured, *modes, described, self._scene_rows[:, :8]
        last = [scene_function(space).piece(*inputs)]
        self._cargo = sim.payload if task.interacts else None
        self._flight = rows(0)  # steps of free flight in a period
        if sim.contact is not None:
            touch = x, backend.rows_of_parameters(), self._scene_rows[:, shape.scene["contact"]]
            last.append(sim.contact.engine.function.piece(*touch))
        if self._cargo is not None:
            self._bodies, self._numbers = (rows(sum(k.values())) for k in (BODY, NUMBERS))
            payload = self._scene_rows[:, shape.scene["payload"]]
            if backend.floating:
                k = layout(*NUMBERS.items())
                cargo = self._numbers[:, k["com"]], self._numbers[:, k["carried"]], self._bodies
                moved = *backend.rows_of_payload(), *cargo, self._bodies
                last.append(functions["afloat"].piece(*moved))
            inputs = x, self._bodies, self._numbers, payload
            last.append(functions["target"].piece(*inputs))
        last.append(
            functions["close"].piece(*closed, self._scene_rows, self._outputs, self._ahead)
        )
        self._first, self._last, self._after = first, last, Program(last)
        if not self._emulated:
            return
        count = system.substeps + 1
        self._nodes = rows(count * (6 + n))
        self._wrenches, self._draws = rows(count * backend.outputs), rows(18)
        self._lost, self._reading = rows(1), rows(6)  # 1: has diverged

    @property
    def fits(self) -> bool:
        """The loop is still wired as the program has it."""
        return not self._emulated or signals_of(self.sim) == self.shape.signals

    def _programs(self) -> list[Program]:
        """Programs of a period, built anew when the loop's code or memory are others.

        In space, when payloads fly more steps than before.
        """
        loop, functions, backend = self.sim.emulation_loop, self._functions, self.backend
        if loop is None:
            if self._made_of[0] is not self._flight:
                self._made_of = self._flight, None
                pieces = backend.pieces(self._commands, self.shape.nodes, self.system.substeps)
                others = self._last
                if self._cargo is not None:
                    columns = layout(*NUMBERS.items())
                    com, inertia = (self._numbers[:, columns[k]] for k in ("com", "inertia"))
                    others = [*flight(self._bodies, com, inertia, self._flight), *others]
                self._period = [Program([*self._first, k, *others]) for k in pieces]
            return self._period
        code = loop.code
        assert code is not None
        if code is self._made_of[0] and code.version is self._made_of[1]:
            return self._period
        self._made_of = code, code.version
        shape, inputs, substeps = self.shape, self.shape.inputs, self.system.substeps
        assert shape.signals is not None
        _, z, zd = backend.rows_of_state()
        first, second = ([code.rows(k) for k in names] for names in shape.signals)
        observed = self._inputs[:, inputs["y_seen"].start : inputs["stopped"].stop]
        before = [
            *self._first,
            functions["lab_before"].piece(z, zd, backend.rows_of_gains(), *first),
            *code.pieces("before"),
            functions["lab_nodes"].piece(
                code.rows("acceleration"), self._commands, self._nodes
            ),
        ]
        read = self._wrenches, z, self._draws, code.rows("reading")
        at = [code.rows(k) for k in ("y_measured", "admittance.X", "frozen")]
        after = [
            functions["lab_after"].piece(*read, *second, self._reading),
            *code.pieces("after"),
            functions["lab_seen"].piece(*at, self._lost, observed),
            *self._modes_piece(),
            *self._last,
        ]
        physics = backend.pieces(self._nodes, substeps + 1, substeps, self._wrenches)
        self._period = [Program([*before, piece, *after]) for piece in physics]
        return self._period

    def _modes_piece(self) -> list[Piece]:
        """Return what sets the base's internal modes on the platform, if it has any."""
        loop, m = self.sim.emulation_loop, self.system.base.m
        if not m:
            return []
        assert loop is not None and loop.code is not None
        block: Any = loop.wiring.block("admittance")
        coupled = loop.code.rows("admittance.coupled")
        pair = [coupled[:, k.start : k.start + m] for k in block.oscillators]
        _, z, zd = self.backend.rows_of_state()
        model = [loop.code.rows(k) for k in ("admittance.X", "command_sent", "frozen")]
        return [self._functions["lab_modes"].piece(*pair, z, zd, *model, self._modes)]

    def _probe(self, s: Scene) -> tuple[tuple[str, ...], bytes]:
        """Return names of the reward's terms, and numbers that distinguish tasks' formulas."""
        task, dt, rng = self.task, self.system.control_dt, np.random.default_rng(0)
        shapes = {f.name: getattr(s, f.name).shape[1:] for f in dataclasses.fields(s)}
        # two simulations with any numbers
        s = Scene(**{k: rng.uniform(0.1, 0.5, (2, *shape)) for k, shape in shapes.items()})
        with np.errstate(all="ignore"):
            task.remember(s, dt)
            last, none = np.array([False, True]), np.zeros(2, bool)
            counters = {f.name: np.full(2, 0.5) for f in dataclasses.fields(Episodes)}
            e: Any = Episodes(**counters | {"once": none, "missing": np.full((2, 2), 0.5)})
            parts: list[npt.NDArray[Any]] = [*task.observe(s), s.memory, *task.joint_range]
            for failed in (none, last):
                terms = judge(task, s, e, dt, last, failed, none, none).terms
                parts += terms.values()
            parts += [task.success(s), task.failed(s)]
            parts += [task.closes(s), task.opens(s)] if task.interacts else []
        return tuple(terms), b"".join(np.ascontiguousarray(k).tobytes() for k in parts)

    # ------------------------------------------------------------- rows and scene

    def load(self, ids: Index, s: Scene, e: Episodes) -> None:
        """Take over scene and episodes of some simulations.

        Args:
            ids: (k,) which.
            s, e: of k simulations.
        """
        block, lane = ids // LANES, ids % LANES
        self._ahead[block, :, lane] = carry_rows(self.shape, s, e)
        if self._goal.shape[1]:
            self._goal[block, :, lane] = s.goal
        self._note_diverged()

    def begin(self, ids: Index, rows: dict[str, Array]) -> None:
        """Put simulations where episodes begin.

        Args:
            ids: (k,) which.
            rows: (k, ...) `carry`, `scene`, `seen`, `goal`, `table_values`, and what
                `Simulator.begin_with` takes.
        """
        block, lane, inputs = ids // LANES, ids % LANES, self.shape.inputs
        self.sim.begin_with(ids, rows)
        self._ahead[block, :, lane] = rows["carry"]
        self._scene_rows[block, :, lane] = rows["scene"]
        if self._goal.shape[1]:
            self._goal[block, :, lane] = rows["goal"]
        if self.shape.table_values:
            self._inputs[block, inputs["table_values"], lane] = rows["table_values"]
        if self._emulated:
            observed = slice(inputs["y_seen"].start, inputs["yd_seen"].stop)
            self._inputs[block, observed, lane] = rows["seen"]
        if self._tailed is not None:
            self._inputs[block, inputs["tail"], lane] = 0.0
        if len(self._stopped):
            self._note_diverged()
        self.ahead = True

    def store(self, s: Scene, e: Episodes) -> None:
        """Bring scene and episodes up to date, but for the goals, which no step changes."""
        self.ahead = False
        rows, at = unlane(self._ahead, self.n), self.shape.carry
        k = {name: rows[:, columns] for name, columns in at.items()}
        s.ref, s.kp, s.kd, s.tau = k["ref"].reshape(self.n, 3, -1), k["kp"], k["kd"], k["tau"]
        s.memory = k["memory"]
        e.sums, e.peaks, e.total = k["sums"], k["peaks"], k["total"][:, 0]
        e.cost, e.missing = k["cost"][:, 0], k["missing"]
        e.once = k["once"][:, 0] != 0
        e.clipped, e.steps = (k[name][:, 0].astype(np.int64) for name in ("clipped", "steps"))
        if self.task.control.level == "gains":
            self.sim.note_gains(s.kp, s.kd)
        rows = unlane(self._scene_rows, self.n)
        for name, columns in self.shape.scene.items():
            setattr(s, name, rows[:, columns])
        if self._acts is not None:
            s.propellant = s.propellant[:, 0]
        if self.sim.machines.wheels:
            s.wheels = self.sim.wheel_speed
        rows, inputs = unlane(self._inputs, self.n), self.shape.inputs
        s.table_values, s.tail = (rows[:, inputs[k]] for k in ("table_values", "tail"))
        s.tail = s.tail[:, 0]
        s.time, s.y, s.yd, s.q, s.v = self.sim.last_state
        s.y_seen, s.yd_seen = s.y, s.yd
        if self._emulated:
            s.y_seen, s.yd_seen = rows[:, inputs["y_seen"]], rows[:, inputs["yd_seen"]]

    # ------------------------------------------------------------------- a period

    def step(
        self, actions: Array, over: Mask | None, goals: Array, decay: Callable[[], FreeDecay]
    ) -> tuple[Array, Mask, Mask, dict[str, Any]]:
        """Bring all simulations on by a period, see `Batch.step`.

        Args:
            actions: (n, width), checked.
            over: (n,) simulations that wait for their next episode.
            goals: (n, g) of the episodes.
            decay: makes what closes episodes; called where there is one to close.
        """
        sim, backend, loop = self.sim, self.backend, self.sim.emulation_loop
        if self._alone:
            self._action[0, :, : self.n] = actions.T  # what `fill` does, in one go
        else:
            fill(self._action, actions)
        self._mark(over)
        if self._tailed is not None:
            block, lane = self._tailed
            self._inputs[block, self.shape.inputs["tail"].start, lane] = 0.0
            self._tailed = None
        if self.shape.table_values:
            self._look_up(goals)
        if loop is not None:
            fill(self._draws, loop.draws())
        self._load_parts()
        backend.run_program(self._programs(), self.system.substeps, self._stopped)
        sim.stepped_elsewhere()
        self._store_parts()
        self.ahead = True
        rows = numbers(self._outputs, self.n)
        flags = rows[self._flags] != 0
        info: dict[str, Any] = {}
        ending = bool(np.count_nonzero(flags[5]))
        if ending and flags[4].any():
            sim.note_divergence()
            self._note_diverged()
        if loop is not None:
            loop.ran_elsewhere(unlane(self._reading, self.n) if ending else None)
            self.stopped = loop.frozen
        if ending:
            if self._cargo is not None and flags[6].any():
                rows, flags = self._grasp(np.flatnonzero(flags[6]), rows, flags)
            rows, flags, info = self._end(rows, flags, decay)
            if self._cargo is not None and flags[7].any():
                release_still(sim, np.flatnonzero(flags[7]))
        for key, at in self._terms:
            info[key] = rows[at]
        last, failed, info["success"], info["success_once"] = flags[:4]
        info["clipped"] = self._ahead[:, self._clipped].astype(np.int64).reshape(-1)[: self.n]
        self.observation = rows[self._observed].T.astype(np.float32, order="C")
        return rows[self._reward], last | failed, np.zeros(self.n, bool), info

    def _note_diverged(self) -> None:
        """Those that have diverged stay where they are, and have failed."""
        self._stopped = np.flatnonzero(self.sim.diverged)
        if self._cargo is not None:
            self._cargo.written = True  # these do not fly on either
        marks = self._lost if self._emulated else self._inputs[:, self.shape.inputs["stopped"]]
        marks[:] = 0.0
        marks[self._stopped // LANES, 0, self._stopped % LANES] = 1.0

    def _load_parts(self) -> None:
        """Take over what payloads, wheels and jets are, where Python has set it."""
        cargo, acts = self._cargo, self._acts
        if acts is not None and acts.written:
            acts.written = False
            names = self.shape.actuators
            fill(self._acting, np.hstack([getattr(acts, k).reshape(self.n, -1) for k in names]))
        if cargo is not None and cargo.written:
            cargo.written = False
            fill(self._bodies, cargo.rows(BODY))
            fill(self._numbers, cargo.rows(NUMBERS))
            if self.backend.floating:  # the engine moves them
                return
            steps = cargo.steps(self.system.control_dt, self.sim.machines.running)
            if steps.shape[1] > self._flight.shape[1]:
                self._flight = aligned(self.backend.blocks, steps.shape[1], LANES)
            self._flight[:, steps.shape[1] :] = 0.0
            fill(self._flight[:, : steps.shape[1]], steps)

    def _store_parts(self) -> None:
        """Store payloads, wheels and jets of the period."""
        if self._acts is not None:
            memory = unlane(self._acting, self.n)
            self._acts.take(*(memory[:, k] for k in self.shape.actuators.values()))
        if self._cargo is not None and (self._flight.shape[1] or self.backend.floating):
            self._cargo.store(unlane(self._bodies, self.n))

    def _grasp(
        self, ids: Index, rows: Array, flags: npt.NDArray[np.bool_]
    ) -> tuple[Array, npt.NDArray[np.bool_]]:
        """Close latches, and observe these simulations again."""
        assert self._cargo is not None
        ids = ids[self._cargo.closes(ids)]  # where rounding decides, as it does there
        if len(ids):
            self.sim.grasp(ids)
            self._load_parts()
            block, lane = ids // LANES, ids % LANES
            for i in np.unique(block).tolist():
                self._after(i, i + 1)
            rows[:, ids] = self._outputs[block, :, lane].T
            flags = rows[self._flags] != 0
        return rows, flags

    def _mark(self, over: Mask | None) -> None:
        at = self.shape.inputs["over"]
        if over is not None:
            fill(self._inputs[:, at], over[:, None].astype(np.float64))
        elif self._waiting:
            self._inputs[:, at] = 0.0
        self._waiting = over is not None

    def _look_up(self, goals: Array) -> None:
        step = self._ahead[:, self.shape.carry["steps"].start].reshape(-1)[: self.n]
        table_values = self.task.lookup(goals, step.astype(np.intp) + 1)
        fill(self._inputs[:, self.shape.inputs["table_values"]], table_values)

    def _end(
        self, rows: Array, flags: npt.NDArray[np.bool_], decay: Callable[[], FreeDecay]
    ) -> tuple[Array, npt.NDArray[np.bool_], dict[str, Any]]:
        """Close episodes: their energies, and the tail in the reward."""
        task, shape = self.task, self.shape
        ended = flags[0] | flags[1]
        if not ended.any():
            return rows, flags, {}
        ids = np.flatnonzero(ended & ~flags[4])
        tail, strain = np.zeros(self.n), np.zeros(self.n)
        if task.tail and len(ids):
            block, lane = ids // LANES, ids % LANES
            tail[ids], strain[ids] = self._tails(block, lane, decay())
            self._inputs[block, shape.inputs["tail"].start, lane] = tail[ids]
            self._tailed = block, lane
            for i in np.unique(block).tolist():
                self._after(i, i + 1)
            rows[:, ids] = self._outputs[block, :, lane].T
            flags = rows[self._flags] != 0
        first, last = shape.carry["energies"].start, shape.carry["steps"].stop
        state = numbers(self._ahead[:, first:last], self.n)
        E, _, total, strained, peak, strain_peak, *_, steps = state
        mean = (total + tail) / (steps * self.system.control_dt + task.tail)
        return rows, flags, ended_energies(mean, E, peak, strain_peak, strained + strain, ended)

    def _tails(self, block: Index, lane: Index, decay: FreeDecay) -> tuple[Array, Array]:
        """Energies that bases keep after the end, see `FreeDecay`.

        Args:
            block, lane: (k,) where the simulations are.
            decay: what gives them.
        """
        at, n, order = self.shape.reference, self.shape.joints, self.shape.coordinates
        x = self.backend.rows_of_state()[0][block, :, lane]
        reference = self._reference[block, :, lane]
        y, q = x[:, :6], x[:, 6 : 6 + n]
        yd, v = x[:, order : order + 6], x[:, order + 6 : order + 6 + n]
        if self._emulated:
            u, ud = np.split(self._modes[block, :, lane], 2, axis=1)
        else:
            u, ud = (x[:, k] for k in self.modes or (slice(0), slice(0)))
        locked = q if self.task.control.level == "torque" else reference[:, at["ref"]][:, :n]
        state = np.concatenate([y, u, q - locked, yd, ud, v], axis=1)
        return decay(q, state, reference[:, at["kp"]], reference[:, at["kd"]])
