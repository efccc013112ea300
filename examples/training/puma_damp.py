"""What the examples of this folder share: the environment, its scale, and who has solved it."""

from __future__ import annotations

import sys
from collections.abc import Callable

import gymnasium as gym
import numpy as np

from ves_gym.baselines import ActionRepeat

ID = "ves_gym:ves/PumaDamp-v0"
ENVS, DECISIONS = 128, 1_000_000
# those of `ves-gym train PumaDamp-v0`: 20 decisions a second, returns of about ten
HOLD, SCALE = 4, 10.0
ROLLOUT, BATCH, EPOCHS, RATE = 80, 2048, 8, 1e-3


def vector(count: int = ENVS, hold: int = HOLD) -> ActionRepeat:
    """Return so many environments in lockstep; an action is held for `hold` periods."""
    env = gym.make_vec(ID, num_envs=count, threads=1)
    return ActionRepeat(env, hold=hold, reward_scale=SCALE)


def solved(
    act: Callable[[np.ndarray], np.ndarray], episodes: int = 100, hold: int = HOLD
) -> float:
    """Return the share of test episodes that a policy solves.

    Args:
        act: actions (n, a) of observations (n, o).
        episodes: how many, all at once.
        hold: control periods that an action lasts.
    """
    env = vector(episodes, hold)
    observation, _ = env.reset(seed=[2_000_000 + k for k in range(episodes)])
    success: dict[int, bool] = {}
    while len(success) < episodes:
        observation, *_, info = env.step(np.clip(act(observation), -1.0, 1.0))
        for ended in info.get("endings", ()):
            for i, good in zip(ended.ids.tolist(), ended.success.tolist(), strict=True):
                success.setdefault(i, good)  # of its first episode
    return sum(success.values()) / episodes


def run(train: Callable[[int], float], whole: int = DECISIONS) -> None:
    """Train for as many decisions as the command line says; say what share is solved.

    A whole training that solves less than 95 % ends with exit status 1.
    """
    decisions = int(sys.argv[1]) if len(sys.argv) > 1 else whole
    share = train(decisions)
    print(f"ran: {decisions:,} decisions of PumaDamp, {share:.0%} of 100 episodes solved")
    if decisions >= whole and share < 0.95:
        sys.exit("a whole training should solve 95 %")
