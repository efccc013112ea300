# /// script
# dependencies = ["d3rlpy", "torch"]
# ///
"""d3rlpy: SAC online, CQL offline on what it has collected."""

import gymnasium as gym
import numpy as np
from d3rlpy.algos import CQLConfig, SACConfig
from d3rlpy.dataset import create_fifo_replay_buffer
from d3rlpy.logging import NoopAdapterFactory
from d3rlpy.metrics import evaluate_qlearning_with_environment

import ves_gym  # noqa: F401  files the ids


def main() -> str:
    """Train; return what was run."""
    env = gym.make("ves/PumaReach-v0", duration=0.25)
    buffer = create_fifo_replay_buffer(limit=1000, env=env)
    sac = SACConfig(batch_size=32).create(device="cpu")
    sac.fit_online(
        env,
        buffer,
        n_steps=300,
        n_steps_per_epoch=150,
        update_start_step=200,
        logger_adapter=NoopAdapterFactory(),
        show_progress=False,
    )
    assert buffer.transition_count >= 280
    cql = CQLConfig(batch_size=32).create(device="cpu")
    cql.fit(
        buffer,
        n_steps=20,
        n_steps_per_epoch=10,
        logger_adapter=NoopAdapterFactory(),
        show_progress=False,
    )
    score = evaluate_qlearning_with_environment(cql, env, n_trials=2)
    assert np.isfinite(score)
    return "SAC online, 300 steps of PumaReach; CQL offline on them, 20 updates"


if __name__ == "__main__":
    print("ran:", main())
