"""`Sb3VecEnv`: the native vector environment as Stable-Baselines3 wants it."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from stable_baselines3.common.vec_env import VecEnv

from ves_gym._util.params import Array, Mask, ParameterError
from ves_gym.envs.spaces import split_goals
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
        hold: control periods that an action is held for. Rewards add up meanwhile; those of a
            goal variant are `hold` times the last, as `compute_reward` gives them.
        reward_scale: constant factor of the rewards; returns in `episode` are without it.
        endless: tell a deadline as a time limit, whatever the task calls it: values are then
            learned as if the episode went on.
        smooth: of a goal variant, instead of 0 at the goal and -1 elsewhere: -d/(d + smooth),
            d the distance of what is achieved from what is desired, in the units of the
            observation. 0: the task's own reward. `episode` has the task's return either way.
    """

    def __init__(
        self,
        env: VesVectorEnv,
        *,
        hold: int = 1,
        reward_scale: float = 1.0,
        endless: bool = False,
        smooth: float = 0.0,
    ) -> None:
        if not isinstance(env, VesVectorEnv):
            raise ParameterError(f"Sb3VecEnv needs a VesVectorEnv, got {type(env).__name__}")
        if hold < 1 or not reward_scale > 0:
            raise ParameterError(
                f"Sb3VecEnv needs hold >= 1 and reward_scale > 0, got {hold} and {reward_scale}"
            )
        if not smooth >= 0 or (smooth and not env.goal):
            raise ParameterError(
                f"Sb3VecEnv: smooth must be >= 0, and 0 but for a goal variant, got {smooth}"
            )
        self.env, self.hold, self.reward_scale = env, hold, reward_scale
        self.endless, self.smooth = endless, smooth
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        self.stepping = 0.0
        self._begin = time.perf_counter()
        self._root: int | None = None
        self._actions: Any = None
        self._nothing: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]

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
        start = time.perf_counter()
        batch = self.env.batch
        actions = batch.check(self._actions)
        reward, done = np.zeros(self.num_envs), np.zeros(self.num_envs, bool)
        infos = self._nothing
        for _ in range(self.hold):
            gained, terminated, truncated, info = batch.step(
                actions, done if done.any() else None
            )
            if self.smooth:
                gained = self._smoothed()
            reward = (
                np.where(done, reward, self.hold * gained) if self.env.goal else reward + gained
            )
            ended = terminated | truncated
            if ended.any():
                failed = info["reward/failure"] < 0
                limit = ~failed if self.endless else truncated & ~terminated
                infos = self._annotate(infos, ended, limit, info)
                done |= ended
        if done.any():
            batch.reset(np.flatnonzero(done))
        observation = self._observe()
        self.stepping += time.perf_counter() - start
        return observation, (self.reward_scale * reward).astype(np.float32), done, infos

    def _annotate(
        self, infos: list[dict[str, Any]], ended: Mask, truncated: Mask, info: dict[str, Any]
    ) -> list[dict[str, Any]]:
        """The infos, with those of episodes that have just ended."""
        out = infos.copy()
        final, e = self._observe(), self.env.batch.episodes
        seconds = round(time.perf_counter() - self._begin, 6)
        energies = [(k, v) for k, v in info.items() if k.startswith("energy/")]
        for i in np.flatnonzero(ended).tolist():
            last = {k: v[i] for k, v in final.items()} if self.env.goal else final[i]
            out[i] = {
                "terminal_observation": last,
                "TimeLimit.truncated": bool(truncated[i]),
                "episode": {"r": float(e.total[i]), "l": int(e.steps[i]), "t": seconds},
                "is_success": bool(info["success"][i]),
                **{k: float(v[i]) for k, v in energies},
            }
        return out

    def _smoothed(self) -> Array:
        observation = self._observe()
        gap = observation["achieved_goal"].astype(float) - observation["desired_goal"]
        d = np.linalg.norm(gap, axis=1)
        return -d / (d + self.smooth)

    def _observe(self) -> Any:
        rows = self.env.batch.observe()
        return split_goals(self.env.task, rows) if self.env.goal else rows

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
            result = self.hold * self.reward_scale * worth
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
