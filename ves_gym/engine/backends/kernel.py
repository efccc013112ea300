"""The compiled engine: the system's own equations, many simulations a vector wide.

The same answers as MuJoCo's (docs/claims.md), some fifty times faster; and contact.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ves_gym._util.params import Array, Index, object_rows
from ves_gym.engine.backends.base import MEANINGLESS
from ves_gym.engine.backends.compiled import CompiledBackend, accounted
from ves_gym.engine.kernel.build import LANES
from ves_gym.engine.kernel.compiled_function import (
    Piece,
    Program,
    Stepper,
    aligned,
    fill,
    lanes,
    unlane,
)
from ves_gym.engine.kernel.numbers import structure
from ves_gym.system.system import System

if TYPE_CHECKING:
    from ves_gym.engine.kernel.trace import Equations

_SHORT = 64  # steps of a sequence whose memory is kept for the next
_ALONE = 8  # blocks below which a second thread costs more than it brings


@lru_cache(maxsize=64)
def stepper(system: System) -> Stepper:
    """The steps of a system; systems that differ in values only share their code."""

    def trace() -> Equations:
        from ves_gym.engine.kernel.trace import equations  # of what is in no store yet

        return equations(system, accounted(system))

    return Stepper(structure(system), trace, system.integrator)


class _Ramp(NamedTuple):
    """Steps under commands that run from node to node (`KernelBackend._ramp`)."""

    u: Array  # (blocks, nodes k, LANES)
    out: Array | None  # (blocks, nodes ny, LANES)
    pieces: list[Piece]


class KernelBackend(CompiledBackend):
    """`Backend` on a compiled kernel; see `Backend` for what each method does.

    Arrays are blocks of LANES simulations, a row per quantity; the last block is filled up
    with simulations that nobody reads.
    """

    name = "kernel"
    state_names = ("_start", "_ticks", "_fault")

    def __init__(self, system: System, n: int, threads: int) -> None:
        super().__init__(system, n)
        self._stepper = stepper(system)
        self._stepper.code  # noqa: B018  # raises where nothing compiles
        values = self.rows.values
        self._blocks = -(-n // LANES)
        self._x = aligned(self._blocks, self._nx, LANES)
        self._p = aligned(self._blocks, len(values), LANES)
        self._p[:] = values[:, None]
        self._u = aligned(self._blocks, self._nu, LANES)
        self._holds: dict[int, list[Piece]] = {}  # steps under a command that holds
        self._ramps: dict[tuple[int, bool], _Ramp] = {}
        self._start, self._ticks = np.zeros(n), np.zeros(n, np.int64)
        self._fault = np.zeros(n, bool)
        requested = threads or os.cpu_count() or 1
        self._threads = max(1, min(requested, self._blocks // _ALONE))
        self._scratch = aligned(self._threads, 3 * self._nx + self._nu, LANES)
        self._unread = aligned(self._threads, self._ny, LANES)  # outputs nobody asked for
        edges = np.linspace(0, self._blocks, self._threads + 1).astype(int).tolist()
        self._shares = list(itertools.pairwise(edges))
        self._pool: ThreadPoolExecutor | None = None

    # -------------------------------------------------------------- programs

    @property
    def blocks(self) -> int:
        """Number of blocks of LANES simulations."""
        return self._blocks

    @property
    def coordinates(self) -> int:
        """Number of coordinates: (Y, q) and what is hidden."""
        return self._order

    def rows_of_state(self) -> tuple[Array, Array, Array]:
        """State as it lies in memory, in place: all of it, (Y, q), and the rate of these."""
        size = 6 + self.joints
        x = self._x
        return x[:, : 2 * self._order], x[:, :size], x[:, self._order : self._order + size]

    def rows_of_modes(self) -> tuple[Array, Array]:
        """Coordinates and rates of the base's internal modes in memory, in place."""
        first, order = 6 + self.joints + self._gears, self._order
        end = order - self.floating
        return self._x[:, first:end], self._x[:, order + first : order + end]

    def rows_of_payload(self) -> tuple[Array, Array]:
        """Coordinates and rates of a payload that is touched in memory, in place."""
        k, order = self.floating, self._order
        return self._x[:, order - k : order], self._x[:, 2 * order - k : 2 * order]

    def rows_of_parameters(self) -> Array:
        """Parameters in memory, in place."""
        return self._p

    @property
    def outputs(self) -> int:
        """Numbers per node: accelerations, drive torques and, emulated, the arm's wrench."""
        return self._ny

    def rows_of_gains(self) -> Array:
        """Servo gains as they lie in memory, in place: kp of every joint, then kd."""
        first = self.names.index("kp1")
        return self._p[:, first : first + 2 * self.joints]

    def rows_of_actuators(self) -> list[Array]:
        """Wheels' motor torques and the jets' wrench in memory, in place, one by one."""
        every = (f"motorcarried{k + 1}" for k in range(self._carried))
        at = [
            self.names.index(k)
            for k in (*every, *(f"jet{k + 1}" for k in range(6)))
            if k in self.names
        ]
        return [self._p[:, k : k + 1] for k in at]

    def pieces(
        self, commands: Array, nodes: int, steps: int, outputs: Array | None = None
    ) -> list[Piece]:
        """Physics steps as a piece of a program, one for each thread (`run_program`).

        Args:
            commands: (blocks, nodes (6 + joints), LANES) in memory that stays.
            nodes: per period; 1 where the command is held.
            steps: physics steps.
            outputs: (blocks, (steps + 1) `outputs`, LANES), written; None: not wanted.
        """
        strides = nodes * self._nu, self._nu if nodes > 1 else 0
        options: Any = {"steps": steps, "h": self.dt, "strides": strides}
        return [
            self._stepper.steps(
                self._x,
                commands,
                self._p,
                unread if outputs is None else outputs,
                scratch,
                record=outputs is not None,
                **options,
            )
            for unread, scratch in zip(self._unread, self._scratch, strict=True)
        ]

    def run_program(self, programs: Sequence[Program], steps: int, stopped: Index) -> None:
        """Run a program, each thread its own.

        Args:
            programs: one for each of `pieces`.
            steps: physics steps in it.
            stopped: simulations that stay where they are.
        """
        before = None
        if len(stopped):
            at = (stopped // LANES, slice(None), stopped % LANES)
            before = self._x[at]
        if self._threads == 1:
            programs[0](0, self._blocks)
        else:
            self._share(lambda i: programs[i](*self._shares[i]))
        self._ticks += steps
        if before is not None:
            self._x[at] = before
            self._ticks[stopped] -= steps

    def note_faults(self) -> None:
        """Look for states that are no longer meaningful."""
        if not (np.abs(self._x) < MEANINGLESS).all():  # a NaN is not
            self._fault |= ~(np.abs(unlane(self._x, self.n)) < MEANINGLESS).all(axis=1)

    # ---------------------------------------------------------------- blocks

    def _ramp(self, steps: int, record: bool = False) -> _Ramp:
        """Steps under commands at every one of their ends, and the rows of these."""
        if (steps, record) not in self._ramps:
            u = aligned(self._blocks, (steps + 1) * self._nu, LANES)
            out = aligned(self._blocks, (steps + 1) * self._ny, LANES) if record else None
            self._ramps[steps, record] = _Ramp(u, out, self.pieces(u, steps + 1, steps, out))
        return self._ramps[steps, record]

    def _run(self, pieces: Sequence[Piece], steps: int) -> None:
        """Advance all blocks, shared among threads."""
        self._share(lambda i: pieces[i](*self._shares[i]))
        self._ticks += steps

    def _share(self, part: Callable[[int], None]) -> None:
        """Do a share of the work on every thread."""
        if self._threads == 1:
            part(0)
            return
        if self._pool is None:
            self._pool = ThreadPoolExecutor(self._threads - 1)
        others = [self._pool.submit(part, i) for i in range(1, self._threads)]
        part(0)
        for other in others:
            other.result()

    def _guarded(self, ids: Index | None, pieces: Sequence[Piece], steps: int) -> None:
        """Run steps, then put the simulations not in `ids` back where they were."""
        before = None if ids is None else (self._x.copy(), self._ticks.copy())
        self._run(pieces, steps)
        if before is not None:
            assert ids is not None
            others = np.setdiff1d(np.arange(self._blocks * LANES), ids)
            at = (others // LANES, slice(None), others % LANES)
            self._x[at] = before[0][at]
            still = others[others < self.n]
            self._ticks[still] = before[1][still]
        self.note_faults()

    # --------------------------------------------------------------- backend

    def _states(self) -> Array:
        return unlane(self._x, self.n)

    def _put(self, ids: Index, columns: slice, values: Array) -> None:
        self._x[ids // LANES, columns, ids % LANES] = values

    def write(self, ids: Index, time: Array, z: Array, zd: Array) -> None:
        self.begin(ids, self.states_of(ids, z, zd), time)

    def begin(self, ids: Index, x: Array, time: Array | float = 0.0) -> None:
        """Put simulations (k,) into states (k, nx) as `states_of` gives them."""
        self._put(ids, slice(None), x)
        self._u[ids // LANES, :, ids % LANES] = 0.0  # no acceleration of a platform either
        self._start[ids], self._ticks[ids], self._fault[ids] = time, 0, False

    def rows_of(self, ids: Index) -> dict[str, Array]:
        """State and numbers of simulations (k,), with which `begin_with` begins others."""
        block, lane = ids // LANES, ids % LANES
        systems = object_rows([self._systems[i] for i in ids.tolist()])
        return {"x": self._x[block, :, lane], "p": self._p[block, :, lane], "system": systems}

    def begin_with(self, ids: Index, rows: Mapping[str, Array]) -> None:
        """Put simulations (k,) into states at time 0, with numbers of `rows_of` if given."""
        self.begin(ids, rows["x"])
        if "p" not in rows:
            return
        self._p[ids // LANES, :, ids % LANES] = rows["p"]
        for i, system in zip(ids.tolist(), rows["system"].tolist(), strict=True):
            self._systems[i] = system

    def _set_parameter(self, at: int, ids: Index, values: Array) -> None:
        self._p[ids // LANES, at, ids % LANES] = values

    def _parameters(self) -> Array:
        return unlane(self._p, self.n)

    def _row(self, i: int) -> Array:
        return self._p[i // LANES, :, i % LANES]

    def step_sequence(self, commands: Array, ids: Index | None) -> None:
        k = commands.shape[1] - 1
        if not commands.strides[1]:  # one command, held
            fill(self._u[:, 6:], commands[:, 0])
            if k not in self._holds:
                self._holds[k] = self.pieces(self._u, 1, k)
            self._guarded(ids, self._holds[k], k)
            return
        base = np.zeros((self.n, k + 1, 6))
        nodes = np.concatenate([base, commands], axis=-1).reshape(self.n, -1)
        if k <= _SHORT:
            ramp = self._ramp(k)
            u, pieces = ramp.u, ramp.pieces
            fill(u, nodes)
        else:
            u = lanes(nodes)
            pieces = self.pieces(u, k + 1, k)
        self._guarded(ids, pieces, k)
        self._u[:] = u[:, k * self._nu :]

    def step_on_platform(self, commands: Array, base: Array, ids: Index | None) -> Array:
        k = commands.shape[1] - 1
        ramp = self._ramp(k, record=True)
        fill(ramp.u, np.concatenate([base, commands], axis=-1).reshape(self.n, -1))
        self._guarded(ids, ramp.pieces, k)
        self._u[:] = ramp.u[:, k * self._nu :]
        assert ramp.out is not None
        rows = ramp.out.reshape(self._blocks, k + 1, self._ny, LANES)[:, :, -6:]
        flat = np.moveaxis(rows, 3, 1).reshape(-1, k + 1, 6)
        return np.ascontiguousarray(flat[: self.n])

    def evaluate(self, command: Array) -> tuple[Array, Array]:
        inputs = unlane(self._u, self.n)
        inputs[:, 6:] = command
        fill(self._u, inputs)
        out = aligned(self._blocks, self._ny, LANES)
        self._run(self.pieces(self._u, 1, 0, out), 0)
        return self._accelerations(unlane(out, self.n))

    def get_state(self) -> dict[str, Array]:
        return super().get_state() | {"x": self._states(), "u": unlane(self._u, self.n)}

    def set_state(self, state: Mapping[str, Array]) -> None:
        super().set_state(state)
        fill(self._x, state["x"])
        fill(self._u, state["u"])
