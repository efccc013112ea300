"""The wires: which blocks a loop has, in which order they run, what they hand on, and where."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from ves_gym._util.params import Array, ParameterError, Rows
from ves_gym.engine.kernel.build import LANES
from ves_gym.engine.kernel.compiled_function import aligned, fill, put_rows, unlane
from ves_gym.simulation.blocks.block import (
    TO_ENGINE,
    Block,
    LoopShape,
    Memory,
    Values,
    signal_of,
)

_AT_REST = ("command_sent", "frozen")  # read by safety checks alone
Parameters = Mapping[str, Values]  # block -> its parameters


class Wiring:
    """Blocks in the order of a control period, cut in two by the engine.

    A signal that is read before the period's order puts it out is held over from the period
    before; one that is put out before the engine and read after it is held meanwhile.

    Args:
        before: from the present readings to what the engine's platform is given.
        after: from the engine's wrench to the next readings.
        external: signals that come from outside.
        watched: signals to be held in any case, for others to read.
    """

    def __init__(
        self,
        before: Sequence[Block],
        after: Sequence[Block],
        external: Sequence[str],
        watched: Sequence[str] = (),
    ) -> None:
        self.before, self.after, self.external = tuple(before), tuple(after), tuple(external)
        produced: set[str] = set()
        first = {name for block in self.before for name in block.outputs}
        delayed = dict.fromkeys(watched)
        for block in self.blocks:
            for name in block.inputs:
                signal_of(name)  # refuses an unknown one
                crosses = block in self.after and name in first
                if name not in external and (name not in produced or crosses):
                    delayed[name] = None
            produced.update(block.outputs)
        lacking = [name for name in delayed if name not in produced]
        if lacking:
            raise ParameterError(
                f"signal {lacking[0]!r} is read but no block puts it out: blocks are"
                f" {', '.join(block.name for block in self.blocks)}"
            )
        self.delayed = tuple(delayed)

    @property
    def blocks(self) -> tuple[Block, ...]:
        """All of them, in order."""
        return self.before + self.after

    def block(self, name: str) -> Block:
        """The block of a name."""
        return next(block for block in self.blocks if block.name == name)

    def memories(self) -> dict[str, Memory]:
        """Memory of the blocks, as "block.name"."""
        return {f"{b.name}.{k}": v for b in self.blocks for k, v in b.memory.items()}

    def dynamic(self) -> list[str]:
        """Names of all that the loop acts on from period to period, in a fixed order."""
        names = [name for name, memory in self.memories().items() if memory.feeds_back]
        read = {name for block in self.blocks for name in block.inputs}
        return names + [name for name in self.delayed if name in read and name not in _AT_REST]

    def carried(self, shape: LoopShape) -> dict[str, tuple[int, ...]]:
        """Shapes of all that is carried over: the blocks' memory and the signals held."""
        out = {name: memory.shape for name, memory in self.memories().items()}
        out.update((name, signal_of(name).sized(shape)) for name in self.delayed)
        return out

    def everything(self, shape: LoopShape) -> dict[str, tuple[int, ...]]:
        """Shapes of all that is carried over, then of all other signals."""
        names = dict.fromkeys(self.external)
        for block in self.blocks:
            names.update(dict.fromkeys((*block.inputs, *block.outputs)))
        return self.carried(shape) | {k: signal_of(k).sized(shape) for k in names}

    def run(
        self, blocks: Sequence[Block], p: Parameters, x: Values, external: Values
    ) -> tuple[dict[str, Array], dict[str, Array]]:
        """Run a part of the loop.

        Args:
            blocks: `before` or `after`.
            p: parameters of each block.
            x: what is carried over, by the names of `carried`.
            external: signals from outside.

        Returns:
            What has changed of x, and all signals put out.
        """
        signals: dict[str, Array] = {k: x[k] for k in self.delayed}
        signals.update(external)
        changed: dict[str, Array] = {}
        put_out: dict[str, Array] = {}
        for block in blocks:
            mine = {k: x[f"{block.name}.{k}"] for k in block.memory}
            wires = {k: signals[k] for k in block.inputs}
            new, outputs = _repeated(block, p.get(block.name, {}), mine, wires)
            changed.update((f"{block.name}.{k}", v) for k, v in new.items())
            signals.update(outputs)
            put_out.update(outputs)
        changed.update((k, v) for k, v in put_out.items() if k in self.delayed)
        return changed, put_out

    def describe(self, shape: LoopShape) -> list[dict[str, Any]]:
        """One row per wire: from which block, to which, what it carries, when it arrives."""
        source = {name: signal_of(name).outside for name in self.external}
        source.update((name, block.name) for block in self.blocks for name in block.outputs)
        ends = [(block.name, block.inputs, block.outputs) for block in self.blocks]
        at_once, rows = set(self.external), []
        ends.append(("engine", tuple(name for name in TO_ENGINE if name in source), ()))
        for reader, inputs, outputs in ends:
            for name in inputs:
                signal = signal_of(name)
                rows.append(
                    {
                        "from": source[name],
                        "to": reader,
                        "signal": name,
                        "shape": list(signal.sized(shape)),
                        "unit": signal.unit,
                        "frame": signal.frame,
                        "when": "at once" if name in at_once else "a period later",
                        "meaning": signal.meaning,
                    }
                )
            at_once.update(outputs)
        return rows

    def describe_blocks(self, p: Parameters) -> list[dict[str, Any]]:
        """One row per block: its name, its purpose, and the shapes of its numbers.

        Args:
            p: parameters of each block, (n, ...).
        """
        return [
            {
                "name": block.name,
                "runs": "before engine" if block in self.before else "after engine",
                "times": block.repeats,  # in a control period
                "compiles": block.compiles,
                "summary": block.summary,
                "parameters": {k: list(v.shape[1:]) for k, v in p[block.name].items()},
                "memory": {k: list(v.shape) for k, v in block.memory.items()},
            }
            for block in self.blocks
        ]


