# /// script
# dependencies = ["gymnasium"]
# ///
"""Gymnasium's own wrappers around single and vector environments."""

import itertools

import gymnasium as gym
import numpy as np
from gymnasium import wrappers
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import vector

import ves_gym  # noqa: F401  files the ids

SHORT = {"duration": 0.25}
IDS = sorted(k for k in gym.registry if k.startswith("ves/"))


def single(name: str) -> int:
    """Run two episodes through a stack of wrappers; return the steps."""
    env = gym.make(name, **SHORT)
    if isinstance(env.observation_space, gym.spaces.Dict):
        env = wrappers.FlattenObservation(env)
    env = wrappers.RecordEpisodeStatistics(env)
    env = wrappers.ClipAction(env)
    env = wrappers.NormalizeObservation(env)
    env = wrappers.NormalizeReward(env)
    env = wrappers.TimeAwareObservation(env)
    env = wrappers.FrameStackObservation(env, 4)
    env = wrappers.DtypeObservation(env, np.float32)
    env.reset(seed=0)
    env.action_space.seed(0)
    ends = steps = 0
    while ends < 2:
        observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        assert observation in env.observation_space and np.isfinite(reward)
        steps += 1
        if terminated or truncated:
            assert info["episode"]["l"] <= 20 and np.isfinite(info["episode"]["r"])
            assert np.isfinite(info["energy/E_mean"])
            env.reset()
            ends += 1
    env.close()
    return steps


def many(name: str, mode: AutoresetMode, native: bool) -> int:
    """Run 50 steps of a vector through a stack of wrappers; return the steps."""
    kwargs = {"autoreset_mode": mode}
    how = {} if native else {"vectorization_mode": "sync", "vector_kwargs": kwargs}
    env = gym.make_vec(name, num_envs=3, **(kwargs if native else how), **SHORT)
    env = vector.RecordEpisodeStatistics(env)
    env = vector.ClipAction(env)
    if mode is AutoresetMode.NEXT_STEP:  # wrappers of observations refuse the other
        if isinstance(env.single_observation_space, gym.spaces.Dict):
            env = vector.FlattenObservation(env)
        env = vector.NormalizeObservation(env)
    env = vector.NormalizeReward(env)
    env = vector.DictInfoToList(env)
    env.reset(seed=0)
    env.action_space.seed(0)
    ends = 0
    for _ in range(50):
        *_, terminated, truncated, infos = env.step(env.action_space.sample())
        over = terminated | truncated
        for i in np.flatnonzero(over):
            assert infos[i]["episode"]["l"] <= 20
            last = infos[i]["final_info"] if mode is AutoresetMode.SAME_STEP else infos[i]
            assert np.isfinite(last["energy/E_mean"])
        ends += int(over.sum())
    assert ends >= 6, ends
    env.close()
    return 150


def main() -> str:
    """Run every id; return what was run."""
    steps = sum(single(name) for name in IDS)
    modes = (AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP)
    for name, mode, native in itertools.product(IDS, modes, (True, False)):
        steps += many(name, mode, native)
    return (
        f"{len(IDS)} ids, single, native vector and SyncVectorEnv, next-step and same-step"
        f" autoreset, through RecordEpisodeStatistics, NormalizeObservation, NormalizeReward,"
        f" FrameStackObservation, TimeAwareObservation, DictInfoToList: {steps} steps"
    )


if __name__ == "__main__":
    print("ran:", main())
