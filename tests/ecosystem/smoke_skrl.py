# /// script
# dependencies = ["skrl", "torch"]
# ///
"""skrl: PPO on the native vector environment."""

import tempfile

import gymnasium as gym
import torch
from skrl.agents.torch.ppo import PPO
from skrl.envs.wrappers.torch import wrap_env
from skrl.memories.torch import RandomMemory
from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
from skrl.trainers.torch import SequentialTrainer
from skrl.utils import set_seed
from torch import nn

import ves_gym  # noqa: F401  files the ids

NUM_ENVS, STEPS = 4, 200


class Policy(GaussianMixin, Model):
    """Mean from a network, one standard deviation for all states."""

    def __init__(self, **spaces: object) -> None:
        Model.__init__(self, **spaces)
        GaussianMixin.__init__(self)
        self.net = nn.Sequential(
            nn.Linear(self.num_observations, 32), nn.Tanh(), nn.Linear(32, self.num_actions)
        )
        self.log_std = nn.Parameter(torch.zeros(self.num_actions))

    def compute(self, inputs, role):
        """Return the mean of the actions."""
        return self.net(inputs["observations"]), {"log_std": self.log_std}


class Value(DeterministicMixin, Model):
    """Value of a state."""

    def __init__(self, **spaces: object) -> None:
        Model.__init__(self, **spaces)
        DeterministicMixin.__init__(self)
        self.net = nn.Sequential(
            nn.Linear(self.num_observations, 32), nn.Tanh(), nn.Linear(32, 1)
        )

    def compute(self, inputs, role):
        """Return the value."""
        return self.net(inputs["observations"]), {}


def main() -> str:
    """Train; return what was run."""
    set_seed(0)
    env = wrap_env(gym.make_vec("ves/PumaReach-v0", num_envs=NUM_ENVS, duration=0.25))
    spaces = {
        "observation_space": env.observation_space,
        "action_space": env.action_space,
        "device": env.device,
    }
    models = {"policy": Policy(**spaces), "value": Value(**spaces)}
    before = [p.clone() for p in models["policy"].parameters()]
    with tempfile.TemporaryDirectory() as folder:
        logs = {"directory": folder, "write_interval": 0, "checkpoint_interval": 0}
        agent = PPO(
            models=models,
            memory=RandomMemory(memory_size=32, num_envs=NUM_ENVS, device=env.device),
            cfg={"rollouts": 32, "learning_epochs": 2, "experiment": logs},
            **spaces,
        )
        trainer = SequentialTrainer(
            env=env,
            agents=agent,
            cfg={"timesteps": STEPS, "headless": True, "disable_progressbar": True},
        )
        trainer.train()
    after = list(models["policy"].parameters())
    assert not any(torch.equal(a, b) for a, b in zip(before, after, strict=True))
    assert all(torch.isfinite(p).all() for p in after)
    return f"PPO on the native vector of {NUM_ENVS}: {STEPS * NUM_ENVS} steps of PumaReach"


if __name__ == "__main__":
    print("ran:", main())
