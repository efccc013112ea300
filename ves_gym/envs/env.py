"""`VesEnv`: one episode at a time through Gymnasium's interface; a batch of one.

`Episodic` is what it shares with `VesVectorEnv`.
"""

from __future__ import annotations

import copy
import os
from collections.abc import Callable, Mapping
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.envs.registration import EnvSpec

from ves_gym._util.params import ParameterError
from ves_gym.envs.batch import Batch, checked
from ves_gym.envs.build import build_task, require_keywords
from ves_gym.envs.recording import Renderer, render_modes, require_display
from ves_gym.envs.registration import DeadlineSpec, with_deadline
from ves_gym.envs.signals import (
    WEIGHTS,
    GoalFunctions,
    Signals,
    goal_space,
    observation_space,
    require_index,
    require_seed,
    split_goals,
)
from ves_gym.envs.task import Task

_ONE = np.zeros(1, np.intp)


class Episodic:
    """Task, batch, spaces, copies and pictures of an environment, single or vector."""

    _spec: DeadlineSpec | None = None
    _over: Any
    _renderer: Renderer | None = None
    num_envs = 1

    def _set_up(
        self,
        task: str | Task,
        settings: Mapping[str, Any],
        render_mode: str | None,
        goal: bool,
        reward: str,
        cost: Mapping[str, float] | bool | None,
        privileged: bool,
        **engine: Any,
    ) -> tuple[gym.spaces.Box, gym.spaces.Space[Any]]:
        """Make task and batch; spaces of an action and of an observation of one environment.

        Args:
            task, settings: see `build_task`.
            render_mode, goal, reward, cost, privileged: see `VesEnv`.
            engine: backend, threads and dump of the `Batch`.
        """
        require_keywords(type(self), task, settings)
        self.task, self.goal, self.render_mode = build_task(task, **settings), goal, render_mode
        self._signals = Signals(reward, cost, goal)
        if self._signals.vector:
            self.reward_space, self.reward_weights = self._signals.space, np.array(WEIGHTS)
        self._engine, self._tells = engine, privileged
        self.batch = self._batch()
        self._ready = False
        space = observation_space(self.task)
        actions = gym.spaces.Box(-1.0, 1.0, (self.batch.width,), np.float32)
        return actions, goal_space(self.task, space) if goal else space

    def _batch(self) -> Batch:
        return Batch(self.task, self.num_envs, **self._engine)

    def with_privileged(self, info: dict[str, Any]) -> dict[str, Any]:
        """Return an info with what critics may know, where `privileged` is set."""
        return info | {"privileged": self.batch.privileged()} if self._tells else info

    def _observed(self, rows: npt.NDArray[np.float32]) -> Any:
        return split_goals(self.task, rows) if self.goal else rows

    @property
    def spec(self) -> DeadlineSpec | None:
        """Specification with the steps of an episode of these settings."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        self._spec = None if spec is None else with_deadline(spec, self.task.steps)

    def snapshot(self) -> Any:
        """The complete state, random generators included; picklable."""
        return self.batch.get_state(), self._ready, copy.copy(self._over)

    def restore(self, snapshot: Any) -> None:
        """Return to a snapshot of an environment of the same settings."""
        state, self._ready, over = snapshot
        self._over = copy.copy(over)
        self.batch.set_state(state)

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_renderer": None, "batch": self.batch.get_state()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.batch = self._batch()
        self.batch.set_state(state["batch"])

    def _pictures(self) -> Renderer:
        if self._renderer is None:
            self._renderer = Renderer(self.task, str(self.render_mode))
        return self._renderer

    def _end_pictures(self) -> None:
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None


class VesEnv(Episodic, gym.Env[Any, Any]):  # type: ignore[misc]
    """An episode of a task.

    Args:
        task: registered name, class or `Task`.
        backend: engine, see `Simulator`.
        render_mode: None, "human" or "rgb_array".
        goal: observations of a goal-conditioned task as a dictionary (for HER).
        dump: folder for run logs of episodes that diverge (`info["dump"]` names the file).
        reward: "scalar", or "vector" by objective (`signals.OBJECTIVES`): `reward_space`.
        cost: entries `cost` and `cost_...` of the info: True, or some `CostBounds` by name.
        privileged: an entry `privileged` of the info, for critics and teachers: what decides
            and is not observed (`batch.privileged.fields`).
        settings: see `build_task`: mode, vehicle, effects, control, randomize, ...
    """

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": 80}

    def __init__(
        self,
        task: str | Task = "rest_to_rest",
        *,
        backend: str = "auto",
        render_mode: str | None = None,
        goal: bool = False,
        dump: str | os.PathLike[str] | None = None,
        reward: str = "scalar",
        cost: Mapping[str, float] | bool | None = None,
        privileged: bool = False,
        **settings: Any,
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(
                f"render_mode must be None, human or rgb_array, got {render_mode!r}"
            )
        form = render_mode, goal, reward, cost, privileged
        self.action_space, self.observation_space = self._set_up(
            task, settings, *form, backend=backend, threads=1, dump=dump
        )
        fps = 1 / self.task.system.control_dt  # real time
        self.metadata = {"render_modes": render_modes(), "render_fps": fps}
        if render_mode == "human":
            require_display()
        self._over = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin the next episode of the present seed, or the first of a new one.

        Args:
            seed: root of the sequence of episodes. Episode k of simulation i of a vector
                environment is the k-th after `reset(seed=seed, options={"index": i})`.
            options: index (default 0), and what the task lets one choose (`Task.options`).
        """
        options = self.task.check_options(options, extra=("index",))
        if "index" in options and seed is None:
            raise ParameterError("reset: the option index needs a seed, got none")
        index = require_index(options.pop("index", 0))
        if seed is None and not self._ready:
            seed = int(np.random.SeedSequence().generate_state(1)[0])
        if seed is not None:
            require_seed(seed)
            super().reset(seed=int(seed))
            self.batch.seed(_ONE, seed, index)
        self.batch.reset(_ONE, {k: v[None] for k, v in options.items()})
        self._ready, self._over = True, False
        info = {k: v[0] for k, v in self.with_privileged(self.batch.randomized()).items()}
        if self.render_mode == "human":
            self.render()
        return self._observation(), info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """One control period; an `ActionError` leaves the state as it was."""
        if not self._ready or self._over:
            raise gym.error.ResetNeeded(
                "the episode is over: call reset" if self._ready else "call reset before step"
            )
        actions = checked(action, (self.batch.width,))[None]
        reward, terminated, truncated, info = self._signals.step(self.batch, actions)
        ended = bool(terminated[0] or truncated[0])
        self._over = ended
        flat = {
            k: v.item()
            if v.dtype.kind in "bi" and v.ndim == 1
            else v[0]  # floats stay NumPy's,
            for k, v in self.with_privileged(
                info
            ).items()  # which are floats too: TorchRL reads their dtype
            if k[0] != "_"
        }
        if self.render_mode == "human":
            self.render()
        return (
            self._observation(),
            reward[0] if self._signals.vector else float(reward[0]),
            bool(terminated[0]),
            bool(truncated[0]),
            flat,
        )

    def _observation(self) -> Any:
        return self._observed(self.batch.observe()[0])

    @property
    def episode_id(self) -> npt.NDArray[np.uint64]:
        """(3,) seed, index and number that the episode's random numbers come from."""
        return self.batch.episode_ids()[0]

    @property
    def compute_reward(self) -> Callable[[npt.ArrayLike, npt.ArrayLike, Any], Any]:
        """Reward of goals and info, of a goal variant only (HER); see `GoalFunctions`."""
        return self._of_goals().compute_reward

    @property
    def compute_terminated(self) -> Callable[[npt.ArrayLike, npt.ArrayLike, Any], Any]:
        """Termination by goals and info, of a goal variant only."""
        return self._of_goals().compute_terminated

    @property
    def compute_truncated(self) -> Callable[[npt.ArrayLike, npt.ArrayLike, Any], Any]:
        """Truncation by goals and info, of a goal variant only."""
        return self._of_goals().compute_truncated

    def _of_goals(self) -> GoalFunctions:
        if not self.goal:  # libraries ask `hasattr(env, "compute_reward")`
            raise AttributeError(f"{self.task.kind} without goals computes nothing of them")
        return GoalFunctions(self.task)

    # --------------------------------------------------------------- rendering

    def render(self) -> Any:
        """The present frame (rgb_array), or the window brought up to date (human)."""
        if self.render_mode is None:
            return None
        return self._pictures().frame(self.batch)

    def close(self) -> None:
        """Close window and engine; may be called again."""
        self._end_pictures()
