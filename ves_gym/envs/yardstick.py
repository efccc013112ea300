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

_AT_ONCE = 16  # episodes: more are hardly faster, fewer wait for the same steps


def yardstick_of(batch: Batch, **engine: Any) -> Batch | None:
    """Return a batch for the yardstick's episodes; None where the task needs none.

    Args:
        batch: whose episodes are to be judged.
        engine: keywords of the `Batch`.
    """
    task = batch.task.yardstick
    if task is None:
        return None
    with warnings.catch_warnings():  # said of the batch itself
        warnings.simplefilter("ignore", EmulationWarning)
        return type(batch)(task, min(batch.n, _AT_ONCE), **engine)


def energies(model: Batch, keys: npt.NDArray[np.uint64], options: Mapping[str, Array]) -> Array:
    """Return E_mean of episodes without action [J]; NaN where one failed.

    Args:
        model: of `yardstick_of`.
        keys: (k, 3) seed, index and number of the episodes (`Batch.episode_ids`).
        options: what was chosen of their starts, (k, ...) each.

    Returns:
        (k,).
    """
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
