"""`Decisions`: a native vector environment, stepped by actions that are held for a while."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

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


class Decisions:
    """Episodes of a `VesVectorEnv` that begin anew in the step that ended them.

    A step does no Python work per environment but for those whose episode ended.
    `stepping` is the time [s] spent in the environment.

    Args:
        env: its autoreset mode is not used.
        hold: control periods that an action is held for. Rewards add up meanwhile; those of a
            goal variant are `hold` times the last, as `compute_reward` gives them.
        reward_scale: constant factor of the rewards; returns of `Endings` are without it.
    """

    def __init__(self, env: VesVectorEnv, *, hold: int = 1, reward_scale: float = 1.0) -> None:
        if not isinstance(env, VesVectorEnv):
            raise ParameterError(f"decisions need a VesVectorEnv, got {type(env).__name__}")
        if hold < 1 or not reward_scale > 0:
            raise ParameterError(
                f"decisions need hold >= 1 and reward_scale > 0, got {hold} and {reward_scale}"
            )
        self.env, self.hold, self.reward_scale = env, hold, reward_scale
        self.stepping = 0.0

    def step(self, actions: Any) -> tuple[Any, Array, Mask, list[Endings]]:
        """Hold actions (n, a); observations, rewards (n,) float32, those over, and how."""
        start = time.perf_counter()
        batch, n = self.env.batch, self.env.num_envs
        actions = batch.check(actions)
        reward, done = np.zeros(n), np.zeros(n, bool)
        endings: list[Endings] = []
        for _ in range(self.hold):
            gained, ended, _, info = batch.step(actions, done if done.any() else None)
            reward = (
                np.where(done, reward, self.hold * gained) if self.env.goal else reward + gained
            )
            if ended.any():
                endings.append(self._endings(ended, info))
                done |= ended
        if done.any():
            batch.reset(np.flatnonzero(done))
        observation = self.observe()
        self.stepping += time.perf_counter() - start
        return observation, (self.reward_scale * reward).astype(np.float32), done, endings

    def observe(self) -> Any:
        """Present observations, (n, o) or the dictionary of a goal variant."""
        rows = self.env.batch.observe()
        return split_goals(self.env.task, rows) if self.env.goal else rows

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
