"""Claim: drawing three random effects anew costs little beside the episode."""

from time import process_time

import numpy as np

from ves_gym.envs.vector import VesVectorEnv

THREE = {
    "gravity/scale": {"error": (-0.005, 0.005)},
    "gravity/tilt": {"angles": ([-0.005] * 3, [0.005] * 3)},
    "sensor/bias": {"force": ([-1.0] * 3, [1.0] * 3)},
}


def test_a_reset_is_a_small_part_of_the_episode():
    """256 environments, processor time; the episode's 160 steps from 40 of them.

    Measured 4.2 to 4.6 %: 4 ms of 90. A system per simulation, checked and hashed, took 229 ms.
    Tolerance: twice that, for other processes on the machine.
    """
    env = VesVectorEnv(
        256, "rest_to_rest", mode="emulated", effects="laboratory", randomize=THREE, threads=1
    )
    env.reset(seed=0)
    resets, steps = [], []
    action = np.zeros((256, *env.single_action_space.shape))
    for _ in range(8):
        began = process_time()
        env.reset()
        resets.append(process_time() - began)
        began = process_time()
        for _ in range(5):
            env.step(action)
        steps.append((process_time() - began) / 5)
    print(f"{min(resets) / (min(steps) * env.task.steps):.1%}")
    assert min(resets) < 0.10 * min(steps) * env.task.steps
