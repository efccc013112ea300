# /// script
# dependencies = ["ray[rllib]", "torch"]
# ///
"""RLlib: PPO with single environments and with the native vector."""

import os

os.environ.setdefault("RAY_AUTH_MODE", "disabled")  # else a token lands in the home folder

import gymnasium as gym
import numpy as np
import ray
from ray.rllib.algorithms.ppo import PPOConfig

import ves_gym  # noqa: F401  files the ids


def train(runners: int, mode: str) -> int:
    """Return the number of steps of one iteration of PPO."""
    config = (
        PPOConfig()
        .environment("ves_gym:ves/PumaReach-v0", env_config={"duration": 0.25})
        .env_runners(
            num_env_runners=runners, num_envs_per_env_runner=2, gym_env_vectorize_mode=mode
        )
        .training(train_batch_size_per_learner=400, minibatch_size=100, num_epochs=2)
        .debugging(seed=0)
    )
    algorithm = config.build_algo()
    result = algorithm.train()
    algorithm.stop()
    runs = result["env_runners"]
    assert np.isfinite(runs["episode_return_mean"]) and runs["episode_len_mean"] <= 20, runs
    return int(runs["num_env_steps_sampled_lifetime"])


def main() -> str:
    """Train; return what was run."""
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    sync = gym.VectorizeMode.SYNC
    native = gym.VectorizeMode.VECTOR_ENTRY_POINT
    own, vector, worker = train(0, sync), train(0, native), train(1, sync)
    ray.shutdown()
    return (
        f"PPO on PumaReach, one iteration each: {own} steps of single environments, {vector} of"
        f" the native vector, {worker} in a worker process"
    )


if __name__ == "__main__":
    print("ran:", main())
