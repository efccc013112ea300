# /// script
# dependencies = ["stable-baselines3"]
# ///
"""Stable-Baselines3: its check of every id, PPO, SAC, and HER on the goal variant."""

import warnings

import gymnasium as gym
from stable_baselines3 import PPO, SAC, HerReplayBuffer
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.env_util import make_vec_env

import ves_gym  # noqa: F401  files the ids

SHORT = {"duration": 0.25}


def main() -> str:
    """Check and train; return what was run."""
    ids = sorted(k for k in gym.registry if k.startswith("ves/"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for name in ids:
            check_env(gym.make(name))
            check_env(gym.make(name).unwrapped)
    env = make_vec_env("ves/PumaDamp-v0", 2, env_kwargs=SHORT, seed=0)
    model = PPO("MlpPolicy", env, n_steps=128, batch_size=64, seed=0, device="cpu")
    model.learn(512)
    assert len(model.ep_info_buffer) >= 20
    goal = gym.make("ves/PumaReachGoal-v0", **SHORT)
    model = SAC(
        "MultiInputPolicy",
        goal,
        replay_buffer_class=HerReplayBuffer,
        learning_starts=100,
        seed=0,
        device="cpu",
    )
    model.learn(150)
    return (
        f"check_env on {len(ids)} ids, warnings as errors; PPO, 512 steps of PumaDamp;"
        " SAC with HER, 150 steps of PumaReachGoal"
    )


if __name__ == "__main__":
    print("ran:", main())
