# /// script
# dependencies = ["d3rlpy", "torch", "minari", "h5py", "pillow"]
# ///
"""Behaviour cloning, TD3+BC and IQL (d3rlpy) on a data set: `python offline.py FOLDER [STEPS]`.

The folder is what `ves-gym dataset make PumaDamp-v0 --episodes 1000` wrote, such as
out/datasets/ves/PumaDamp-v0/mixed-v0. Four control periods become one decision: what one
action of 12.5 ms changes of the return is less than a critic is wrong by, and TD3+BC solves 0.
"""

import sys
from collections.abc import Callable

import numpy as np
from d3rlpy.algos import BCConfig, IQLConfig, TD3PlusBCConfig
from d3rlpy.dataset import MDPDataset
from d3rlpy.logging import NoopAdapterFactory
from puma_damp import HOLD, solved

from ves_gym.baselines import read_episodes


def per_decision(x: np.ndarray, reduce: Callable[..., np.ndarray]) -> np.ndarray:
    """Return rows (T / HOLD, ...) of an episode's periods (T, ...)."""
    return reduce(x.reshape(-1, HOLD, *x.shape[1:]), axis=1).astype(np.float32)


def main(folder: str, steps: int = 4000, tests: int = 100) -> dict[str, float]:
    """Learn; the share of test episodes that each algorithm solves, and the data's own."""
    episodes = read_episodes(folder)
    data = MDPDataset(
        observations=np.concatenate([e.observations[:-1:HOLD] for e in episodes]),
        actions=np.concatenate([per_decision(e.actions, np.mean) for e in episodes]),
        rewards=np.concatenate([per_decision(e.rewards, np.sum) for e in episodes]),
        terminals=np.concatenate([per_decision(e.terminations, np.max) for e in episodes]),
    )
    shares = {"data": float(np.mean([e.success for e in episodes]))}
    configs = {"BC": BCConfig(), "TD3+BC": TD3PlusBCConfig(), "IQL": IQLConfig()}
    for name, config in configs.items():
        learner = config.create(device="cpu")
        learner.fit(
            data,
            n_steps=steps,
            n_steps_per_epoch=steps,
            logger_adapter=NoopAdapterFactory(),
            show_progress=False,
        )
        shares[name] = solved(learner.predict, tests)
    return shares


if __name__ == "__main__":
    folder, *counts = sys.argv[1:]
    for name, share in main(folder, *map(int, counts)).items():
        print(f"{name}: solved {share:.0%}")
