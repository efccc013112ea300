"""Named arrays of n simulations, in rows for NumPy or in lanes for compiled code."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from ves_gym._util.params import Array, Rows
from ves_gym.engine.kernel.blocks import aligned, fill, put_rows, unlane
from ves_gym.engine.kernel.emit import LANES


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
