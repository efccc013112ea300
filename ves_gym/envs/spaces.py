"""Spaces of a task's observation, its goals, and the checks every environment shares."""

from __future__ import annotations

from collections.abc import Callable, Mapping
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


class GoalFunctions:  # Gymnasium-Robotics' `GoalEnv`
    """Reward, termination and truncation of steps whose goals were others.

    Every function takes `achieved_goal` and `desired_goal` (..., g) in the units of the
    observation and `info`, that of the step or any sequence (...,) of them, and returns (...,).
    With the goals and the info of a step they return what the step did. No goal ends an
    episode: its deadline and its failures do, of which only the info tells; an info that
    tells nothing is that of a step in the middle of an episode.
    """

    def __init__(self, task: Task) -> None:
        self.task = task

    def compute_reward(
        self, achieved_goal: npt.ArrayLike, desired_goal: npt.ArrayLike, info: Any
    ) -> Any:
        """Return the reward of goals, and of the failure that the info tells of."""
        reward = self.task.goal_reward(np.asarray(achieved_goal), np.asarray(desired_goal))
        failure = self._each(info, reward, _failure)
        return reward + failure if failure.any() else reward

    def compute_terminated(
        self, achieved_goal: npt.ArrayLike, desired_goal: npt.ArrayLike, info: Any
    ) -> Any:
        """Return where an episode has failed, or is at a deadline that terminates it."""
        by_deadline = self.task.ends == "terminated"
        return self._ended(desired_goal, info, lambda k: by_deadline or _failure(k) < 0)

    def compute_truncated(
        self, achieved_goal: npt.ArrayLike, desired_goal: npt.ArrayLike, info: Any
    ) -> Any:
        """Return where an episode is at a deadline that truncates it."""
        by_deadline = self.task.ends == "truncated"
        return self._ended(desired_goal, info, lambda k: by_deadline and not _failure(k) < 0)

    def _ended(
        self, goal: npt.ArrayLike, info: Any, so: Callable[[Mapping[str, Any]], bool]
    ) -> Any:
        like = np.zeros(np.shape(goal)[:-1])
        # energies come with the last step only
        ended = self._each(info, like, lambda k: "energy/E_mean" in k and so(k))
        return ended.astype(bool)[()]

    def _each(
        self, info: Any, like: npt.ArrayLike, number: Callable[[Mapping[str, Any]], float]
    ) -> npt.NDArray[np.float64]:
        """Numbers of infos in the shape of `like`."""
        shape = np.shape(like)
        if isinstance(info, Mapping) or info is None:
            return np.full(shape, number(info or {}), dtype=np.float64)
        rows = [number(k) for k in np.asarray(info, dtype=object).ravel()]
        return np.array(rows, dtype=np.float64).reshape(shape)


def _failure(info: Mapping[str, Any]) -> float:
    return float(info.get("reward/failure", 0.0))
