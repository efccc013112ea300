# /// script
# dependencies = ["skrl", "torch"]
# ///
"""PumaDamp by skrl's PPO: `python skrl_ppo.py [DECISIONS]`."""

from typing import Any

import torch
from puma_damp import BATCH, DECISIONS, ENVS, EPOCHS, RATE, ROLLOUT, run, solved, vector
from skrl.agents.torch.ppo import PPO
from skrl.envs.wrappers.torch import wrap_env
from skrl.memories.torch import RandomMemory
from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
from skrl.trainers.torch import SequentialTrainer
from skrl.utils import set_seed
from torch import nn


def network(inputs: int, outputs: int) -> nn.Sequential:
    """Return two hidden layers of 64; actions begin next to zero."""
    hidden = nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh()
    last = nn.Linear(64, outputs)
    nn.init.orthogonal_(last.weight, 0.01)
    return nn.Sequential(*hidden, last)


class Policy(GaussianMixin, Model):
    """Mean from a network, one standard deviation for all states."""

    def __init__(self, **spaces: object) -> None:
        Model.__init__(self, **spaces)
        GaussianMixin.__init__(self)
        self.net = network(self.num_observations, self.num_actions)
        self.log_std = nn.Parameter(torch.full((self.num_actions,), -1.0))

    def compute(self, inputs: dict[str, Any], role: str) -> tuple[torch.Tensor, dict[str, Any]]:
        """Return the mean of the actions."""
        return self.net(inputs["observations"]), {"log_std": self.log_std}


class Value(DeterministicMixin, Model):
    """Value of a state."""

    def __init__(self, **spaces: object) -> None:
        Model.__init__(self, **spaces)
        DeterministicMixin.__init__(self)
        self.net = network(self.num_observations, 1)

    def compute(self, inputs: dict[str, Any], role: str) -> tuple[torch.Tensor, dict[str, Any]]:
        """Return the value."""
        return self.net(inputs["observations"]), {}


def main(decisions: int = DECISIONS) -> float:
    """Train; the share of test episodes that the policy solves."""
    set_seed(0)
    torch.set_num_threads(1)
    env = wrap_env(vector(), wrapper="gymnasium")
    spaces = {
        "observation_space": env.observation_space,
        "action_space": env.action_space,
        "device": env.device,
    }
    policy = Policy(**spaces)
    updates = max(1, decisions // (ROLLOUT * ENVS))
    agent = PPO(
        models={"policy": policy, "value": Value(**spaces)},
        memory=RandomMemory(memory_size=ROLLOUT, num_envs=ENVS, device=env.device),
        cfg={
            "rollouts": ROLLOUT,
            "learning_epochs": EPOCHS,
            "mini_batches": ROLLOUT * ENVS // BATCH,
            "learning_rate": RATE,
            "learning_rate_scheduler": torch.optim.lr_scheduler.LinearLR,
            "learning_rate_scheduler_kwargs": {
                "start_factor": 1.0,
                "end_factor": 0.01,
                "total_iters": updates * EPOCHS,  # it is stepped every epoch
            },
            "value_loss_scale": 0.5,
            "experiment": {"write_interval": 0, "checkpoint_interval": 0},
        },
        **spaces,
    )
    settings = {"timesteps": updates * ROLLOUT, "headless": True, "disable_progressbar": True}
    SequentialTrainer(env=env, agents=agent, cfg=settings).train()
    with torch.no_grad():
        return solved(lambda x: policy.net(torch.as_tensor(x)).numpy())


if __name__ == "__main__":
    run(main)
