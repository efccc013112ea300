# /// script
# dependencies = ["d3rlpy", "torch", "minari", "h5py", "pillow"]
# ///
"""Behaviour cloning and TD3+BC (d3rlpy) on a data set: `python offline.py FOLDER [STEPS]`.

The folder is what `ves-gym dataset make PumaDamp-v0 --episodes 1000` wrote, such as
out/datasets/ves/PumaDamp-v0/mixed-v0.
"""

import sys

import numpy as np
from d3rlpy.algos import BCConfig, TD3PlusBCConfig
from d3rlpy.dataset import MDPDataset
from d3rlpy.logging import NoopAdapterFactory
from puma_damp import solved

from ves_gym.baselines import read_episodes


def main(folder: str, steps: int = 10_000, tests: int = 100) -> dict[str, float]:
    """Learn; the share of test episodes that each algorithm solves, and the data's own."""
    episodes = read_episodes(folder)
    data = MDPDataset(
        observations=np.concatenate([e.observations[:-1] for e in episodes]),
        actions=np.concatenate([e.actions for e in episodes]),
        rewards=np.concatenate([e.rewards for e in episodes]).astype(np.float32),
        terminals=np.concatenate([e.terminations for e in episodes]).astype(np.float32),
    )
    shares = {"data": float(np.mean([e.success for e in episodes]))}
    for name, config in {"BC": BCConfig(), "TD3+BC": TD3PlusBCConfig(gamma=0.997)}.items():
        learner = config.create(device="cpu")
        learner.fit(
            data,
            n_steps=steps,
            n_steps_per_epoch=steps,
            logger_adapter=NoopAdapterFactory(),
            show_progress=False,
        )
        shares[name] = solved(learner.predict, tests, hold=1)  # as the data was recorded
    return shares


if __name__ == "__main__":
    folder, *counts = sys.argv[1:]
    for name, share in main(folder, *map(int, counts)).items():
        print(f"{name}: solved {share:.0%}")
