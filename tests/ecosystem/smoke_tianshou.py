# /// script
# dependencies = ["tianshou", "torch"]
# ///
"""Tianshou: PPO with its collectors and vector environments."""

import gymnasium as gym
import torch
from tianshou.algorithm import PPO
from tianshou.algorithm.modelfree.reinforce import ProbabilisticActorPolicy
from tianshou.algorithm.optim import AdamOptimizerFactory
from tianshou.data import Collector, VectorReplayBuffer
from tianshou.env import DummyVectorEnv, SubprocVectorEnv
from tianshou.trainer import OnPolicyTrainerParams
from tianshou.utils.net.common import Net
from tianshou.utils.net.continuous import ContinuousActorProbabilistic, ContinuousCritic
from torch.distributions import Independent, Normal

import ves_gym  # noqa: F401  files the ids


def make() -> gym.Env:
    """Return a short environment."""
    return gym.make("ves_gym:ves/PumaReach-v0", duration=0.25)


def main() -> str:
    """Train; return what was run."""
    torch.manual_seed(0)
    env = make()
    shapes = {"state_shape": env.observation_space.shape, "hidden_sizes": (32,)}
    actor = ContinuousActorProbabilistic(
        preprocess_net=Net(**shapes), action_shape=env.action_space.shape, unbounded=True
    )
    critic = ContinuousCritic(preprocess_net=Net(**shapes))
    policy = ProbabilisticActorPolicy(
        actor=actor,
        dist_fn=lambda pair: Independent(Normal(*pair), 1),
        action_space=env.action_space,
    )
    algorithm = PPO(policy=policy, critic=critic, optim=AdamOptimizerFactory(lr=1e-3))
    training, test = DummyVectorEnv([make] * 4), SubprocVectorEnv([make] * 2)
    collector = Collector(algorithm, training, VectorReplayBuffer(2000, 4))
    result = algorithm.run_training(
        OnPolicyTrainerParams(
            training_collector=collector,
            test_collector=Collector(algorithm, test),
            max_epochs=2,
            epoch_num_steps=320,
            update_step_num_repetitions=2,
            batch_size=64,
            collection_step_num_env_steps=160,
            test_step_num_episodes=2,
        )
    )
    test.close()
    assert result.train_step >= 640 and result.train_episode >= 30, result
    steps = result.train_step
    return f"PPO, {steps} steps of PumaReach in DummyVectorEnv, tested in SubprocVectorEnv"


if __name__ == "__main__":
    print("ran:", main())
