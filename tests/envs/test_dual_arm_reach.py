"""Two arms on a free satellite: one reaches, either moves the base, both come to rest."""

import gymnasium as gym
import numpy as np
import pytest

from tests.envs.runs import controlled
from ves_gym.baselines.registry import get_controller
from ves_gym.mechanics.kinematics import joint_positions


def test_either_arm_turns_the_base_and_the_last_one_has_the_tool():
    env = gym.make("ves/DualArmReach-v0").unwrapped
    arm = env.task.system.arm
    assert arm.n == 12 and [span.start for span in arm.spans] == [0, 6]
    for joint in (0, 6):
        env.reset(seed=1)
        action = np.zeros(12, np.float32)
        action[joint] = 1.0
        for _ in range(20):
            observation, *_ = env.step(action)
        s = env.batch.scene
        assert np.abs(s.y[0, 3:]).max() > 1e-5
        tool = joint_positions(arm, s.q)[0, -1]
        assert np.linalg.norm(s.tool[0] - tool) < 0.1  # of the last arm, base hardly moved
    assert observation.shape == (52,)


@pytest.mark.parametrize("n", [4, pytest.param(20, marks=pytest.mark.slow)])
def test_the_other_arm_takes_energy_and_turn_from_the_satellite(n):
    """Over the same task with that arm where it is; doing nothing solves nothing."""
    ends = {}
    for name in ("zero", "resolved", "compensating"):
        _, _, costs, info = controlled(get_controller(name), n, "dual_arm_reach")
        ends[name] = np.array([costs["energy"], costs["turn"]])
        assert (info["success"] == (name != "zero")).all()
    shares = ends["compensating"] / ends["resolved"]
    print(f"energy, turn: {np.median(shares, axis=1)}, at most {shares.max(axis=1)}")
    assert (np.median(shares, axis=1) <= (0.1, 0.2)).all()
    assert shares.max() <= 0.4
