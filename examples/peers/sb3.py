"""What Stable-Baselines3 learns with its own settings: `python sb3.py ALGORITHM ID FILE.json`.

    python examples/peers/sb3.py sb3-ppo ves/PumaDamp-v0 sb3-ppo.json
    ves-gym leaderboard run damping ves/PumaDamp-v0 sb3-ppo.json --author peer

Nothing is chosen here but the algorithm: one environment, default control, default network,
default rates. Decisions are as many as about five minutes of one core give.
"""

import sys

import gymnasium as gym
import stable_baselines3

import ves_gym  # noqa: F401  (files the environments)
from ves_gym.baselines import from_sb3, save_policy

ALGORITHMS = {"sb3-ppo": ("PPO", 300_000), "sb3-sac": ("SAC", 30_000)}  # class, decisions


def train(name: str, id: str, file: str) -> None:
    """Train on one environment and write the policy."""
    algorithm, decisions = ALGORITHMS[name]
    make = getattr(stable_baselines3, algorithm)
    model = make("MlpPolicy", gym.make(id), seed=0, device="cpu")
    model.learn(decisions)
    about = {
        "algorithm": f"Stable-Baselines3 {algorithm}",
        "steps": decisions,
        "env": id,
        "seed": 0,
    }
    save_policy(from_sb3(model, about, name), file)


if __name__ == "__main__":
    train(*sys.argv[1:])
