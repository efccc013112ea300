"""Settings of an environment that a method may choose: what it commands and what it sees."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym

from ves_gym._util.params import ParameterError
from ves_gym.envs.build import build_task
from ves_gym.envs.task import Task

CHOICES = ("control", "goal")


def chosen_settings(agent: Any, id: str) -> dict[str, Any]:
    """The settings of an environment that a controller or policy asks for.

    Raises:
        ParameterError: they are not its to choose, or the environment does not take them.
    """
    needs = getattr(agent, "settings", None)
    settings: dict[str, Any] = dict(needs(gym.spec(id))) if needs is not None else {}
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
