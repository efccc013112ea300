# /// script
# dependencies = ["stable-baselines3"]
# ///
"""PumaDamp by Stable-Baselines3's PPO: `python sb3_ppo.py [DECISIONS]`."""

import gymnasium as gym
from puma_damp import (
    BATCH,
    DECISIONS,
    ENVS,
    EPOCHS,
    HOLD,
    ID,
    RATE,
    ROLLOUT,
    SCALE,
    run,
    solved,
)
from stable_baselines3 import PPO

from ves_gym.baselines import Sb3VecEnv, from_sb3, save_policy


def main(decisions: int = DECISIONS) -> float:
    """Train, write damp.json; the share of test episodes that it solves."""
    env = gym.make_vec(ID, num_envs=ENVS, threads=1)
    model = PPO(
        "MlpPolicy",
        Sb3VecEnv(env, hold=HOLD, reward_scale=SCALE),
        learning_rate=lambda remaining: RATE * remaining,
        n_steps=ROLLOUT,
        batch_size=BATCH,
        n_epochs=EPOCHS,
        policy_kwargs={"log_std_init": -1.0},
        seed=0,
        device="cpu",
    )
    model.learn(decisions)
    save_policy(from_sb3(model), "damp.json")
    return solved(lambda x: model.predict(x, deterministic=True)[0])


if __name__ == "__main__":
    run(main)
