"""The energy that a success is measured by, where the machine is drawn: simulated at resets.

A task's estimate of an energy is of the machine as described. On one that was drawn otherwise,
with another payload or errors of a laboratory, episodes of `Task.yardstick` tell what no action
leaves on the very machine: the same seeds, so the same draws, start and noise.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array
from ves_gym.simulation.loop_linearisation import EmulationWarning

if TYPE_CHECKING:
    from ves_gym.envs.batch import Batch

_FEWEST, _MOST = 8, 64  # episodes at once: fewer take as long, more are no faster each
_Key = tuple[int, ...]  # seed, index and number of an episode


class Yardstick:
    """E_mean of episodes without action, for a batch's episodes.

    Which episode follows which is known beforehand. So that simulations whose episodes end at
    different times do not wait for their energies one by one, those of episodes to come are
    simulated beside the ones that are asked for; the numbers do not depend on it.

    Args:
        model: a batch of the yardstick's task.
    """

    def __init__(self, model: Batch) -> None:
        self._model = model
        self._ahead: dict[_Key, float] = {}

    def __call__(
        self,
        keys: npt.NDArray[np.uint64],
        everyone: npt.NDArray[np.uint64],
        options: Mapping[str, Array],
    ) -> Array:
        """Return the energies [J]; NaN where such an episode failed.

        Args:
            keys: (k, 3) seed, index and number of the episodes (`Batch.episode_ids`).
            everyone: (n, 3) those of all present episodes of the batch, these among them.
            options: what was chosen of the starts, (k, ...) each.

        Returns:
            (k,).
        """
        if options:
            return _energies(self._model, keys, options)
        asked: list[_Key] = [tuple(key) for key in keys.tolist()]
        missing = [key for key in dict.fromkeys(asked) if key not in self._ahead]
        if missing:
            if keys[:, 2].any():  # not the first episodes of a seed: others will follow
                missing += self._following(everyone, -len(missing) % self._model.n)
            energies = _energies(self._model, np.array(missing, np.uint64), {})
            self._ahead.update(zip(missing, energies.tolist(), strict=True))
        out = np.array([self._ahead[key] for key in asked])
        for key in set(asked):
            del self._ahead[key]
        if len(self._ahead) > 2 * (len(everyone) + _MOST):  # of seeds that were left
            self._ahead.clear()
        return out

    def _following(self, everyone: npt.NDArray[np.uint64], count: int) -> list[_Key]:
        """So many episodes that come next and are not simulated yet."""
        out: list[_Key] = []
        present = np.unique(everyone, axis=0).tolist()
        for later in range(1, count + 1):
            for root, index, number in present:
                if len(out) == count:
                    return out
                key = (root, index, number + later)
                if key not in self._ahead:
                    out.append(key)
        return out


def yardstick_of(batch: Batch, **engine: Any) -> Yardstick | None:
    """Return what measures a batch's episodes; None where its task needs nothing.

    Args:
        batch: whose episodes are to be judged.
        engine: keywords of the `Batch`.
    """
    task = batch.task.yardstick
    if task is None:
        return None
    with warnings.catch_warnings():  # said of the batch itself
        warnings.simplefilter("ignore", EmulationWarning)
        model = type(batch)(task, min(max(batch.n, _FEWEST), _MOST), **engine)
    everyone = np.arange(model.n)
    model.seed(everyone, 0, everyone)
    model.reset(everyone)  # the first reset must include every simulation
    return Yardstick(model)


def _energies(
    model: Batch, keys: npt.NDArray[np.uint64], options: Mapping[str, Array]
) -> Array:
    """E_mean (k,) of episodes (k, 3), as many at once as the model has simulations."""
    out = np.full(len(keys), np.nan)
    for first in range(0, len(keys), model.n):
        part = slice(first, first + model.n)
        out[part] = _play(model, keys[part], {name: v[part] for name, v in options.items()})
    return out


def _play(model: Batch, keys: npt.NDArray[np.uint64], options: Mapping[str, Array]) -> Array:
    ids = np.arange(len(keys))
    model.seed(ids, keys[:, 0], keys[:, 1])
    model.episodes.number[ids] = keys[:, 2].astype(np.int64) - 1  # `reset` begins the next one
    model.reset(ids, options)
    out, over = np.full(model.n, np.nan), np.arange(model.n) >= len(keys)
    still = np.zeros((model.n, model.width))
    while not over.all():
        _, terminated, truncated, info = model.step(still, over)
        ended = (terminated | truncated) & ~over
        if ended.any():
            complete = ended & (info["reward/failure"] == 0)
            out[complete] = info["energy/E_mean"][complete]
            over |= ended
    return out[ids]
