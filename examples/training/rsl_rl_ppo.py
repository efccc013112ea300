# /// script
# dependencies = ["rsl-rl-lib", "torch"]
# ///
"""PumaDamp by rsl_rl's PPO: `python rsl_rl_ppo.py [DECISIONS]`."""

from typing import Any

import torch
from puma_damp import BATCH, DECISIONS, ENVS, EPOCHS, HOLD, RATE, ROLLOUT, run, solved, vector
from rsl_rl.env import VecEnv
from rsl_rl.runners import OnPolicyRunner
from tensordict import TensorDict

MODEL = {"class_name": "MLPModel", "hidden_dims": [64, 64], "activation": "tanh"}


class Vector(VecEnv):
    """The environments as rsl_rl takes them."""

    def __init__(self) -> None:
        self.env = vector()
        self.num_envs, self.device, self.cfg = ENVS, "cpu", dict[str, Any]()
        self.num_actions = self.env.single_action_space.shape[0]
        self.max_episode_length = self.env.env.task.steps // HOLD
        self.episode_length_buf = torch.zeros(ENVS, dtype=torch.long)
        self.env.reset(seed=1)

    def get_observations(self) -> TensorDict:
        """Return the present observations."""
        return TensorDict({"policy": torch.as_tensor(self.env.observe())}, [ENVS])

    def step(self, actions: torch.Tensor) -> tuple[Any, ...]:
        """Hold actions; nothing is truncated."""
        _, reward, done, _, _ = self.env.step(actions.clamp(-1, 1).numpy())
        over = torch.as_tensor(done)
        self.episode_length_buf = torch.where(over, 0, self.episode_length_buf + 1)
        return self.get_observations(), torch.as_tensor(reward), over.long(), {}


def main(decisions: int = DECISIONS) -> float:
    """Train; the share of test episodes that the policy solves."""
    torch.manual_seed(0)
    torch.set_num_threads(1)
    noise = {"class_name": "GaussianDistribution", "init_std": 0.37, "std_type": "log"}
    runner = OnPolicyRunner(
        Vector(),
        {
            "num_steps_per_env": ROLLOUT,
            "save_interval": 10**6,
            "obs_groups": {"actor": ["policy"], "critic": ["policy"]},
            "actor": {**MODEL, "distribution_cfg": noise},
            "critic": dict(MODEL),
            "algorithm": {
                "class_name": "PPO",
                "num_learning_epochs": EPOCHS,
                "num_mini_batches": ROLLOUT * ENVS // BATCH,
                "learning_rate": RATE,
                "schedule": "adaptive",  # by the divergence of an update
                "desired_kl": 0.01,
                "entropy_coef": 0.0,
                "rnd_cfg": None,
                "symmetry_cfg": None,
            },
        },
    )
    runner.learn(max(1, decisions // (ROLLOUT * ENVS)))
    act = runner.get_inference_policy()
    with torch.no_grad():
        return solved(
            lambda x: act(TensorDict({"policy": torch.as_tensor(x)}, [len(x)])).numpy()
        )


if __name__ == "__main__":
    run(main)
