"""The wired blocks compiled: half a control period of many simulations in one call.

The text of each block is traced with arrays of symbols and emitted as the engine's equations
are, a simulation per lane; a small driver calls the blocks in the order of the wiring. Machine
code is stored block by block, so that loops share what they have in common.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ves_gym._util.params import Array, Index, Rows
from ves_gym.engine.kernel.blocks import aligned, fill, put_rows, unlane
from ves_gym.engine.kernel.build import Library, linked
from ves_gym.engine.kernel.emit import LANES, Call, emit_driver, emit_shared
from ves_gym.engine.kernel.pieces import LoopPiece
from ves_gym.engine.kernel.symbolic import column, symbols, traced
from ves_gym.simulation.blocks.block import Block
from ves_gym.simulation.blocks.memory import NamedArrays
from ves_gym.simulation.blocks.wiring import Parameters, Wiring

if TYPE_CHECKING:
    import casadi

_LIBRARIES: dict[str, Library] = {}


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
        self._library: Library | None = None
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
        changed = self._library is None or width != self._p.shape[1]
        if changed:
            self._p = aligned(len(self.lanes), width, LANES)
        fill(self._p, np.concatenate(rows, axis=1) if rows else np.zeros((n, 0)))
        if changed:
            self._library = self._linked(p)

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

    def _linked(self, p: Parameters) -> Library:
        """The machine code of both halves."""
        halves: dict[str, list[Call]] = {"before": [], "after": []}
        makers, at = {}, 0
        for half, blocks in (("before", self.wiring.before), ("after", self.wiring.after)):
            for block in blocks:
                code = _BlockCode(block, p[block.name], self._entries, self.memory.shapes)
                makers[code.name] = code.text
                halves[half].append(self._call(code, at))
                at += code.width
        sizes = (self.memory.size, self._p.shape[1])
        key = repr((halves, sizes))
        if key not in _LIBRARIES:
            _LIBRARIES[key] = linked(emit_driver(halves, *sizes), makers)
        return _LIBRARIES[key]

    def _call(self, code: _BlockCode, at: int) -> Call:
        """Return the places of a block's arrays; `at`: the first row of its parameters."""
        places, block = self.memory.places, code.block
        mine = [places[f"{block.name}.{k}"].start for k in block.memory]
        reads = [places[k].start for k in block.inputs]
        writes = [places[k].start for k in block.outputs]
        sizes = [places[k].stop - places[k].start for k in block.outputs]
        steps = [
            size // block.repeats if name in block.stacked else 0
            for name, size in zip(block.outputs, sizes, strict=True)
        ]
        return Call(
            name=code.name,
            inputs=(*mine, *reads),
            parameters=at,
            outputs=(*mine, *writes),
            advance=(*(0 for _ in mine), *steps),
            repeats=block.repeats,
        )

    def __call__(self, half: str, external: Mapping[str, Array]) -> None:
        """Run a half for all simulations, in place.

        Args:
            half: "before" or "after" the engine.
            external: (n, ...) signals from outside.
        """
        assert self._library is not None
        n = self.memory.n
        for name, values in external.items():
            if name in self._rows:
                rows = self._rows[name]
                fill(rows, values.reshape(n, rows.shape[1]))
        run = self._library.before if half == "before" else self._library.after
        run(self.lanes.ctypes.data, self._p.ctypes.data, 0, len(self.lanes))

    def piece(self, half: str) -> LoopPiece:
        """A half as a piece of a program; another one after `load` (see `version`).

        What it reads from outside and puts out lies in `rows`.

        Args:
            half: "before" or "after" the engine.
        """
        assert self._library is not None
        return LoopPiece(self._library, half, self.lanes, self._p)

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


class _BlockCode:
    """One block's function: (memory, signals, parameters) -> (memory, signals)."""

    def __init__(
        self,
        block: Block,
        p: Mapping[str, Array],
        entries: Mapping[tuple[str, str], Index],
        shapes: Mapping[str, tuple[int, ...]],
    ) -> None:
        self.block = block
        self._parameters = {
            name: (values.shape[1:], entries[block.name, name]) for name, values in p.items()
        }
        self._inputs = {name: shapes[name] for name in block.inputs}
        self.width = sum(len(which) for _, which in self._parameters.values())
        what = (
            type(block).__name__,
            block.structure,
            block.shape,
            {k: memory.shape for k, memory in block.memory.items()},
            self._inputs,
            block.outputs,
            {k: (shape, which.tolist()) for k, (shape, which) in self._parameters.items()},
        )
        digest = hashlib.sha256(f"{_source()} {what!r}".encode()).hexdigest()
        self.name = f"block_{digest[:32]}"

    def text(self) -> str:
        """The LLVM module."""
        return emit_shared(self.name, self._graph())

    def _graph(self) -> casadi.Function:
        import casadi as ca

        block = self.block
        numbers, p = [], {}
        for name, (shape, which) in self._parameters.items():
            flat = traced(np.zeros(int(np.prod(shape))), (int(np.prod(shape)),))
            flat[which] = symbols(f"p.{name}", (len(which),))
            numbers.append(flat[which])
            p[name] = flat.reshape(1, *shape)
        x = {k: symbols(f"x.{k}", (1, *m.shape)) for k, m in block.memory.items()}
        u = {k: symbols(f"u.{k}", (1, *shape)) for k, shape in self._inputs.items()}
        x_new, y = block.step(p, x, u)
        inputs = [*x.values(), *u.values()]
        outputs = [*(x_new[k] for k in x), *(y[k] for k in block.outputs)]
        return ca.Function(
            "block",
            [*(column(k) for k in inputs), column(*numbers)],
            ca.cse([column(k) for k in outputs]),
        )


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


@lru_cache(maxsize=1)
def _source() -> str:
    """Digest of every text that may be traced, so that a changed one is compiled anew."""
    root = Path(__file__).parents[2]
    folders = ("mechanics", "hardware", "simulation/blocks")
    files = [path for folder in folders for path in sorted((root / folder).glob("*.py"))]
    files += [root / "engine/kernel" / name for name in ("emit.py", "symbolic.py", "trace.py")]
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()
