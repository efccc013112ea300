# /// script
# dependencies = ["rl-zoo3", "stable-baselines3"]
# ///
"""PumaDamp by RL Zoo, its file rl_zoo.yml: `python rl_zoo_ppo.py [DECISIONS]`."""

import sys
import tempfile
from pathlib import Path

from puma_damp import run, solved
from rl_zoo3.train import train
from stable_baselines3 import PPO

FILE = Path(__file__).with_name("rl_zoo.yml")


def main(decisions: int) -> float:
    """Train; the share of test episodes that the policy solves."""
    with tempfile.TemporaryDirectory() as folder:
        words = f"--algo ppo --env ves/PumaDamp-v0 --gym-packages ves_gym --conf-file {FILE}"
        words += f" --n-timesteps {decisions} --log-folder {folder} --device cpu --seed 0"
        sys.argv = ["train", *words.split(), "--eval-freq", "-1", "--num-threads", "1"]
        train()
        (file,) = Path(folder).glob("ppo/*/ves-PumaDamp-v0.zip")
        model = PPO.load(file, device="cpu")
    return solved(lambda x: model.predict(x, deterministic=True)[0])


if __name__ == "__main__":
    run(main, 600_000)
