"""Reward and ends of a goal variant from goals and infos: Gymnasium-Robotics' `GoalEnv`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from ves_gym.envs.task import Task


class GoalFunctions:
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
