"""First layers that begin by looking at the way to the target."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
from gymnasium import spaces

from ves_gym._util.params import ParameterError
from ves_gym.envs.task import Task


def init_goal_difference(
    W: Any, task: Task, space: spaces.Space[Any], length: float, normal: Callable[..., Any]
) -> None:
    """Make a first layer look at the way to the target, in lengths [m].

    Otherwise a network must learn first how much the last centimetres matter and, where it is
    given two places, that their difference alone does.

    Args:
        W: (inputs, units) weights as drawn, changed in place.
        task: whose observations are the inputs.
        space: theirs.
        length: m from the target that count as one.
        normal: of a shape (a, b): that many standard normal numbers.
    """
    parts: dict[str, int]
    if isinstance(space, spaces.Dict):
        parts = {name: spaces.flatdim(box) for name, box in space.spaces.items()}
    else:
        parts = {field.name: field.size for field in task.parts()}
    ends = np.cumsum([0, *parts.values()]).tolist()
    at = {name: slice(*ab) for name, ab in zip(parts, itertools.pairwise(ends), strict=True)}
    if "achieved_goal" in at:
        shape = parts["achieved_goal"], W.shape[1]
        extra = normal(*shape) * W.std(ddof=1, dtype=W.dtype) / length
        W[at["achieved_goal"]] -= extra
        W[at["desired_goal"]] += extra
    elif "to_target" in at:
        scale = next(f.scale for f in task.fields() if f.name == "to_target")
        W[at["to_target"]] *= (scale / length).astype(W.dtype)[:, None]
    else:
        raise ParameterError(
            f"TrainConfig.relative needs a task with a target, got {task.kind}"
        )
