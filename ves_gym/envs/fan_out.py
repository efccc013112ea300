"""One environment's state in every simulation of a batch, for model-predictive control."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym.envs.batch import Batch


def fan_out(model: Batch, source: Batch, i: int) -> None:
    """Put every simulation of `model` where simulation i of `source` is.

    A model of the same task takes over everything, what was drawn and the random generator
    included: it goes on as the source would. A model of another description
    (mode, vehicle, effects, errors) takes over what a controller can know: joints, reference,
    goal, sums of the episode, and the base as it is *measured*; internal modes are carried
    along by the base, and the sensors and the platform of an emulated model start anew.

    Args:
        model: of any number of simulations; written.
        source: read.
        i: which of its simulations.

    Raises:
        ParameterError: no such simulation, or a model of another kind of task, control,
            duration, control period or number of joints; the model is as it was then.
    """
    if not 0 <= i < source.n:
        raise ParameterError(f"fan_out needs an environment of 0 to {source.n - 1}, got {i}")
    if model.task == source.task:
        task, kept, snapshot, _ = source.get_state()
        scene, episodes, drawn = kept
        parts = _rows(scene, i, model.n), _rows(episodes, i, model.n), _rows(drawn, i, model.n)
        recorded = None if model.recorder is None else model.recorder.get_state()
        model.set_state((task, parts, snapshot.fanned_out(i, model.n), recorded))
        return
    for name, ours, theirs in (
        ("task", model.task.kind, source.task.kind),
        ("control", model.task.control, source.task.control),
        ("duration", model.task.duration, source.task.duration),
        ("control period", model.dt, source.dt),
        ("joints", model.system.arm.n, source.system.arm.n),
    ):
        if ours != theirs:
            raise ParameterError(
                f"fan_out needs a model of the same {name}, {theirs!r}, got {ours!r}"
            )
    scene, episodes = (_rows(k, i, model.n) for k in (source.scene, source.episodes))
    model.begin_at(scene, episodes)


def _rows(part: Any, i: int, n: int) -> Any:
    """Row i of every array of a dataclass or dictionary, n times."""
    if isinstance(part, dict):
        return {name: _repeated(k, i, n) for name, k in part.items()}
    fields = (f.name for f in dataclasses.fields(part))
    return dataclasses.replace(
        part, **{name: _repeated(getattr(part, name), i, n) for name in fields}
    )


def _repeated(array: Any, i: int, n: int) -> Array:
    out: Array = np.repeat(array[i : i + 1], n, axis=0)
    return out
