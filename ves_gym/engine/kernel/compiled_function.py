"""`CompiledFunction`: a function of rows of numbers in NumPy, in machine code, or on a GPU."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, Rows
from ves_gym.engine.kernel import build
from ves_gym.engine.kernel.build import LANES
from ves_gym.engine.kernel.symbolic import column, symbols

if TYPE_CHECKING:
    import casadi

    from ves_gym.engine.kernel.trace import Equations

_CHUNK = 512  # blocks at a time: inputs and outputs stay in the cache


class CompiledFunction:
    """y = f(x_1, ..., x_k) for many points, from one graph; all that is compiled is one.

    Calling it with arrays gives arrays, in machine code where the machine has a compiler, else
    by `numpy`. `piece` is the same on rows of lanes, as a part of a `Program`; `gpu` is that of
    a GPU. Nobody else has to know whether something compiles: only a `Stepper` raises where
    nothing does.

    The graph is made of NumPy text by `symbolic`, and only where neither this process nor the
    store on disk has the code (`build.code`).

    Args:
        key: all that the graph depends on besides the package's text and the processor, as its
            `repr`; None for what comes from a user's text: the graph itself is the key then.
        graph: makes it.
        in_place: results may lie where arguments do.
    """

    def __init__(
        self, key: object, graph: Callable[[], casadi.Function], *, in_place: bool = False
    ) -> None:
        self._key, self._make, self._in_place = key, graph, in_place

    @staticmethod
    def of(
        key: object, text: Callable[..., Any], *widths: int, in_place: bool = False
    ) -> CompiledFunction:
        """Return the function that NumPy text computes.

        Args:
            key, in_place: see the class.
            text: arrays (n, k) -> an array (n, m), or a tuple of them; see `symbolic`.
            widths: k of each argument.
        """

        def graph() -> casadi.Function:
            import casadi as ca

            x = [symbols(f"x{i}", (1, k)) for i, k in enumerate(widths)]
            out = text(*x)
            results = [column(k) for k in (out if isinstance(out, tuple) else (out,))]
            return ca.Function("text", [column(k) for k in x], ca.cse(results))

        return CompiledFunction(key, graph, in_place=in_place)

    @cached_property
    def graph(self) -> casadi.Function:
        """The graph, traced on first use."""
        return self._make()

    @cached_property
    def digest(self) -> str:
        """Return the key of its code in the cache."""
        what = self.graph.serialize() if self._key is None else repr(self._key)
        return build.digest(f"{type(self).__name__} {self._in_place} {what}")

    @property
    def code(self) -> build.MachineCode:
        """The machine code.

        Raises:
            ImportError, RuntimeError, OSError: nothing compiles here.
        """

        def text() -> str:
            from ves_gym.engine.kernel.emit import emit_graph  # of what is in no store yet

            return emit_graph(self.graph, self._in_place)

        return build.code(self.digest, text, lambda: self._sizes)

    @property
    def _compiled(self) -> build.MachineCode | None:
        try:
            return self.code
        except build.NOT_HERE:
            return None

    @property
    def _sizes(self) -> tuple[list[int], list[int]]:
        graph = self.graph
        inputs = [graph.size1_in(i) for i in range(graph.n_in())]
        return inputs, [graph.size1_out(i) for i in range(graph.n_out())]

    @cached_property
    def sizes(self) -> tuple[Sequence[int], Sequence[int]]:
        """Numbers in each argument and in each result."""
        code = self._compiled
        return self._sizes if code is None else (code.inputs, code.outputs)

    # ------------------------------------------------------------------- executors

    def numpy(self, *x: Array) -> list[Array]:
        """Evaluate the graph, interpreted.

        Args:
            x: (n, k) each, or (1, k) for all points.

        Returns:
            Each result (n, m).
        """
        n = max((len(part) for part in x), default=1)
        out = self.graph.call([np.broadcast_to(part, (n, part.shape[1])).T for part in x])
        return [np.array(part.full().T) for part in out]

    def piece(self, *rows: Array) -> Piece:
        """Return the function on fixed rows.

        Args:
            rows: of its arguments, then of its results: (blocks, k, LANES), or a slice along
                the second axis of such an array; (1, k, LANES) serves all blocks.
        """
        assert len(rows) == sum(map(len, self.sizes)), "rows for each argument and result"
        code = self._compiled
        if code is None:
            return Piece(None, (), rows, lambda lo, hi: self._interpret(rows, lo, hi))
        stride = LANES * 8  # bytes of a row
        words = [
            word
            for k in rows
            for word in (k.ctypes.data, k.strides[0] // stride * (len(k) > 1))
        ]
        return Piece(code, words, rows)

    def _interpret(self, rows: Sequence[Array], lo: int, hi: int) -> None:
        count = len(self.sizes[0])
        for b in range(lo, hi):  # one after another: a result may be the next one's argument
            parts = [k if len(k) == 1 else k[b : b + 1] for k in rows]
            x = [unlane(k, LANES) for k in parts[:count]]
            for row, value in zip(parts[count:], self.numpy(*x), strict=True):
                fill(row, value)

    def gpu(self, real: str, shared: tuple[int, ...] = ()) -> Any:
        """Return Warp's kernel, one point a thread (`warp_code.launch_graph`).

        Args:
            real: float64 or float32.
            shared: arguments that may have one column for all points.
        """
        from ves_gym.engine.kernel.warp_code import graph_kernel

        key = f"{self.digest} {real} {shared}"
        return build.once(key, lambda: graph_kernel(self.graph, real, shared))

    # ---------------------------------------------------------------------- arrays

    def __call__(self, *x: Array) -> Array:
        """Evaluate at many points, in chunks on all processors.

        Args:
            x: (..., k) each, with the same leading axes; (k,) serves all points.

        Returns:
            (..., m), the results side by side.
        """
        batch = next((part.shape[:-1] for part in x if part.ndim > 1), ())
        count, widths = math.prod(batch), self.sizes[1]
        flat = [
            everywhere(part) if part.ndim == 1 else part.reshape(count, part.shape[-1])
            for part in x
        ]
        out = np.empty((count, sum(widths)))
        size = _CHUNK * LANES

        def evaluate(first: int) -> None:
            n = min(size, count - first)
            rows = [part if part.ndim == 3 else lanes(part[first : first + n]) for part in flat]
            blocks = -(-n // LANES)
            results = [aligned(blocks, k, LANES) for k in widths]
            self.piece(*rows, *results)(0, blocks)
            np.concatenate([unlane(k, n) for k in results], axis=1, out=out[first : first + n])

        starts = range(0, count, size)
        if len(starts) > 1:
            with ThreadPoolExecutor(min(os.cpu_count() or 1, len(starts))) as pool:
                list(pool.map(evaluate, starts))
        elif count:
            evaluate(0)
        return out.reshape(*batch, out.shape[1])

    def over_time(self, x: Array, u: Array, *p: Array) -> Array:
        """Run x[t + 1], y[t] = f(x[t], u[t], p) with a function that works in place.

        Args:
            x: (m, s) first states.
            u: (m, T, k) inputs.
            p: (j,) further arguments.

        Returns:
            y (m, T, q).
        """
        m, length, width = u.shape
        fixed = [everywhere(part) for part in p]
        out = np.empty((m, length, self.sizes[1][1]))
        for first in range(0, m, LANES):
            state, part = lanes(x[first : first + LANES]), u[first : first + LANES]
            rows, y = aligned(length, width, LANES), aligned(length, out.shape[2], LANES)
            rows[:, :, : len(part)] = np.moveaxis(part, 0, 2)
            # instants in place of blocks: they run in order, and the state serves all of them
            self.piece(state, rows, *fixed, state, y)(0, length)
            out[first : first + LANES] = np.moveaxis(y, 2, 0)[: len(part)]
        return out


class Stepper(CompiledFunction):
    """Physics steps of many simulations; raises where nothing compiles.

    Args:
        key: see `CompiledFunction`.
        equations: makes the graphs.
        integrator: rk4, euler or implicitfast.
    """

    def __init__(
        self, key: object, equations: Callable[[], Equations], integrator: str
    ) -> None:
        super().__init__((key, integrator), lambda: self._equations.motion)
        self._trace, self._integrator = equations, integrator

    @cached_property
    def _equations(self) -> Equations:
        return self._trace()

    @property
    def code(self) -> build.MachineCode:
        """The machine code.

        Raises:
            ImportError, RuntimeError, OSError: nothing compiles here.
        """

        def text() -> str:
            from ves_gym.engine.kernel.emit import emit_stepper

            graphs = self._equations
            return emit_stepper(graphs.motion, graphs.observe, self._integrator, graphs.order)

        return build.code(self.digest, text, lambda: self._sizes)

    def steps(
        self,
        x: Array,
        u: Array,
        p: Array,
        out: Array,
        scratch: Array,
        *,
        steps: int,
        h: float,
        strides: tuple[int, int],
        record: bool,
    ) -> Piece:
        """Return some steps as a piece.

        Args:
            x: (blocks, nx, LANES) states, changed.
            u: commands; `strides`: rows from block to block, and from node to node.
            p: (blocks, np, LANES).
            out: (blocks, (steps + 1) ny, LANES) observed; ny rows without `record`.
            scratch: 3 nx + nu rows, of this thread alone.
            steps: how many.
            h: their length [s].
        """
        rows = x, u, p, out, scratch
        bits = int(np.float64(h).view(np.int64))
        words = [*(k.ctypes.data for k in rows), steps, *strides, bits, record]
        return Piece(self.code, words, rows)

    def gpu_steps(self, real: str, record: bool) -> Any:
        """Return Warp's kernel, one simulation a thread (`scalar.advance_text`)."""
        from ves_gym.engine.kernel.warp_code import advance_kernel

        def make() -> Any:
            graphs = self._equations
            observe = graphs.observe if record else None
            return advance_kernel(graphs.motion, observe, self._integrator, graphs.order, real)

        return build.once(f"{self.digest} {real} {record}", make)


