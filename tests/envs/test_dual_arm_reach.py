"""Two arms on a free satellite: one reaches, either moves the base, both come to rest."""

import gymnasium as gym
import numpy as np

from ves_gym.baselines.evaluate import evaluate
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


def test_the_reference_solves_and_doing_nothing_does_not():
    shares = []
    for name in ("zero", "resolved"):
        rows = evaluate(
            get_controller(name), "ves/DualArmReach-v0", episodes=10, threads=1
        ).rows
        shares.append(np.mean([row["success"] for row in rows]))
    assert shares[0] == 0 and shares[1] >= 0.95
