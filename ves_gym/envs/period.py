"""A batch's control period in compiled code: what `Batch` does in NumPy, to rounding."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, Index, Mask
from ves_gym.engine.backends.kernel import KernelBackend
from ves_gym.engine.kernel.blocks import aligned, fill, numbers, unlane
from ves_gym.engine.kernel.compiled_function import Program
from ves_gym.engine.kernel.emit import LANES
from ves_gym.engine.kernel.scene import SceneMap, TorqueMap
from ves_gym.engine.kernel.symbolic import Untraceable
from ves_gym.envs import compiled
from ves_gym.envs.compiled import WIDEST, Shape, compiles, width
from ves_gym.envs.episode import FAILURE, outcome
from ves_gym.envs.period_laboratory import LaboratoryPrograms, signals_of

if TYPE_CHECKING:
    from ves_gym.envs.batch import Batch

_FAILURES = (Untraceable, ImportError, RuntimeError, OSError, TypeError, AttributeError)


def period_of(batch: Batch, scenes: SceneMap, torques: TorqueMap) -> Period | None:
    """The compiled period of a batch; None where it stays in NumPy.

    Args:
        batch: whose.
        scenes, torques: its maps.
    """
    kernel = isinstance(batch.sim.backend, KernelBackend)
    if not (kernel and compiles(batch.task)):
        return None
    try:
        return Period(batch, scenes, torques)
    except _FAILURES:
        return None


class Period:
    """The rows of a batch's episodes, and the programs that bring them on by a period.

    Args:
        batch: whose engine is the kernel.
        scenes, torques: its maps.

    Raises:
        Untraceable, ...: what cannot be compiled.
    """

    ahead = False  # the rows are later than the batch's scene and episodes

    def __init__(self, batch: Batch, scenes: SceneMap, torques: TorqueMap) -> None:
        self.batch, self.n = batch, batch.n
        backend = batch.sim.backend
        assert isinstance(backend, KernelBackend)
        self.backend = backend
        s = batch.scene
        goal = s.goal.shape[1] if s.goal.shape[1] <= WIDEST else 0
        # the engine is in the program; else Python steps it between two programs
        self.direct = batch.sim.emulation_loop is None and batch.sim.joint_delays is None
        terms, probe = self._probe()
        self.shape = shape = Shape(
            batch.task,
            batch.system,
            backend.coordinates,
            goal,
            s.table_values.shape[1],
            terms,
            signals_of(batch.sim),
        )
        functions = compiled.functions(shape, probe)
        blocks = backend.blocks
        n = shape.joints
        rows = lambda k: aligned(blocks, k, LANES)  # noqa: E731
        self._slate, self._next = rows(width(shape.slate)), rows(width(shape.slate))
        self._action, self._moved = rows(batch.width), rows(width(shape.moved))
        self._goal, self._external = rows(goal), rows(width(shape.external))
        self._outputs, self._tau, self._extra = rows(width(shape.outputs)), rows(n), rows(n)
        self._scene_rows = rows(8)
        self._nodes = rows(shape.nodes * (6 + n))
        self._waiting = False  # a simulation is marked as over
        self._laboratory: LaboratoryPrograms | None = None
        self._stopped = np.flatnonzero(batch.sim.diverged)  # these stay where they are
        outputs = shape.outputs
        self._flags = slice(outputs["last"].start, outputs["event"].stop)
        self._observed, self._reward = outputs["observation"], outputs["reward"].start
        self._terms = [(f"reward/{name}", outputs[f"reward/{name}"].start) for name in terms]
        self._clipped = shape.slate["clipped"].start
        self._emulated = batch.system.mode == "emulated"
        self._alone = blocks == 1
        x, z, zd = backend.rows_of_state()
        at = shape.moved
        before = self._slate[:, shape.slate["tau"]]
        gains = rows(2 * n)
        if (self.direct or shape.signals) and batch.task.control.level == "gains":
            gains = backend.rows_of_gains()
        measured = self._external[:, shape.external["y_seen"]] if self._emulated else z[:, :6]
        first = [
            functions["keep"].piece(self._next, self._slate),
            functions["move"].piece(z, zd, self._slate, self._goal, self._action, self._moved),
        ]
        if shape.feedforward:
            first.append(torques.piece([self._moved[:, at["ref"]]], self._extra))
        rows_in = [before, self._moved, self._extra]
        first.append(functions["follow"].piece(*rows_in, self._nodes, self._tau, gains))
        rows_in = [z, zd, x, self._slate, self._moved, self._tau, self._goal, self._external]
        m, modes = batch.system.base.hidden, []
        self._modes = rows(2 * m)
        if m:  # those that the base is described with; effects add theirs after them
            modes = [self._modes[:, :m], self._modes[:, m:]]
            if not self._emulated:
                modes = [part[:, :m] for part in backend.rows_of_modes()]
        last = [
            scenes.piece([z, zd, measured, *modes], self._scene_rows),
            functions["close"].piece(*rows_in, self._scene_rows, self._outputs, self._next),
        ]
        steps = batch.system.substeps
        self._before, self._after = Program(first), Program(last)
        self._period_programs = [
            Program([*first, piece, *last])
            for piece in backend.pieces(self._nodes, shape.nodes, steps)
        ]
        if shape.signals is not None:
            rows_between = self._nodes, self._external, self._modes
            made_of = (batch.sim, shape, functions, first, last, rows_between)
            self._laboratory = LaboratoryPrograms(*made_of)

    def _probe(self) -> tuple[tuple[str, ...], bytes]:
        """Names of the reward's terms, and numbers that tell tasks' formulas apart."""
        task, batch = self.batch.task, self.batch
        s = batch.probe()
        with np.errstate(all="ignore"):
            task.remember(s, batch.dt)
            last = np.array([False, True])
            terms = task.reward(s, batch.dt, last)
            parts: list[npt.NDArray[Any]] = [*task.observe(s), s.memory, *terms.values()]
            parts += [task.success(s), task.failed(s), *task.joint_range]
        parts += [np.array([FAILURE])]
        return (*terms, "failure"), b"".join(np.ascontiguousarray(k).tobytes() for k in parts)

    # ------------------------------------------------------------- rows and scene

    def load(self, ids: Index) -> None:
        """Take over scene and episodes of some simulations."""
        batch, at = self.batch, self.shape.slate
        s, e = batch.scene, batch.episodes
        rows = np.empty((len(ids), width(at)))
        parts = {
            "ref": s.ref.reshape(self.n, -1), "kp": s.kp, "kd": s.kd, "clipped": e.clipped,
            "tau": s.tau, "memory": s.memory, "energies": s.energies, "sums": e.sums,
            "peaks": e.peaks, "total": e.total, "once": e.once, "steps": e.steps,
        }  # fmt: skip
        for name, values in parts.items():
            rows[:, at[name]] = values[ids].reshape(len(ids), -1)
        block, lane = ids // LANES, ids % LANES
        self._next[block, :, lane] = rows
        if self._goal.shape[1]:
            self._goal[block, :, lane] = s.goal[ids]
        self._note_diverged()

    def store(self) -> None:
        """Bring the batch's scene and episodes up to date."""
        self.ahead = False
        self._write(self._next)
        s = self.batch.scene
        rows = unlane(self._scene_rows, self.n)
        s.energies, s.tool, s.tool_seen = rows[:, :2], rows[:, 2:5], rows[:, 5:]
        rows = unlane(self._external, self.n)
        s.table_values, s.tail = (
            rows[:, self.shape.external[k]] for k in ("table_values", "tail")
        )
        s.tail = s.tail[:, 0]
        s.time, s.y, s.yd, s.q, s.v = self.batch.sim.last_state
        s.y_seen, s.yd_seen = s.y, s.yd
        if self.batch.system.mode == "emulated":
            external = self.shape.external
            s.y_seen, s.yd_seen = rows[:, external["y_seen"]], rows[:, external["yd_seen"]]

    def _write(self, slate: Array) -> None:
        """Copy a slate to the batch's scene and episodes."""
        s, e = self.batch.scene, self.batch.episodes
        rows, at = unlane(slate, self.n), self.shape.slate
        k = {name: rows[:, columns] for name, columns in at.items()}
        s.ref, s.kp, s.kd, s.tau = k["ref"].reshape(self.n, 3, -1), k["kp"], k["kd"], k["tau"]
        s.memory, s.energies = k["memory"], k["energies"]
        e.sums, e.peaks, e.total = k["sums"], k["peaks"], k["total"][:, 0]
        e.once = k["once"][:, 0] != 0
        e.clipped, e.steps = (k[name][:, 0].astype(np.int64) for name in ("clipped", "steps"))
        if self.batch.task.control.level == "gains":
            self.batch.sim.note_gains(s.kp, s.kd)

    # ------------------------------------------------------------------- a period

    def step(
        self, actions: Array, over: Mask | None
    ) -> tuple[Array, Mask, Mask, dict[str, Any]]:
        """See `Batch.step`."""
        batch, backend = self.batch, self.backend
        if self._alone:
            self._action[0, :, : self.n] = actions.T  # what `fill` does, in one go
        else:
            fill(self._action, actions)
        self._mark(over)
        stopped: Mask | None = None
        in_program = False
        if self.direct:
            if self.shape.table_values:
                self._look_up(self._next)
            backend.run_program(self._period_programs, batch.system.substeps, self._stopped)
            batch.sim.stepped_elsewhere()
        elif self._laboratory is not None and self._run_laboratory():
            in_program = True
            batch.sim.stepped_elsewhere()
        else:
            self._before(0, backend.blocks)
            end = unlane(self._tau, self.n)
            control = batch.task.control
            if control.level == "gains":
                at = self.shape.moved
                rows = unlane(self._moved, self.n)
                batch.sim.set_gains(rows[:, at["kp"]], rows[:, at["kd"]])
            if control.held:
                batch.sim.step(end)
            else:
                start = unlane(self._slate[:, self.shape.slate["tau"]], self.n)
                batch.sim.step(start, until=end)
            if self.shape.table_values:
                self._look_up(self._slate)
            if self._emulated:
                stopped = self._measure()
            self._after(0, backend.blocks)
        rows = numbers(self._outputs, self.n)
        flags = rows[self._flags] != 0
        info: dict[str, Any] = {}
        if np.count_nonzero(flags[5]):
            self.ahead = True
            if flags[4].any():
                batch.sim.note_divergence()
                self._note_diverged()
            if in_program:
                stopped = self._laboratory_stops(some=True)
            rows, flags, info = self._end(rows, flags)
        else:
            self.ahead = True
            if in_program:
                stopped = self._laboratory_stops(some=False)
        batch.keep_observation(rows[self._observed])
        for key, at in self._terms:
            info[key] = rows[at]
        last, failed, info["success"], info["success_once"] = flags[:4]
        info["clipped"] = self._next[:, self._clipped].astype(np.int64).reshape(-1)[: self.n]
        info.update(batch.account(stopped, over))
        return rows[self._reward], *outcome(batch.task, last, failed), info

    def _note_diverged(self) -> None:
        """Those that have diverged stay where they are, and have failed."""
        self._stopped = np.flatnonzero(self.batch.sim.diverged)
        marks = self._external[:, self.shape.external["stopped"]]
        if self._laboratory is not None:
            marks = self._laboratory.lost
        marks[:] = 0.0
        marks[self._stopped // LANES, 0, self._stopped % LANES] = 1.0

    def _run_laboratory(self) -> bool:
        if self.shape.table_values:
            self._look_up(self._next)
        assert self._laboratory is not None
        return self._laboratory.run(self._stopped)

    def _laboratory_stops(self, some: bool) -> Mask:
        assert self._laboratory is not None
        return self._laboratory.stops(some)

    def _mark(self, over: Mask | None) -> None:
        at = self.shape.external["over"]
        if over is not None:
            fill(self._external[:, at], over[:, None].astype(np.float64))
        elif self._waiting:
            self._external[:, at] = 0.0
        self._waiting = over is not None

    def _look_up(self, slate: Array) -> None:
        batch, at = self.batch, self.shape.slate["steps"].start
        step = slate[:, at].reshape(-1)[: self.n].astype(np.intp) + 1
        table_values = batch.task.lookup(batch.goals, step)
        fill(self._external[:, self.shape.external["table_values"]], table_values)

    def _measure(self) -> Mask:
        """Take in what the laboratory measures and emulates; (n,) platforms that stand."""
        y, yd, stopped = self.batch.measured()
        external = self.shape.external
        lost = stopped | self.batch.sim.diverged
        parts = np.concatenate([y, yd, lost[:, None]], axis=1)
        fill(self._external[:, external["y_seen"].start : external["stopped"].stop], parts)
        m = self.batch.system.base.hidden
        if m and (modes := self.batch.sim.base_modes) is not None:
            fill(self._modes, np.concatenate([part[:, -m:] for part in modes], axis=1))
        return stopped

    def _end(
        self, rows: Array, flags: npt.NDArray[np.bool_]
    ) -> tuple[Array, npt.NDArray[np.bool_], dict[str, Any]]:
        """Close episodes: their energies, and the tail in the reward."""
        batch, shape = self.batch, self.shape
        ended = flags[0] | flags[1]
        if not ended.any():
            return rows, flags, {}
        ids = np.flatnonzero(ended & ~batch.sim.diverged)
        tail, strain = np.zeros(self.n), np.zeros(self.n)
        if batch.task.tail:
            moved, at = unlane(self._moved, self.n)[ids], shape.moved
            ref = moved[:, at["ref"]][:, : shape.joints]
            tail[ids], strain[ids] = batch.tail(
                ids, ref, moved[:, at["kp"]], moved[:, at["kd"]]
            )
            column = self._external[:, shape.external["tail"]]
            fill(column, tail[:, None])
            self._after(0, self.backend.blocks)
            rows = numbers(self._outputs, self.n)
            flags = rows[self._flags] != 0
            column[:] = 0.0
        batch.scene.tail = tail
        return rows, flags, batch.energies_at_end(strain, ended)
