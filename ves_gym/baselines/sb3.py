"""`Sb3VecEnv`: the native vector environment as Stable-Baselines3 wants it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from stable_baselines3.common.vec_env import VecEnv

from ves_gym._util.params import Array, Mask, ParameterError
from ves_gym.baselines.decisions import Decisions, Endings
from ves_gym.envs.vector import VesVectorEnv


class Sb3VecEnv(VecEnv):
    """A `VesVectorEnv` whose episodes begin anew in the step that ended them.

    A step does no Python work per environment but for those whose episode ended. Their info
    holds `terminal_observation`, `TimeLimit.truncated`, `episode` ({"r", "l", "t"}: return,
    length in control periods, seconds since this object was made), `is_success` and the
    energies (`energy/E_mean` ...); all others' is an empty dictionary, the same object every
    time.

    `seed(s)` makes s the root of every episode from the next `reset` on. `stepping` is the
    time [s] spent in the environment.

    Args:
        env: its autoreset mode is not used.
        on_endings: told of every episode that ends.
        choices: hold, reward_scale and endless: see `Decisions`.
    """

    def __init__(
        self,
        env: VesVectorEnv,
        *,
        on_endings: Callable[[Endings], None] = lambda endings: None,
        **choices: Any,
    ) -> None:
        self.decisions, self.on_endings = Decisions(env, **choices), on_endings
        self.env = env
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        self._begin = time.perf_counter()
        self._root: int | None = None
        self._actions: Any = None
        self._nothing: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]

    @property
    def stepping(self) -> float:
        """Time spent in the environment [s]."""
        return self.decisions.stepping

    def reset(self) -> Any:
        """First observations of the next episodes, seeded if `seed` was called before."""
        options = None
        if any(self._options):
            options = {k: np.stack([o[k] for o in self._options]) for k in self._options[0]}
        observation, _ = self.env.reset(seed=self._root, options=options)
        self._root = None
        self._reset_seeds()
        self._reset_options()
        return observation

    def step_async(self, actions: Array) -> None:
        """Take the actions; `step_wait` does the work."""
        self._actions = actions

    def step_wait(self) -> tuple[Any, Any, Mask, list[dict[str, Any]]]:
        """Observations, rewards (float32), dones and infos."""
        observation, reward, done, endings = self.decisions.step(self._actions)
        infos = self._nothing
        if endings:
            infos = infos.copy()
            for ended in endings:
                self.on_endings(ended)
                self._annotate(infos, ended)
        return observation, reward, done, infos

    def _annotate(self, infos: list[dict[str, Any]], ended: Endings) -> None:
        """Tell of episodes that have just ended."""
        seconds = round(time.perf_counter() - self._begin, 6)
        final = ended.final
        for k, i in enumerate(ended.ids.tolist()):
            last = {n: v[k] for n, v in final.items()} if self.env.goal else final[k]
            infos[i] = {
                "terminal_observation": last,
                "TimeLimit.truncated": bool(ended.cut_off[k]),
                "episode": {
                    "r": float(ended.total[k]),
                    "l": int(ended.steps[k]),
                    "t": seconds,
                },
                "is_success": bool(ended.success[k]),
                **{name: float(v[k]) for name, v in ended.energies.items()},
            }

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Root of the episodes from the next reset on; it is every environment's seed."""
        if seed is None:
            seed = int(np.random.SeedSequence().generate_state(1)[0])
        self._root = seed
        return [seed] * self.num_envs

    def env_method(
        self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any
    ) -> list[Any]:
        """Call a method once: `compute_reward` of the task, others of the environment."""
        if method_name == "compute_reward":
            achieved, desired, *_ = args
            worth = self.env.task.goal_reward(np.asarray(achieved), np.asarray(desired))
            result = self.decisions.hold * self.decisions.reward_scale * worth
        else:
            result = getattr(self.env, method_name)(*args, **kwargs)
        return [result for _ in self._indices(indices)]

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """The vector environment's attribute, once per index."""
        value = getattr(self.env, attr_name)
        return [value for _ in self._indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set the vector environment's attribute: for all environments or for none."""
        if len(list(self._indices(indices))) != self.num_envs:
            raise ParameterError(
                f"set_attr acts on all {self.num_envs} environments at once, got indices"
                f" {indices}"
            )
        setattr(self.env, attr_name, value)

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Never: there are no single environments to wrap."""
        return [False for _ in self._indices(indices)]

    def close(self) -> None:
        """Close the vector environment."""
        self.env.close()

    def _indices(self, indices: Any) -> Iterable[int]:
        chosen: Iterable[int] = self._get_indices(indices)
        return chosen
