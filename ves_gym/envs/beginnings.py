"""Beginnings of episodes, drawn ahead for many simulations at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from ves_gym._util.params import Array, Index
from ves_gym.envs.episode import Episodes
from ves_gym.envs.task import Start, Task

_AT_ONCE = 64  # a call costs as much as ten beginnings


class Beginnings:
    """What the simulations' next episodes begin with.

    Random numbers are those of an episode's seed, index and number, so that it begins alike
    whatever else is drawn. Where one simulation ends after another, the beginnings of others
    are drawn together with its own.

    Args:
        task: what the episodes ask.
        n: number of simulations.
        extra: uniform numbers per episode beside the task's.
        complete: (k beginnings) -> all that is needed of them, (k, ...) by name.
    """

    def __init__(
        self, task: Task, n: int, extra: int, complete: Callable[[Start], dict[str, Array]]
    ) -> None:
        self.task, self.n, self.complete = task, n, complete
        self.uniform = np.empty((n, task.draws + extra))
        self.generators: list[np.random.Generator | None] = [None] * n
        self._ready = np.zeros(n, bool)
        self._rows: dict[str, Array] = {}

    def forget(self, ids: Index) -> None:
        """Draw the next episodes of some simulations anew."""
        self._ready[ids] = False

    def take(
        self, ids: Index, e: Episodes, options: Mapping[str, Array] | None = None
    ) -> dict[str, Array]:
        """Return what the episodes (k,) begin with; it is theirs once.

        Args:
            ids: simulations, k of them.
            e: counters; `number` is that of the episode before.
            options: chosen instead of drawn, see `Task.start`.
        """
        late = ids[~self._ready[ids]]
        if options:
            self._draw(late, e)
            self._ready[ids] = False
            return self.complete(self._start(ids, options))
        if len(late):
            if e.number[late].min() >= 0 and len(late) < _AT_ONCE:
                self._ready[ids] = True  # not to be drawn twice
                others = np.flatnonzero(~self._ready)[: _AT_ONCE - len(late)]
                self._ready[late] = False
                late = np.concatenate([late, others])
            self._draw(late, e)
            rows = self.complete(self._start(late, {}))
            for name, values in rows.items():
                if name not in self._rows:
                    self._rows[name] = np.zeros((self.n, *values.shape[1:]), values.dtype)
                self._rows[name][late] = values
            self._ready[late] = True
        self._ready[ids] = False
        return {name: values[ids] for name, values in self._rows.items()}

    def _draw(self, ids: Index, e: Episodes) -> None:
        """Uniform numbers of the next episodes, and the generators that go on from there."""
        keys = np.stack([k[ids].astype(np.uint64) for k in (e.root, e.index, e.number + 1)], 1)
        # words are what NumPy makes of such numbers, more slowly
        words = keys.astype(np.uint32) if (keys < 2**32).all() else keys.tolist()
        for i, key in zip(ids.tolist(), words, strict=True):
            generator = np.random.Generator(np.random.PCG64(np.random.SeedSequence(key)))
            generator.random(out=self.uniform[i])
            self.generators[i] = generator

    def _start(self, ids: Index, options: Mapping[str, Array]) -> Start:
        return self.task.start(self.uniform[ids, : self.task.draws], **options)
