"""What an environment returns: its spaces and goals, rewards by objective, costs.

The vector of objectives follows MO-Gymnasium: `reward_space` has its shape, `step` returns an
array. The costs follow Safety-Gymnasium: `info["cost_NAME"]` is 1 in every period in which a
bound was exceeded, and `info["cost"]` where any was.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt

from ves_gym._util.params import (
    Array,
    Mask,
    ParameterError,
    from_plain,
    integer,
    require_positive,
    unit,
)
from ves_gym.envs.batch import Batch
from ves_gym.envs.task import Task

OBJECTIVES = ("energy", "time", "error")
WEIGHTS = (1.0, 0.0, 1.0)  # by which they add up to the scalar reward
FORMS = ("scalar", "vector")


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
    return integer(index, "reset: index")


class GoalFunctions:  # Gymnasium-Robotics' `GoalEnv`
    """Reward, termination and truncation of steps whose goals were others.

    Every function takes `achieved_goal` and `desired_goal` (..., g) in the units of the
    observation and `info`, that of the step or any sequence (...,) of them, and returns (...,).
    With the goals and the info of a step they return what the step did. No goal ends an
    episode: its deadline and its failures do, which only the info shows; an info that
    shows none is that of a step in the middle of an episode.
    """

    def __init__(self, task: Task) -> None:
        self.task = task

    def compute_reward(
        self, achieved_goal: npt.ArrayLike, desired_goal: npt.ArrayLike, info: Any
    ) -> Any:
        """Return the reward of goals, and of the failure in the info."""
        reward = self.task.goal_reward(np.asarray(achieved_goal), np.asarray(desired_goal))
        failure = self._per_simulation(info, reward, _failure)
        return reward + failure if failure.any() else reward

    def compute_terminated(
        self, achieved_goal: npt.ArrayLike, desired_goal: npt.ArrayLike, info: Any
    ) -> Any:
        """Return where an episode has failed, or is at its deadline."""
        like = np.zeros(np.shape(desired_goal)[:-1])
        # energies come with the last step only
        ended = self._per_simulation(info, like, lambda k: "energy/E_mean" in k)
        return ended.astype(bool)[()]

    def compute_truncated(
        self, achieved_goal: npt.ArrayLike, desired_goal: npt.ArrayLike, info: Any
    ) -> Any:
        """Nowhere: the deadline is part of the task."""
        return np.zeros(np.shape(desired_goal)[:-1], bool)[()]

    def _per_simulation(
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


# ---------------------------------------------------------- objectives and costs


@dataclass(frozen=True, kw_only=True)
class CostBounds:
    """Bounds that a period costs one to exceed, beside the joints' own limits.

    Sizes of this project. Peaks of PumaRestToRest-v0, medians of 16 episodes of seed 0: 26 mm
    and 0.23 m/s^2 of straight motions, 7.5 mm and 0.82 m/s^2 of controller `direct`, 29 mm and
    1.5 m/s^2 of random actions.
    """

    displacement: float = unit("m", default=0.02)  # of the arm's mount, at the period's end
    acceleration: float = unit("m/s^2", default=0.5)  # of the mount, its mean over the period

    def __post_init__(self) -> None:
        require_positive(self, "displacement", "acceleration")


class Signals:
    """Steps of a batch with reward and costs in the requested form.

    Args:
        reward: "scalar", or "vector" for the objectives.
        cost: None for no costs, True for the default bounds, or some of `CostBounds` by name.
        goal: observations are those of a goal variant.

    Raises:
        ParameterError: a form that is unknown, or a vector for a goal variant, whose reward is
            computed from goals.
    """

    def __init__(
        self, reward: str, cost: CostBounds | Mapping[str, float] | bool | None, goal: bool
    ) -> None:
        if reward not in FORMS:
            raise ParameterError(f"reward must be {' or '.join(FORMS)}, got {reward!r}")
        self.vector = reward == "vector"
        if self.vector and goal:
            raise ParameterError(
                "a goal variant's reward is that of its goals: scalar, got reward='vector'"
            )
        self.bounds: CostBounds | None = None
        if isinstance(cost, CostBounds):
            self.bounds = cost
        elif isinstance(cost, Mapping):
            self.bounds = from_plain(CostBounds, cost, "cost")
        elif cost is True:
            self.bounds = CostBounds()
        elif cost not in (None, False):
            raise ParameterError(f"cost must be True, None or bounds by name, got {cost!r}")

    @property
    def space(self) -> gym.spaces.Box:
        """Space of the vector of one environment."""
        low, high = np.full((2, len(OBJECTIVES)), np.inf)
        at = OBJECTIVES.index("time")
        low, low[at], high[at] = -low, -1.0, 0.0
        return gym.spaces.Box(low, high, dtype=np.float64)

    def step(
        self, batch: Batch, actions: Array, over: Mask | None = None
    ) -> tuple[Array, Mask, Mask, dict[str, Any]]:
        """Bring a batch on by a period; reward (n,), or (n, 3) by objective, ends and info.

        Args:
            batch: whose episodes.
            actions: (n, width), checked.
            over: (n,) simulations that wait for their next episode.
        """
        before = None if self.bounds is None else batch.scene.yd.copy()
        reward, terminated, truncated, info = batch.step(actions, over)
        if before is not None:
            info.update(self._costs(batch, before, over))
        if self.vector:
            reward = objectives(batch, info, over)
        return reward, terminated, truncated, info

    def _costs(self, batch: Batch, before: Array, over: Mask | None) -> dict[str, Array]:
        """Entries (n,) of an info.

        Args:
            before: (n, 6) rate of the base at the period's start.
        """
        assert self.bounds is not None
        s, arm = batch.scene, batch.system.arm
        q, v = s.q, np.abs(s.v)
        gained = (s.yd - before)[:, :3] / batch.dt
        within = {  # what is no number is not within
            "limits": ((q >= arm.column("q_min")) & (q <= arm.column("q_max"))).all(axis=1)
            & (v <= arm.column("v_max")).all(axis=1),
            "displacement": np.linalg.norm(s.y[:, :3], axis=1) <= self.bounds.displacement,
            "acceleration": np.linalg.norm(gained, axis=1) <= self.bounds.acceleration,
        }
        waiting = np.zeros(batch.n, bool) if over is None else over
        beyond = {name: ~(inside | waiting) for name, inside in within.items()}
        costs = {f"cost_{name}": out.astype(np.float64) for name, out in beyond.items()}
        return {"cost": np.any(list(beyond.values()), axis=0).astype(np.float64), **costs}


def objectives(batch: Batch, info: Mapping[str, Any], over: Mask | None = None) -> Array:
    """Return the reward of a period by objective, (n, 3).

    `energy` is the sum of the task's terms `Task.energetic`, `error` that of all others,
    `failure` among them. `time` is minus the share of the episode that the period lasts, unless
    the episode would count as solved at its end; a failure takes all the time that was left.

    Args:
        batch: whose period it was.
        info: of the period.
        over: (n,) simulations that wait for their next episode.
    """
    task = batch.task
    out = np.zeros((batch.n, len(OBJECTIVES)))
    terms = {k.partition("/")[2]: v for k, v in info.items() if k.startswith("reward/")}
    for name, term in terms.items():
        out[:, 0 if name in task.energetic else 2] += term
    unsolved = np.where(info["success"], 0.0, 1.0)
    failed = terms["failure"] < 0
    if failed.any():
        unsolved[failed] = 1 + task.steps - batch.episodes.steps[failed]
    if over is not None:
        unsolved[over] = 0.0
    out[:, 1] = -unsolved / task.steps
    return out
