"""A control period in compiled code: what `Batch` does in NumPy, to rounding."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, Index, Mask
from ves_gym.engine.backends.kernel import KernelBackend
from ves_gym.engine.kernel.compiled_function import Program, aligned, fill, numbers, unlane
from ves_gym.engine.kernel.emit import LANES
from ves_gym.engine.kernel.scene import SceneMap, TorqueMap
from ves_gym.envs import compiled
from ves_gym.envs.compiled import WIDEST, Shape, carry_rows, compiles, width
from ves_gym.envs.episode import FAILURE, Episodes, ended_energies, outcome
from ves_gym.envs.laboratory_programs import LaboratoryPrograms, signals_of
from ves_gym.envs.tail import FreeDecay
from ves_gym.envs.task import Scene, Task
from ves_gym.simulation.simulator import Simulator


class StepOutcome(NamedTuple):
    """What a period of n simulations gives."""

    reward: Array  # (n,)
    terminated: Mask  # (n,)
    truncated: Mask  # (n,)
    info: dict[str, Any]
    observation: npt.NDArray[np.float32]  # (n, observations)
    stopped: Mask | None  # (n,) platforms that stand still for good, in the laboratory


def compiled_step(
    sim: Simulator, task: Task, s: Scene, scenes: SceneMap, torques: TorqueMap
) -> CompiledStep | None:
    """The compiled period of a task; None where it stays in NumPy: no kernel, or no formulas.

    Args:
        sim: whose engine it steps.
        task: what the episodes ask.
        s: of its simulations, for the widths of its parts.
        scenes, torques: maps for as many simulations.

    Raises:
        FormulaError: task or control say that they are formulas, and are not.
    """
    kernel = isinstance(sim.backend, KernelBackend)
    acts = sim.base_actuators is not None  # period by period
    if acts or not (kernel and compiles(task)):
        return None
    return CompiledStep(sim, task, s, scenes, torques)


class CompiledStep:
    """The rows of n simulations' episodes, and the programs that bring them on by a period.

    Args:
        sim, task, s, scenes, torques: see `compiled_step`.

    Raises:
        FormulaError: what cannot be compiled.
    """

    ahead = False  # the rows are later than scene and episodes
    _tailed: tuple[Index, Index] | None = None  # where energies after an end stand in the rows

    def __init__(
        self, sim: Simulator, task: Task, s: Scene, scenes: SceneMap, torques: TorqueMap
    ) -> None:
        self.sim, self.task, self.system, self.n = sim, task, sim.system, sim.n
        backend = sim.backend
        assert isinstance(backend, KernelBackend)
        self.backend = backend
        system = sim.system
        goal = s.goal.shape[1] if s.goal.shape[1] <= WIDEST else 0
        # the engine is in the program; else Python steps it between two programs
        self.direct = sim.emulation_loop is None and sim.joint_delays is None
        terms, probe = self._probe(s)
        self.shape = shape = Shape(
            task,
            system,
            backend.coordinates,
            goal,
            s.table_values.shape[1],
            terms,
            signals_of(sim),
        )
        functions = compiled.functions(shape, probe)
        blocks = backend.blocks
        n = shape.joints
        rows = lambda k: aligned(blocks, k, LANES)  # noqa: E731
        self._carry, self._next = rows(width(shape.carry)), rows(width(shape.carry))
        self._action, self._reference = (
            rows(task.control.width(system.arm)),
            rows(width(shape.reference)),
        )
        self._goal, self._inputs = rows(goal), rows(width(shape.inputs))
        self._outputs, self._tau, self._extra = rows(width(shape.outputs)), rows(n), rows(n)
        self._scene_rows = rows(8)
        self._nodes = rows(shape.nodes * (6 + n))
        self._waiting = False  # a simulation is marked as over
        self._laboratory: LaboratoryPrograms | None = None
        self._stopped = np.flatnonzero(sim.diverged)  # these stay where they are
        outputs = shape.outputs
        self._flags = slice(outputs["last"].start, outputs["event"].stop)
        self._observed, self._reward = outputs["observation"], outputs["reward"].start
        self._terms = [(f"reward/{name}", outputs[f"reward/{name}"].start) for name in terms]
        self._clipped = shape.carry["clipped"].start
        self._emulated = system.mode == "emulated"
        self._alone = blocks == 1
        x, z, zd = backend.rows_of_state()
        at = shape.reference
        before = self._carry[:, shape.carry["tau"]]
        gains = rows(2 * n)
        if (self.direct or shape.signals) and task.control.level == "gains":
            gains = backend.rows_of_gains()
        measured = self._inputs[:, shape.inputs["y_seen"]] if self._emulated else z[:, :6]
        first = [
            functions["keep"].piece(self._next, self._carry),
            functions["move"].piece(
                z, zd, self._carry, self._goal, self._action, self._reference
            ),
        ]
        if shape.feedforward:
            first.append(torques.piece([self._reference[:, at["ref"]]], self._extra))
        rows_in = [before, self._reference, self._extra]
        first.append(functions["follow"].piece(*rows_in, self._nodes, self._tau, gains))
        rows_in = [z, zd, x, self._carry, self._reference, self._tau, self._goal, self._inputs]
        m, modes = system.base.hidden, []
        self._modes = rows(2 * m)
        # columns of the engine's state that are the base's internal modes, and their rates
        hidden = 6 + n + len(system.actual.arm.geared) + system.actual.arm.bends
        order = backend.coordinates
        self.modes = None
        if m:
            self.modes = slice(hidden, hidden + m), slice(order + hidden, order + hidden + m)
        if m:  # those that the base is described with; effects add theirs after them
            modes = [self._modes[:, :m], self._modes[:, m:]]
            if not self._emulated:
                modes = [part[:, :m] for part in backend.rows_of_modes()]
        last = [
            scenes.piece([z, zd, measured, *modes], self._scene_rows),
            functions["close"].piece(*rows_in, self._scene_rows, self._outputs, self._next),
        ]
        steps = system.substeps
        self._before, self._after = Program(first), Program(last)
        self._period_programs = [
            Program([*first, piece, *last])
            for piece in backend.pieces(self._nodes, shape.nodes, steps)
        ]
        if shape.signals is not None:
            rows_between = self._nodes, self._inputs, self._modes
            made_of = (sim, shape, functions, first, last, rows_between)
            self._laboratory = LaboratoryPrograms(*made_of)

    def _probe(self, s: Scene) -> tuple[tuple[str, ...], bytes]:
        """Names of the reward's terms, and numbers that tell tasks' formulas apart."""
        task, dt, rng = self.task, self.system.control_dt, np.random.default_rng(0)
        shapes = {f.name: getattr(s, f.name).shape[1:] for f in dataclasses.fields(s)}
        # two simulations with any numbers
        s = Scene(**{k: rng.uniform(0.1, 0.5, (2, *shape)) for k, shape in shapes.items()})
        with np.errstate(all="ignore"):
            task.remember(s, dt)
            last = np.array([False, True])
            terms = task.reward(s, dt, last)
            parts: list[npt.NDArray[Any]] = [*task.observe(s), s.memory, *terms.values()]
            parts += [task.success(s), task.failed(s), *task.joint_range]
        parts += [np.array([FAILURE])]
        return (*terms, "failure"), b"".join(np.ascontiguousarray(k).tobytes() for k in parts)

    # ------------------------------------------------------------- rows and scene

    def load(self, ids: Index, s: Scene, e: Episodes) -> None:
        """Take over scene and episodes of some simulations.

        Args:
            ids: (k,) which.
            s, e: of k simulations.
        """
        block, lane = ids // LANES, ids % LANES
        self._next[block, :, lane] = carry_rows(self.shape, s, e)
        if self._goal.shape[1]:
            self._goal[block, :, lane] = s.goal
        self._note_diverged()

    def begin(self, ids: Index, rows: dict[str, Array]) -> None:
        """Put simulations where episodes begin, in space.

        Args:
            ids: (k,) which.
            rows: (k, ...) state `x`, `carry`, `scene`, `goal` and `table_values`.
        """
        block, lane, inputs = ids // LANES, ids % LANES, self.shape.inputs
        self.backend.begin(ids, rows["x"])
        self.sim.begun_elsewhere(ids)
        self._next[block, :, lane] = rows["carry"]
        self._scene_rows[block, :, lane] = rows["scene"]
        if self._goal.shape[1]:
            self._goal[block, :, lane] = rows["goal"]
        if self.shape.table_values:
            self._inputs[block, inputs["table_values"], lane] = rows["table_values"]
        if self._tailed is not None:
            self._inputs[block, inputs["tail"], lane] = 0.0
        if len(self._stopped):
            self._note_diverged()
        self.ahead = True

    def store(self, s: Scene, e: Episodes) -> None:
        """Bring scene and episodes up to date, but for the goals, which no step changes."""
        self.ahead = False
        rows, at = unlane(self._next, self.n), self.shape.carry
        k = {name: rows[:, columns] for name, columns in at.items()}
        s.ref, s.kp, s.kd, s.tau = k["ref"].reshape(self.n, 3, -1), k["kp"], k["kd"], k["tau"]
        s.memory = k["memory"]
        e.sums, e.peaks, e.total = k["sums"], k["peaks"], k["total"][:, 0]
        e.once = k["once"][:, 0] != 0
        e.clipped, e.steps = (k[name][:, 0].astype(np.int64) for name in ("clipped", "steps"))
        if self.task.control.level == "gains":
            self.sim.note_gains(s.kp, s.kd)
        rows = unlane(self._scene_rows, self.n)
        s.energies, s.tool, s.tool_seen = rows[:, :2], rows[:, 2:5], rows[:, 5:]
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
    ) -> StepOutcome:
        """Bring all simulations on by a period, see `Batch.step`.

        Args:
            actions: (n, width), checked.
            over: (n,) simulations that wait for their next episode.
            goals: (n, g) of the episodes.
            decay: makes what closes episodes; asked where there is one to close.
        """
        sim, backend = self.sim, self.backend
        if self._alone:
            self._action[0, :, : self.n] = actions.T  # what `fill` does, in one go
        else:
            fill(self._action, actions)
        self._mark(over)
        if self._tailed is not None:
            block, lane = self._tailed
            self._inputs[block, self.shape.inputs["tail"].start, lane] = 0.0
            self._tailed = None
        stopped: Mask | None = None
        in_program = False
        if self.direct:
            if self.shape.table_values:
                self._look_up(self._next, goals)
            backend.run_program(self._period_programs, self.system.substeps, self._stopped)
            sim.stepped_elsewhere()
        elif self._laboratory is not None and self._run_laboratory(goals):
            in_program = True
            sim.stepped_elsewhere()
        else:
            self._before(0, backend.blocks)
            end = unlane(self._tau, self.n)
            control = self.task.control
            if control.level == "gains":
                at = self.shape.reference
                rows = unlane(self._reference, self.n)
                sim.set_gains(rows[:, at["kp"]], rows[:, at["kd"]])
            if control.held:
                sim.step(end)
            else:
                start = unlane(self._carry[:, self.shape.carry["tau"]], self.n)
                sim.step(start, until=end)
            if self.shape.table_values:
                self._look_up(self._carry, goals)
            if self._emulated:
                stopped = self._measure()
            self._after(0, backend.blocks)
        rows = numbers(self._outputs, self.n)
        flags = rows[self._flags] != 0
        info: dict[str, Any] = {}
        if np.count_nonzero(flags[5]):
            self.ahead = True
            if flags[4].any():
                sim.note_divergence()
                self._note_diverged()
            if in_program:
                stopped = self._laboratory_stops(some=True)
            rows, flags, info = self._end(rows, flags, decay)
        else:
            self.ahead = True
            if in_program:
                stopped = self._laboratory_stops(some=False)
        for key, at in self._terms:
            info[key] = rows[at]
        last, failed, info["success"], info["success_once"] = flags[:4]
        info["clipped"] = self._next[:, self._clipped].astype(np.int64).reshape(-1)[: self.n]
        observation = rows[self._observed].T.astype(np.float32, order="C")
        ends = outcome(self.task, last, failed)
        return StepOutcome(rows[self._reward], *ends, info, observation, stopped)

    def _note_diverged(self) -> None:
        """Those that have diverged stay where they are, and have failed."""
        self._stopped = np.flatnonzero(self.sim.diverged)
        marks = self._inputs[:, self.shape.inputs["stopped"]]
        if self._laboratory is not None:
            marks = self._laboratory.lost
        marks[:] = 0.0
        marks[self._stopped // LANES, 0, self._stopped % LANES] = 1.0

    def _run_laboratory(self, goals: Array) -> bool:
        if self.shape.table_values:
            self._look_up(self._next, goals)
        assert self._laboratory is not None
        return self._laboratory.run(self._stopped)

    def _laboratory_stops(self, some: bool) -> Mask:
        assert self._laboratory is not None
        return self._laboratory.stops(some)

    def _mark(self, over: Mask | None) -> None:
        at = self.shape.inputs["over"]
        if over is not None:
            fill(self._inputs[:, at], over[:, None].astype(np.float64))
        elif self._waiting:
            self._inputs[:, at] = 0.0
        self._waiting = over is not None

    def _look_up(self, carry: Array, goals: Array) -> None:
        at = self.shape.carry["steps"].start
        step = carry[:, at].reshape(-1)[: self.n].astype(np.intp) + 1
        table_values = self.task.lookup(goals, step)
        fill(self._inputs[:, self.shape.inputs["table_values"]], table_values)

    def _measure(self) -> Mask:
        """Take in what the laboratory measures and emulates; (n,) platforms that stand."""
        loop = self.sim.emulation_loop
        assert loop is not None
        y, yd, stopped = loop.y_measured, loop.vehicle_state[:, 6:], loop.frozen
        inputs = self.shape.inputs
        lost = stopped | self.sim.diverged
        parts = np.concatenate([y, yd, lost[:, None]], axis=1)
        fill(self._inputs[:, inputs["y_seen"].start : inputs["stopped"].stop], parts)
        m = self.system.base.hidden
        if m and (modes := self.sim.base_modes) is not None:
            fill(self._modes, np.concatenate([part[:, -m:] for part in modes], axis=1))
        return stopped

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
        E, _, total, strained, peak, strain_peak, _, _, steps = numbers(
            self._next[:, first:last], self.n
        )
        return (
            rows,
            flags,
            ended_energies(
                (total + tail) / (steps * self.system.control_dt + task.tail),
                E,
                peak,
                strain_peak,
                strained + strain,
                ended,
            ),
        )

    def _tails(self, block: Index, lane: Index, decay: FreeDecay) -> tuple[Array, Array]:
        """Energies that bases keep after the end, see `FreeDecay`.

        Args:
            block, lane: (k,) where the simulations are.
            decay: what tells them.
        """
        at, n = self.shape.reference, self.shape.joints
        x, reference = (
            self.backend.rows_of_state()[0][block, :, lane],
            self._reference[block, :, lane],
        )
        order = self.shape.coordinates
        y, q, yd, v = (
            x[:, a:b]
            for a, b in ((0, 6), (6, 6 + n), (order, order + 6), (order + 6, order + 6 + n))
        )
        if self._emulated:
            u, ud = np.split(self._modes[block, :, lane], 2, axis=1)
        else:
            u, ud = (x[:, k] for k in self.modes or (slice(0), slice(0)))
        held = q if self.task.control.level == "torque" else reference[:, at["ref"]][:, :n]
        state = np.concatenate([y, u, q - held, yd, ud, v], axis=1)
        return decay(q, state, reference[:, at["kp"]], reference[:, at["kd"]])
