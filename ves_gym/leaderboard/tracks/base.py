"""Parts of every track: letting a method answer, replaying what it answered, its settings."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import gymnasium as gym

from ves_gym._util.params import Array, ParameterError
from ves_gym.baselines.evaluate import settings_of
from ves_gym.envs.build import build_task
from ves_gym.envs.task import Task
from ves_gym.leaderboard.entry import Method, Results
from ves_gym.leaderboard.files import Recording
from ves_gym.leaderboard.problems import Problem, Seeds

CHOICES = ("control", "goal")  # what a method commands and sees

Progress = Callable[[str, float], None]


def no_progress(stage: str, done: float) -> None:
    """Show nothing of the progress."""


class Answers(NamedTuple):
    """Answers of each group and episode, and the seconds of planning, if known."""

    recording: Recording
    seconds: Array | None = None  # (groups, episodes)


@dataclass(frozen=True)
class BoardTrack(ABC):
    """A problem to be answered and replayed; a track's own way is a subclass."""

    problem: Problem
    seeds: Seeds
    method: Method
    workers: int = 1  # processes that plan

    @abstractmethod
    def shape(self) -> tuple[int, ...]:
        """Shape of an answer but for its first axis."""

    @abstractmethod
    def answer(self, agents: Sequence[Any], progress: Progress = no_progress) -> Answers:
        """Let a method answer.

        Args:
            agents: one per group.
            progress: called with the stage and the fraction done.
        """

    @abstractmethod
    def replay(self, recording: Recording) -> Results:
        """Results of recorded answers, by simulation.

        Raises:
            Refused: WRONG_LENGTH, BAD_RECORDING.
        """

    def results(self, answers: Answers) -> Results:
        """Results of answers, with the seconds that they took."""
        results = self.replay(answers.recording)
        return results if answers.seconds is None else {**results, "seconds": answers.seconds}


# ------------------------------------------------------- settings of an environment


def chosen_settings(agent: Any, id: str) -> dict[str, Any]:
    """The settings of an environment that a controller or policy asks for.

    Raises:
        ParameterError: they are not its to choose, or the environment does not take them.
    """
    settings = settings_of(agent, id)
    require_settings(id, settings)
    return settings


def require_settings(id: str, settings: Mapping[str, Any]) -> None:
    """Raise a ParameterError unless these are a method's to choose, and the environment's."""
    unknown = [k for k in settings if k not in CHOICES]
    if unknown:
        raise ParameterError(
            f"a method may choose {', '.join(CHOICES)} of its environment, not"
            f" {unknown[0]!r:.80}"
        )
    if "control" in settings and "control" in gym.spec(id).kwargs:
        raise ParameterError(f"{id} names its control, which stays")
    if not isinstance(settings.get("goal", False), bool):
        raise ParameterError("settings.goal must be a truth value")
    try:
        task = task_of(id, settings)
    except (ValueError, TypeError, OverflowError, ArithmeticError) as error:
        raise ParameterError(f"settings: {error}") from None
    if settings.get("goal") and task.goal_fields is None:
        raise ParameterError(f"task {task.kind} has no goal-conditioned variant")


def task_of(id: str, settings: Mapping[str, Any]) -> Task:
    """The task of an id with a method's settings."""
    kwargs = {**gym.spec(id).kwargs, **settings}
    return build_task(**{k: v for k, v in kwargs.items() if k != "goal"})
