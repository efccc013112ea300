"""Claim: drawing three random effects anew costs next to nothing beside the episode."""

from time import process_time

import numpy as np

from ves_gym.envs.vector import VesVectorEnv

THREE = {
    "gravity/scale": {"error": (-0.005, 0.005)},
    "gravity/tilt": {"angles": ([-0.005] * 3, [0.005] * 3)},
    "sensor/bias": {"force": ([-1.0] * 3, [1.0] * 3)},
}


def test_a_reset_costs_a_twentieth_of_the_episode():
    """256 environments, processor time; the episode's 160 steps from 20 of them.

    Measured 1.7 %; a system per simulation, checked and hashed, cost 45 %.
    """
    env = VesVectorEnv(
        256, "rest_to_rest", mode="emulated", effects="laboratory", randomize=THREE, threads=1
    )
    env.reset(seed=0)
    resets = []
    for _ in range(3):
        began = process_time()
        env.reset()
        resets.append(process_time() - began)
    action = np.zeros((256, *env.single_action_space.shape))
    began = process_time()
    for _ in range(20):
        env.step(action)
    episode = (process_time() - began) / 20 * env.task.steps
    assert min(resets) < 0.05 * episode
