# /// script
# dependencies = ["tianshou", "torch"]
# ///
"""PumaDamp by Tianshou's PPO: `python tianshou_ppo.py [DECISIONS]`."""

from typing import Any

import numpy as np
import torch
from puma_damp import BATCH, DECISIONS, ENVS, EPOCHS, RATE, ROLLOUT, run, solved, vector
from tianshou.algorithm import PPO
from tianshou.algorithm.modelfree.reinforce import ProbabilisticActorPolicy
from tianshou.algorithm.optim import AdamOptimizerFactory, LRSchedulerFactoryLinear
from tianshou.data import Collector, VectorReplayBuffer
from tianshou.env import BaseVectorEnv
from tianshou.trainer import OnPolicyTrainerParams
from tianshou.utils.net.common import Net
from tianshou.utils.net.continuous import ContinuousActorProbabilistic, ContinuousCritic
from torch.distributions import Independent, Normal


class Vector(BaseVectorEnv):
    """The environments as Tianshou takes them: who is over is asked for its new episode."""

    def __init__(self) -> None:
        self.env, self.env_num, self.is_async, self.is_closed = vector(), ENVS, False, False
        self.action_space = [self.env.single_action_space] * ENVS
        self.waiting_id: list[int] = []

    def __getattribute__(self, key: str) -> Any:
        return object.__getattribute__(self, key)

    def reset(self, env_id: Any = None, **kwargs: Any) -> tuple[Any, Any]:
        """Begin all, or tell how those that are over have begun anew."""
        if env_id is None:
            self.env.reset(seed=1)
        ids = self._wrap_id(env_id)
        return self.env.observe()[ids], np.array([{"env_id": i} for i in ids])

    def step(self, action: Any, id: Any = None) -> tuple[Any, ...]:
        """Hold actions (n, a) of all."""
        after, reward, done, truncated, info = self.env.step(np.clip(action, -1.0, 1.0))
        after = info.get("final_obs", after)
        return after, reward, done, truncated, np.array([{"env_id": i} for i in range(ENVS)])


def main(decisions: int = DECISIONS) -> float:
    """Train; the share of test episodes that the policy solves."""
    torch.manual_seed(0)
    torch.set_num_threads(1)
    env = Vector()
    space = env.env.single_observation_space, env.env.single_action_space
    shapes = {
        "state_shape": space[0].shape,
        "hidden_sizes": (64, 64),
        "activation": torch.nn.Tanh,
    }
    actor = ContinuousActorProbabilistic(
        preprocess_net=Net(**shapes), action_shape=space[1].shape, unbounded=True
    )
    torch.nn.init.constant_(actor.sigma_param, -1.0)
    policy = ProbabilisticActorPolicy(
        actor=actor,
        dist_fn=lambda pair: Independent(Normal(*pair), 1),
        action_space=space[1],
        action_scaling=False,
        action_bound_method=None,
    )
    epochs = max(1, decisions // (ROLLOUT * ENVS))
    falling = LRSchedulerFactoryLinear(
        max_epochs=epochs,
        epoch_num_steps=ROLLOUT * ENVS,
        collection_step_num_env_steps=ROLLOUT * ENVS,
    )
    algorithm = PPO(
        policy=policy,
        critic=ContinuousCritic(preprocess_net=Net(**shapes)),
        optim=AdamOptimizerFactory(lr=RATE, eps=1e-5).with_lr_scheduler_factory(falling),
        gae_lambda=0.95,
        ent_coef=0.0,
        advantage_normalization=True,
        max_batchsize=ROLLOUT * ENVS,
    )
    collector = Collector(algorithm, env, VectorReplayBuffer(ROLLOUT * ENVS, ENVS))
    algorithm.run_training(
        OnPolicyTrainerParams(
            training_collector=collector,
            test_collector=None,
            max_epochs=epochs,
            epoch_num_steps=ROLLOUT * ENVS,
            update_step_num_repetitions=EPOCHS,
            batch_size=BATCH,
            collection_step_num_env_steps=ROLLOUT * ENVS,
            show_progress=False,
        )
    )
    with torch.no_grad():
        return solved(lambda x: actor(x)[0][0].numpy())


if __name__ == "__main__":
    run(main)
