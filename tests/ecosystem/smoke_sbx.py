# /// script
# dependencies = ["sbx-rl"]
# ///
"""SBX (Stable-Baselines3 in JAX): PPO and SAC."""

import gymnasium as gym
from sbx import PPO, SAC
from stable_baselines3.common.env_util import make_vec_env

import ves_gym  # noqa: F401  files the ids

SHORT = {"duration": 0.25}


def main() -> str:
    """Train; return what was run."""
    env = make_vec_env("ves/PumaDamp-v0", 2, env_kwargs=SHORT, seed=0)
    model = PPO("MlpPolicy", env, n_steps=128, batch_size=64, seed=0)
    model.learn(512)
    assert len(model.ep_info_buffer) >= 20
    model = SAC("MlpPolicy", gym.make("ves/PumaReach-v0", **SHORT), learning_starts=100, seed=0)
    model.learn(200)
    return "PPO, 512 steps of PumaDamp; SAC, 200 steps of PumaReach"


if __name__ == "__main__":
    print("ran:", main())