def _repeated(
    block: Block, p: Values, x: Values, u: Values
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Memory and outputs of a block after all its steps in a period."""
    new, outputs = block.step(p, x, u)
    stacks = {name: [outputs[name]] for name in block.stacked}
    for _ in range(block.repeats - 1):
        new, outputs = block.step(p, new, u)
        for name, parts in stacks.items():
            parts.append(outputs[name])
    outputs.update((k, np.concatenate(parts, axis=1)) for k, parts in stacks.items())
    return new, outputs


class NamedArrays:
    """Arrays (n, ...) by name: the state of a loop, all that a snapshot has to hold.

    In rows each is an array of its own. In lanes they lie in one piece of memory as the
    compiled tick wants it, and reading one copies it out.
    """

    def __init__(self, shapes: Mapping[str, tuple[int, ...]], n: int, lanes: bool) -> None:
        self.n, self.shapes = n, dict(shapes)
        sizes = [int(np.prod(shape)) for shape in self.shapes.values()]
        ends = np.cumsum([0, *sizes]).tolist()
        self.places = {
            name: slice(a, b)
            for name, a, b in zip(self.shapes, ends[:-1], ends[1:], strict=True)
        }
        self.size = ends[-1]
        self.lanes: Array | None = None
        self._rows: dict[str, Array] = {}
        if lanes:
            self.lanes = aligned(-(-n // LANES), self.size, LANES)
        else:
            self._rows = {k: np.zeros((n, *shape)) for k, shape in self.shapes.items()}

    def __contains__(self, name: str) -> bool:
        return name in self.shapes

    def __getitem__(self, name: str) -> Array:
        """(n, ...); not to be written to."""
        if self.lanes is None:
            return self._rows[name]
        rows = unlane(self.lanes[:, self.places[name]], self.n)
        return rows.reshape(self.n, *self.shapes[name])

    def __setitem__(self, name: str, values: Array) -> None:
        if self.lanes is None:
            self._rows[name] = np.asarray(values, dtype=np.float64)
        else:
            rows = self.lanes[:, self.places[name]]
            fill(rows, values.reshape(self.n, rows.shape[1]))

    def put(self, rows: Rows, name: str, values: Array) -> None:
        """Write rows.

        Args:
            rows: which m simulations.
            name: of the array.
            values: (m, ...).
        """
        if self.lanes is None:
            changed = self._rows[name].copy()
            changed[rows] = values
            self._rows[name] = changed
        else:
            flat = values.reshape(len(values), int(np.prod(self.shapes[name])))
            put_rows(self.lanes[:, self.places[name]], rows, flat)

    def take_over(
        self, earlier: Mapping[str, Array], shapes: Mapping[str, tuple[int, ...]]
    ) -> None:
        """Carry on from the memory of a loop with other arrays, or shorter or longer ones.

        Args:
            earlier: (n, ...) by name.
            shapes: of a simulation's arrays that are carried on, by name.
        """
        for name, shape in shapes.items():
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
            self[name] = value

    def copied(self, names: Iterable[str]) -> dict[str, Array]:
        """Copies of some arrays."""
        return {name: np.array(self[name]) for name in names}
