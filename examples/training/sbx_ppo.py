# /// script
# dependencies = ["sbx-rl", "stable-baselines3"]
# ///
"""PumaDamp by SBX's PPO (JAX): `python sbx_ppo.py [DECISIONS]`."""

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
from sbx import PPO

from ves_gym.baselines import Sb3VecEnv


def main(decisions: int = DECISIONS) -> float:
    """Train; the share of test episodes that the policy solves."""
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
    )
    model.learn(decisions)
    return solved(lambda x: model.predict(x, deterministic=True)[0])


if __name__ == "__main__":
    run(main)