class Piece:
    """A function on fixed rows; calling it runs it for the blocks lo to hi.

    Args:
        code: of the function; None where nothing compiles.
        words: its table.
        owners: arrays that the table points into: addresses do not keep memory alive.
        interpreted: (lo, hi) -> None, without code.
    """

    def __init__(
        self,
        code: build.MachineCode | None,
        words: Sequence[int],
        owners: Sequence[Array],
        interpreted: Callable[[int, int], None] | None = None,
    ) -> None:
        self.code, self._owners, self._interpreted = code, owners, interpreted
        self._table: npt.NDArray[np.int64] = np.array(words, np.int64)
        self.where = self._table.ctypes.data

    def __call__(self, lo: int, hi: int) -> None:
        if self.code is not None:
            self.code.run(self.where, lo, hi)
        elif self._interpreted is not None:
            self._interpreted(lo, hi)


class Program:
    """Pieces in order, without a return to Python between; run for the blocks lo to hi.

    Args:
        pieces: what to run.
    """

    def __init__(self, pieces: Sequence[Piece]) -> None:
        self._pieces = tuple(pieces)
        codes = [piece.code for piece in pieces if piece.code is not None]
        self._all: Piece | None = None
        if len(codes) == len(self._pieces):
            program = build.code(build.digest("program"), _program, lambda: ((), ()))
            words = [len(codes)]
            for code, piece in zip(codes, pieces, strict=True):
                words += [code.address, piece.where]
            self._all = Piece(program, words, ())

    def __call__(self, lo: int, hi: int) -> None:
        for piece in (self._all,) if self._all is not None else self._pieces:
            piece(lo, hi)


