"""Controllers that keep what another one does, and that do it again."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ves_gym._util.params import Array, Index, Mask
from ves_gym.baselines.controllers import Controller
from ves_gym.envs.vector import VesVectorEnv
from ves_gym.leaderboard.energy_audit import Account


class Recorded:
    """Acts as another controller does, and keeps its actions.

    Args:
        inner: the controller.
        levels: an action becomes the nearest multiple of 1/levels before it acts; a power of
            two. None: it acts as it is.
    """

    def __init__(self, inner: Controller, levels: int | None = None) -> None:
        self.inner, self.name, self.privileged = inner, inner.name, inner.privileged
        self._levels = levels
        self._recorded: dict[int, list[Array]] = {}

    def reset(self, env: VesVectorEnv, ids: Index) -> None:
        """See `Controller`."""
        self.inner.reset(env, ids)

    def act(self, env: VesVectorEnv, observation: Any) -> Array:
        """See `Controller`; out of bounds is brought back, as the environment would."""
        actions = np.clip(env.batch.check(self.inner.act(env, observation)), -1.0, 1.0)
        if self._levels is not None:
            actions = np.rint(actions * self._levels) / self._levels + 0.0  # no zero below zero
        roots = env.batch.episodes.root
        for i in np.flatnonzero(in_episode(env)).tolist():
            self._recorded.setdefault(int(roots[i]), []).append(actions[i].copy())
        return actions

    def actions(self, seed: int) -> Array:
        """(steps, width) of the episode of a seed."""
        return np.array(self._recorded[seed])


class Replayed:
    """Acts as was recorded; an action too few is none at all."""

    name = "replayed"
    privileged = False

    def __init__(self, actions: Mapping[int, Array]) -> None:
        self._actions = actions
        self.account = Account()

    def reset(self, env: VesVectorEnv, ids: Index) -> None:
        """See `Controller`."""

    def act(self, env: VesVectorEnv, observation: Any) -> Array:
        """See `Controller`."""
        e, fresh = env.batch.episodes, in_episode(env)
        out = np.zeros((env.num_envs, env.batch.width))
        for i in np.flatnonzero(fresh).tolist():
            recorded = self._actions[int(e.root[i])]
            if e.steps[i] < len(recorded):
                out[i] = recorded[e.steps[i]]
        if env.task.system.mode == "ideal" and not env.task.interacts:
            self.account.observe(env, fresh)
        return out


def in_episode(env: VesVectorEnv) -> Mask:
    """(n,) environments in an episode that counts: a seed's first."""
    return np.asarray(env.batch.episodes.number == 0, dtype=bool)
