"""`NativeLearner`: imitation, PPO, or one after the other, in NumPy, as `train` runs them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from gymnasium import spaces

from ves_gym._util.params import ParameterError, from_plain
from ves_gym.baselines.arm_features import arm_features
from ves_gym.baselines.config import TrainConfig
from ves_gym.baselines.decisions import Decisions, Endings
from ves_gym.baselines.imitation import Imitation, ImitationConfig
from ves_gym.baselines.perceptron import ActorCritic
from ves_gym.baselines.policy import Network, Policy
from ves_gym.baselines.ppo import PPO, ObservationStack, Settings, flat
from ves_gym.baselines.registry import get_controller
from ves_gym.envs.vector import VesVectorEnv


class NativeLearner:
    """`PPO`, after `Imitation` where the configuration names a controller; `train.Learner`."""

    def __init__(
        self,
        config: TrainConfig,
        seed: int,
        env: VesVectorEnv,
        episodes: int,
        on_endings: Callable[[Endings], None],
    ) -> None:
        settings: Settings = from_plain(Settings, config.hyperparameters, "PPO")
        self.config, self.settings, self.steps = config, settings, 0
        env.reset(seed=episodes + seed)
        self.decisions = Decisions(env, hold=config.hold, reward_scale=config.reward_scale)
        rng = np.random.default_rng(seed)
        size = flat(self.decisions.observe()).shape[1]
        features = arm_features(env.task, env.goal) if config.features else None
        size += features.size if features else 0
        self.stack = ObservationStack(size, config.frames, features)
        sizes = (size * config.frames, *config.layers, env.batch.width)
        self.agent = ActorCritic(sizes, config.activation, config.log_std, rng)
        self.ppo = PPO(self.decisions, self.agent, self.stack, settings, rng, on_endings)
        self.imitation: Imitation | None = None
        if config.imitate:
            expert = get_controller(config.imitate, seed)
            chosen: ImitationConfig = from_plain(ImitationConfig, config.imitation, "imitation")
            self.imitation = Imitation(
                self.decisions, self.agent, self.stack, expert, chosen, rng
            )
            steps = chosen.rounds * self.imitation.decisions
            if config.algorithm == "DAgger" and steps != config.total_timesteps:
                raise ParameterError(
                    f"TrainConfig.total_timesteps of DAgger are those of its rounds, {steps},"
                    f" got {config.total_timesteps}"
                )

    def learn(self, total: int, between: Callable[[], None]) -> None:
        """See `train.Learner`."""
        while self.steps < total:
            between()
            if self.imitation is not None and not self.imitation.over:
                self.steps += self.imitation.advance()
                if self.imitation.over:
                    self.decisions.env.reset()
                    self.ppo.restart()
            else:
                rollout = self.ppo.collect()
                self.steps += rollout.over.size
                remaining = 1 - self.steps / total
                rate = self.config.learning_rate(self.settings.learning_rate, remaining)
                self.ppo.update(rollout, rate)

    @property
    def logged(self) -> dict[str, float]:
        """Figures of the last update."""
        if self.imitation is not None and not self.ppo.updates:
            return self.imitation.logged
        return self.ppo.logged

    def policy(self, about: Mapping[str, Any]) -> Policy:
        """Return the policy as it is now, scaling included in its first layer."""
        config, space = self.config, self.decisions.env.single_observation_space
        layers = [(W.astype(float), b.astype(float)) for W, b in self.agent.actor.layers]
        W, b = layers[0]
        layers[0] = (
            W / self.stack.spread[:, None],
            b - (self.stack.mean / self.stack.spread) @ W,
        )
        network = Network(
            sizes=(len(W), *(len(b) for _, b in layers)),
            activation=config.activation,
            observation_limit=self.decisions.env.task.CLIP,
            inputs=tuple(space.spaces) if isinstance(space, spaces.Dict) else (),
            hold=config.hold,
            frames=config.frames,
            features=self.stack.features,
        )
        return Policy(network, tuple(layers), dict(about), config.label)

    def state(self) -> dict[str, Any]:
        """See `train.Learner`."""
        return {
            "steps": self.steps,
            "ppo": self.ppo.state(),
            "imitation": None if self.imitation is None else self.imitation.state(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a state."""
        self.steps = state["steps"]
        self.ppo.restore(state["ppo"])
        if self.imitation is not None:
            self.imitation.restore(state["imitation"])
