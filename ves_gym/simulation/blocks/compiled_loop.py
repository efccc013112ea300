"""The wired blocks compiled: half a control period of many simulations in one call.

The text of each block is traced with arrays of symbols and emitted as the engine's equations
are, a simulation per lane; a program calls the blocks in the order of the wiring. Loops share
the code of the blocks that they have in common.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ves_gym._util.params import Array, Index, Rows
from ves_gym.engine.kernel.build import LANES
from ves_gym.engine.kernel.compiled_function import (
    CompiledFunction,
    Piece,
    Program,
    aligned,
    fill,
    put_rows,
    unlane,
)
from ves_gym.engine.kernel.symbolic import column, symbols, traced
from ves_gym.simulation.blocks.block import Block
from ves_gym.simulation.blocks.wiring import NamedArrays, Parameters, Wiring

if TYPE_CHECKING:
    import casadi


class CompiledLoop:
    """Both halves of a wiring on lanes of memory.

    Args:
        wiring: the loop.
        memory: all signals, and what the blocks remember, in lanes.
    """

    def __init__(self, wiring: Wiring, memory: NamedArrays) -> None:
        assert memory.lanes is not None
        self.wiring, self.memory, self.lanes = wiring, memory, memory.lanes
        # which entries of an array are parameters, where zeros are part of the structure
        self._entries: dict[tuple[str, str], Index] = {}
        self._places: dict[tuple[str, str], slice] = {}  # of these in `_p`
        self._halves: dict[str, list[Piece]] = {}
        self._p = aligned(len(self.lanes), 0, LANES)
        self._rows = {name: self.lanes[:, place] for name, place in memory.places.items()}

    def load(self, p: Parameters) -> None:
        """Take parameters, and code that has a place for each of them.

        Args:
            p: (n, ...) of each block.
        """
        before, n = self._entries, self.memory.n
        self._entries = {
            (block.name, name): _entries(
                values, name in block.sparse, before.get((block.name, name))
            )
            for block in self.wiring.blocks
            for name, values in p[block.name].items()
        }
        rows = [
            _flat(p[block][name])[:, entries]
            for (block, name), entries in self._entries.items()
        ]
        ends = np.cumsum([0, *(len(entries) for entries in self._entries.values())]).tolist()
        self._places = dict(zip(self._entries, map(slice, ends[:-1], ends[1:]), strict=True))
        width = ends[-1]
        changed = not self._halves or width != self._p.shape[1]
        if changed:
            self._p = aligned(len(self.lanes), width, LANES)
        fill(self._p, np.concatenate(rows, axis=1) if rows else np.zeros((n, 0)))
        if changed:
            self._halves = self._wired(p)
            self._programs = {half: Program(pieces) for half, pieces in self._halves.items()}

    def change(self, which: Rows, p: Parameters, names: Mapping[str, Iterable[str]]) -> None:
        """Take some parameters of some simulations.

        Args:
            which: simulations.
            p: (n, ...) of each block.
            names: block -> its parameters that have changed.
        """
        keys = [(block, name) for block, those in names.items() for name in those]
        values = {key: _flat(p[key[0]][key[1]]) for key in keys}
        for key, flat in values.items():
            entries = self._entries[key]
            if len(entries) < flat.shape[1] and len(_entries(flat, True, entries)) > len(
                entries
            ):
                self.load(p)  # what the code has left out is zero no longer
                return
        for key, flat in values.items():
            rows = flat[which][:, self._entries[key]]
            put_rows(self._p[:, self._places[key]], which, rows)

    @property
    def parameters(self) -> Array:
        """(blocks, k, LANES) parameters as the code reads them, in place."""
        return self._p

    def _wired(self, p: Parameters) -> dict[str, list[Piece]]:
        """The blocks of both halves on their places in memory."""
        halves: dict[str, list[Piece]] = {}
        at = 0
        for half, blocks in (("before", self.wiring.before), ("after", self.wiring.after)):
            halves[half] = []
            for block in blocks:
                entries = [self._entries[block.name, name] for name in p[block.name]]
                end = at + sum(map(len, entries))
                function = block_function(block, p[block.name], entries, self.memory.shapes)
                halves[half] += self._pieces(block, function, self._p[:, at:end])
                at = end
        return halves

    def _pieces(self, block: Block, function: CompiledFunction, p: Array) -> list[Piece]:
        """A block as often as it repeats; what it stacks goes on from time to time."""
        mine = [self._rows[f"{block.name}.{k}"] for k in block.memory]
        reads = [self._rows[k] for k in block.inputs]
        out = []
        for k in range(block.repeats):
            writes = [self._rows[name] for name in block.outputs]
            if block.repeats > 1:
                writes = [
                    rows[:, k * rows.shape[1] // block.repeats :]
                    if name in block.stacked
                    else rows
                    for name, rows in zip(block.outputs, writes, strict=True)
                ]
            out.append(function.piece(*mine, *reads, p, *mine, *writes))
        return out

    def __call__(self, half: str, external: Mapping[str, Array]) -> None:
        """Run the half "before" or "after" the engine in place, by signals from outside."""
        n = self.memory.n
        for name, values in external.items():
            if name in self._rows:
                rows = self._rows[name]
                fill(rows, values.reshape(n, rows.shape[1]))
        self._programs[half](0, len(self.lanes))

    def pieces(self, half: str) -> list[Piece]:
        """A half as pieces of a program; other ones after `load` (see `version`).

        What it reads from outside and puts out lies in `rows`.
        """
        return self._halves[half]

    @property
    def version(self) -> object:
        """Changes, by identity, when pieces made before are out of date."""
        return self._p

    def rows(self, name: str) -> Array:
        """(blocks, k, LANES) a signal or memory ("block.name") in place."""
        return self._rows[name]

    def signal(self, name: str) -> Array:
        """(n, ...) a signal as it was put out last."""
        values = unlane(self._rows[name], self.memory.n)
        return values.reshape(self.memory.n, *self.memory.shapes[name])


def block_function(
    block: Block,
    p: Mapping[str, Array],
    entries: Sequence[Index],
    shapes: Mapping[str, tuple[int, ...]],
) -> CompiledFunction:
    """(memory, signals, parameters) -> (memory, signals) of a block.

    Args:
        block: whose text is traced.
        p: its parameters (n, ...).
        entries: of each, those that are not zero by structure.
        shapes: of the signals.
    """
    inputs = {name: shapes[name] for name in block.inputs}
    used = [(name, p[name].shape[1:], which) for name, which in zip(p, entries, strict=True)]
    key = (
        type(block).__name__,
        block.structure,
        block.shape,
        {k: memory.shape for k, memory in block.memory.items()},
        inputs,
        block.outputs,
        [(name, shape, which.tolist()) for name, shape, which in used],
    )

    def graph() -> casadi.Function:
        import casadi as ca

        numbers, values = [], {}
        for name, shape, which in used:
            flat = traced(np.zeros(int(np.prod(shape))), (int(np.prod(shape)),))
            flat[which] = symbols(f"p.{name}", (len(which),))
            numbers.append(flat[which])
            values[name] = flat.reshape(1, *shape)
        x = {k: symbols(f"x.{k}", (1, *m.shape)) for k, m in block.memory.items()}
        u = {k: symbols(f"u.{k}", (1, *shape)) for k, shape in inputs.items()}
        x_new, y = block.step(values, x, u)
        arguments = [*x.values(), *u.values()]
        results = [*(x_new[k] for k in x), *(y[k] for k in block.outputs)]
        return ca.Function(
            "block",
            [*(column(k) for k in arguments), column(*numbers)],
            ca.cse([column(k) for k in results]),
        )

    return CompiledFunction(key, graph, in_place=True)


def _flat(values: Array) -> Array:
    """(n, ...) as (n, k)."""
    return values.reshape(len(values), int(np.prod(values.shape[1:])))


def _entries(values: Array, sparse: bool, before: Index | None) -> Index:
    """Entries of an array (n, ...) that are parameters, those from before among them."""
    flat = _flat(values)
    if not sparse:
        return np.arange(flat.shape[1])
    used = (flat != 0).any(axis=0)
    if before is not None:
        used[before] = True
    return np.flatnonzero(used)