def _program() -> str:
    from ves_gym.engine.kernel.emit import PROGRAM

    return PROGRAM


def everywhere(values: Array) -> Array:
    """(k,) numbers as rows that serve all blocks."""
    rows = aligned(1, len(values), LANES)
    rows[:] = values[:, None]
    return rows


# -------------------------------- memory: blocks of LANES simulations, a row per quantity


def aligned(*shape: int) -> Array:
    """Zeros whose first element lies on a cache line."""
    size = math.prod(shape)
    raw = np.zeros(size + 8)
    start = (-raw.ctypes.data // 8) % 8
    return raw[start : start + size].reshape(shape)


def fill(rows: Array, values: Array) -> None:
    """Write values into lanes, zeros behind them.

    Args:
        rows: (blocks, k, LANES), written.
        values: (m, k).
    """
    full, remainder = divmod(len(values), LANES)
    if full:
        complete = values[: full * LANES].reshape(full, LANES, values.shape[1])
        rows[:full] = complete.swapaxes(1, 2)
    if full < len(rows):
        rows[full:] = 0.0
        if remainder:
            rows[full, :, :remainder] = values[full * LANES :].T


def put_rows(rows: Array, which: Rows, values: Array) -> None:
    """Write the values of some simulations into lanes.

    Args:
        rows: (blocks, k, LANES), written.
        which: m simulations; a slice stands for all of them.
        values: (m, k).
    """
    if isinstance(which, slice):
        fill(rows, values)
    else:
        rows[which // LANES, :, which % LANES] = values


def lanes(values: Array) -> Array:
    """(n, k) -> (blocks, k, LANES), the last block filled up with zeros."""
    n, k = values.shape
    out = aligned(-(-n // LANES), k, LANES)
    fill(out, values)
    return out


def unlane(rows: Array, n: int) -> Array:
    """Return lanes in plain order, a copy whatever n.

    Args:
        rows: (blocks, k, LANES).
        n: number of points.

    Returns:
        (n, k).
    """
    if n <= LANES:
        return rows[0, :, :n].T.copy()
    plain = rows.swapaxes(1, 2).reshape(len(rows) * LANES, rows.shape[1])
    return plain[:n].copy()


def numbers(rows: Array, n: int) -> Array:
    """Return lanes as a row per quantity, a copy.

    Args:
        rows: (blocks, k, LANES).
        n: number of simulations.

    Returns:
        (k, n).
    """
    if len(rows) == 1:
        return rows[0, :, :n].copy()
    return rows.swapaxes(0, 1).reshape(rows.shape[1], -1)[:, :n]
