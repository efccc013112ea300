"""Spaces of a task's observation, and the checks every environment shares."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt

from ves_gym._util.params import ParameterError
from ves_gym.envs.task import Task


def observation_space(task: Task) -> gym.spaces.Box:
    """All fields one after another, in their scales."""
    size = sum(f.size for f in task.parts())
    return gym.spaces.Box(-task.CLIP, task.CLIP, (size,), np.float32)


def goal_space(task: Task, space: gym.spaces.Box) -> gym.spaces.Dict:
    """Observation, achieved and desired goal of a goal-conditioned task."""
    if task.goal_fields is None:
        raise ParameterError(f"task {task.kind} has no goal-conditioned variant")
    parts = task.columns
    goals = [parts[name] for name in task.goal_fields]
    size = goals[0].stop - goals[0].start
    remaining = space.shape[0] - sum(k.stop - k.start for k in goals)
    box = lambda n: gym.spaces.Box(-task.CLIP, task.CLIP, (n,), np.float32)  # noqa: E731
    return gym.spaces.Dict(
        {"observation": box(remaining), "achieved_goal": box(size), "desired_goal": box(size)}
    )


def split_goals(task: Task, row: npt.NDArray[np.float32]) -> dict[str, npt.NDArray[np.float32]]:
    """(..., size) observation as the dictionary of `goal_space`."""
    assert task.goal_fields is not None
    parts = task.columns
    achieved, desired = (row[..., parts[name]] for name in task.goal_fields)
    observed = [row[..., k] for name, k in parts.items() if name not in task.goal_fields]
    return {  # in the order of the space
        "achieved_goal": achieved.copy(),
        "desired_goal": desired.copy(),
        "observation": np.concatenate(observed, axis=-1),
    }


def require_seed(seed: Any) -> None:
    """Seeds are whole numbers >= 0 and below 2**64."""
    integral = isinstance(seed, (int, np.integer)) and not isinstance(seed, bool)
    if not integral or not 0 <= seed < 2**64:
        raise gym.error.Error(f"seed must be a whole number in [0, 2**64), got {seed!r}")


def require_index(index: Any) -> int:
    """Which of a seed's simulations: a whole number >= 0."""
    integral = isinstance(index, (int, np.integer)) and not isinstance(index, bool)
    if not integral or not 0 <= index < 2**63:
        raise ParameterError(f"reset: index must be a whole number >= 0, got {index!r}")
    return int(index)
