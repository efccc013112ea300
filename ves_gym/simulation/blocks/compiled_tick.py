"""The wired blocks compiled: one half of a control period for many simulations at once.

The text of the blocks is traced with arrays of symbols and emitted as the engine's equations
are, a simulation per lane. A block that cannot be traced keeps the whole loop in NumPy.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ves_gym._util import array_functions
from ves_gym._util.params import Array, Index
from ves_gym.engine.kernel.blocks import aligned, fill, unlane
from ves_gym.engine.kernel.build import Library, cached
from ves_gym.engine.kernel.emit import LANES, emit_tick
from ves_gym.engine.kernel.graph_arrays import GRAPH, column, symbols
from ves_gym.simulation.blocks.block import SIGNALS, Block
from ves_gym.simulation.blocks.memory import NamedArrays
from ves_gym.simulation.blocks.wiring import Parameters, Wiring

if TYPE_CHECKING:
    import casadi

_LIBRARIES: dict[str, Library] = {}


class CompiledTick:
    """Half a period of a wiring, `before` or `after` the engine.

    Args:
        wiring: the loop.
        blocks: its half.
        given: signals from outside that this half reads.
        wanted: signals to hand out.
        sizes: nodes and joints.
        memory: what is carried over, in lanes.
    """

    def __init__(
        self,
        wiring: Wiring,
        blocks: Sequence[Block],
        given: Sequence[str],
        wanted: Sequence[str],
        sizes: tuple[int, int],
        memory: NamedArrays,
    ) -> None:
        self.wiring, self.blocks, self.memory = wiring, tuple(blocks), memory
        self.given = {k: SIGNALS[k].sized(*sizes) for k in given}
        self.wanted = {k: SIGNALS[k].sized(*sizes) for k in wanted}
        self._count = -(-memory.n // LANES)
        self._in, self._inputs = _rows(self.given, self._count)
        self._out, self._outputs = _rows(self.wanted, self._count)
        self._entries: dict[tuple[str, str], Index] = {}  # which entries are parameters
        self._library: Library | None = None
        self._p = aligned(self._count, 0, LANES)

    def load(self, p: Parameters) -> None:
        """Take parameters, and code that has a place for each of them.

        Args:
            p: (n, ...) of each block.
        """
        known = self._entries
        self._entries = {
            (block.name, name): _entries(
                values, name in block.sparse, known.get((block.name, name))
            )
            for block in self.blocks
            for name, values in p[block.name].items()
        }
        rows = [
            _flat(p[block][name])[:, entries]
            for (block, name), entries in self._entries.items()
        ]
        width = sum(row.shape[1] for row in rows)
        changed = self._library is None or width != self._p.shape[1]
        if changed:
            self._p = aligned(self._count, width, LANES)
        fill(self._p, np.concatenate(rows, axis=1) if rows else np.zeros((self.memory.n, 0)))
        if changed:
            self._library = _library(self._key(p), lambda: self._graph(p))

    def _key(self, p: Parameters) -> str:
        """Everything that the code depends on."""
        what = (
            [(type(b).__name__, b.name, b.inputs, b.structure) for b in self.blocks],
            {k: (v.tolist(), p[k[0]][k[1]].shape[1:]) for k, v in self._entries.items()},
            self.memory.shapes,
            self.given,
            self.wanted,
        )
        return f"tick {_source()} {what!r}"

    def _graph(self, p: Parameters) -> casadi.Function:
        """Trace the blocks: (memory, given, parameters) -> (memory, wanted)."""
        import casadi as ca

        traced: dict[str, dict[str, Array]] = {block.name: {} for block in self.blocks}
        numbers = []
        for (block, name), entries in self._entries.items():
            shape = p[block][name].shape[1:]
            flat = np.empty(int(np.prod(shape)), object)
            flat[:] = 0.0
            flat[entries] = symbols(f"{block}.{name}", (len(entries),))
            numbers.append(flat[entries])
            traced[block][name] = flat.reshape(1, *shape)
        memory = {k: symbols(k, (1, *shape)) for k, shape in self.memory.shapes.items()}
        given = {k: symbols(k, (1, *shape)) for k, shape in self.given.items()}
        changed, out = self.wiring.run(self.blocks, GRAPH, traced, memory, given)
        after = [changed.get(k, memory[k]) for k in memory]
        return ca.Function(
            "tick",
            [column(list(memory.values())), column(list(given.values())), column(numbers)],
            [ca.cse(column(after)), ca.cse(column([out[k] for k in self.wanted]))],
        )

    def __call__(self, given: Mapping[str, Array]) -> dict[str, Array]:
        """Run it for all simulations; the memory moves on.

        Args:
            given: (n, ...) signals from outside.

        Returns:
            (n, ...) the signals wanted.
        """
        memory = self.memory
        assert self._library is not None and memory.lanes is not None
        for name, rows in self._inputs.items():
            fill(rows, given[name].reshape(memory.n, rows.shape[1]))
        arrays = (memory.lanes, self._in, self._p, memory.spare, self._out)
        self._library.tick(*(a.ctypes.data for a in arrays), 0, self._count)
        memory.swap()
        return {
            name: unlane(rows, memory.n).reshape(memory.n, *self.wanted[name])
            for name, rows in self._outputs.items()
        }


def _rows(shapes: Mapping[str, tuple[int, ...]], blocks: int) -> tuple[Array, dict[str, Array]]:
    """Memory in lanes for signals, and the part of it that is each one's."""
    sizes = [int(np.prod(shape)) for shape in shapes.values()]
    ends = np.cumsum([0, *sizes]).tolist()
    rows = aligned(blocks, ends[-1], LANES)
    places = zip(shapes, ends[:-1], ends[1:], strict=True)
    return rows, {name: rows[:, low:high] for name, low, high in places}


def _flat(values: Array) -> Array:
    """(n, ...) as (n, k)."""
    return values.reshape(len(values), int(np.prod(values.shape[1:])))


def _entries(values: Array, sparse: bool, known: Index | None) -> Index:
    """Entries of an array (n, ...) that are parameters, those known before among them."""
    flat = _flat(values)
    if not sparse:
        return np.arange(flat.shape[1])
    some = (flat != 0).any(axis=0)
    if known is not None:
        some[known] = True
    return np.flatnonzero(some)


def _library(key: str, graph: Any) -> Library:
    if key not in _LIBRARIES:
        _LIBRARIES[key] = cached(key, lambda: emit_tick(graph()))
    return _LIBRARIES[key]


@lru_cache(maxsize=1)
def _source() -> str:
    """Digest of every text that may be traced, so that a changed one is compiled anew."""
    root = Path(array_functions.__file__).parent.parent
    folders = ("mechanics", "hardware", "simulation/blocks", "engine/kernel")
    files = [root / "_util" / "array_functions.py"]
    files += [path for folder in folders for path in sorted((root / folder).glob("*.py"))]
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()
