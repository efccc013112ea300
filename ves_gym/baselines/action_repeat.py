"""`ActionRepeat`: a native vector environment, stepped by actions that are held for a while."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode

from ves_gym._util.params import Array, Index, Mask, ParameterError
from ves_gym.envs.signals import split_goals
from ves_gym.envs.vector import VesVectorEnv


@dataclass(frozen=True)
class Endings:
    """Episodes that ended in one control period. Leading axis k."""

    ids: Index  # (k,) whose
    final: Any  # their last observations, (k, o) or a dictionary of such
    total: Array  # (k,) return, without `reward_scale`
    steps: Index  # (k,) control periods
    success: Mask  # (k,)
    energies: dict[str, Array]  # "energy/E_mean": (k,) ...


class ActionRepeat(gym.vector.VectorEnv[Any, Any, Any]):
    """A `VesVectorEnv` whose actions are held, and whose episodes begin anew in the same step.

    Gymnasium's vector interface with same-step autoreset, for learners that have no such option
    of their own: `final_obs` and `final_info` with their masks where an episode ended, else the
    info of the last control period. Beside them are `episode` ({"r", "l"}: return without
    `reward_scale`, length in control periods) with its mask, and `endings`, a list of
    `Endings`. Deadlines are part of the tasks: nothing is truncated. `stepping` is the time [s]
    spent in the environment.

    Args:
        env: its autoreset mode is not used.
        hold: control periods that an action is held for. Rewards add up meanwhile; those of a
            goal variant are `hold` times the last, as `compute_reward` gives them.
        reward_scale: constant factor of the rewards.
    """

    def __init__(
        self,
        env: gym.vector.VectorEnv[Any, Any, Any],
        *,
        hold: int = 1,
        reward_scale: float = 1.0,
    ) -> None:
        if not isinstance(env, VesVectorEnv):
            raise ParameterError(f"needs a VesVectorEnv, got {type(env).__name__}")
        if hold < 1 or not reward_scale > 0:
            raise ParameterError(
                f"needs hold >= 1 and reward_scale > 0, got {hold} and {reward_scale}"
            )
        self.env, self.hold, self.reward_scale = env, hold, reward_scale
        self.stepping = 0.0
        self.num_envs, self.spec = env.num_envs, env.spec
        self.metadata = {**env.metadata, "autoreset_mode": AutoresetMode.SAME_STEP}
        self.single_observation_space = env.single_observation_space
        self.single_action_space: gym.spaces.Box = self.env.single_action_space
        self.observation_space, self.action_space = env.observation_space, env.action_space

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Any, dict[str, Any]]:
        """See `VesVectorEnv.reset`."""
        return self.env.reset(seed=seed, options=options)

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Hold actions (n, a); rewards are float32."""
        start = time.perf_counter()
        batch, n = self.env.batch, self.num_envs
        actions = batch.check(actions)
        reward, done = np.zeros(n), np.zeros(n, bool)
        endings: list[Endings] = []
        final: dict[str, Any] = {}
        for _ in range(self.hold):
            gained, ended, _, info = batch.step(actions, done if done.any() else None)
            reward = (
                np.where(done, reward, self.hold * gained) if self.env.goal else reward + gained
            )
            if ended.any():
                endings.append(self._endings(ended, info))
                final = _replaced(final, info, ended) if done.any() else info
                done |= ended
        if endings:
            last, e = self.env.with_privileged(final), batch.episodes
            info = {
                **info,
                "endings": endings,
                "final_obs": self.observe(),
                "final_info": last,
                "episode": {"r": e.total.copy(), "l": e.steps.copy()},
                **dict.fromkeys(("_final_obs", "_final_info", "_episode"), done),
            }
            batch.reset(np.flatnonzero(done))
            info.update(batch.randomized())
        observation, info = self.observe(), self.env.with_privileged(info)
        self.stepping += time.perf_counter() - start
        scaled = (self.reward_scale * reward).astype(np.float32)
        return observation, scaled, done, np.zeros(n, bool), info

    def observe(self) -> Any:
        """Present observations, (n, o) or the dictionary of a goal variant."""
        rows = self.env.batch.observe()
        return split_goals(self.env.task, rows) if self.env.goal else rows

    def close_extras(self, **kwargs: Any) -> None:
        """Close the environment."""
        self.env.close()

    def _endings(self, ended: Mask, info: Any) -> Endings:
        ids, final, e = np.flatnonzero(ended), self.observe(), self.env.batch.episodes
        return Endings(
            ids=ids,
            final={k: v[ids] for k, v in final.items()} if self.env.goal else final[ids],
            total=e.total[ids],
            steps=e.steps[ids],
            success=info["success"][ids],
            energies={k: v[ids] for k, v in info.items() if k.startswith("energy/")},
        )


def _replaced(before: dict[str, Any], after: dict[str, Any], rows: Mask) -> dict[str, Any]:
    """Info of an earlier period, its rows (n,) of these simulations those of a later one."""
    blank = {name: np.zeros_like(values) for name, values in (before | after).items()}
    out = {name: values.copy() for name, values in (blank | before).items()}
    for name, values in (blank | after).items():
        out[name][rows] = values[rows]
    return out
