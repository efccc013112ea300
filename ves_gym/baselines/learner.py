"""The learner of `train`: imitation of a controller, PPO, or one after the other.

Imitation is DAgger (Ross, Gordon & Bagnell 2011, arXiv:1011.0686): first the controller acts,
then now the controller and now the policy, then the policy, and always the controller says what
it would do. So the policy sees the states that its own mistakes lead to, with what mends them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import spaces

from ves_gym._util.params import (
    Index,
    ParameterError,
    from_plain,
    require_least,
    require_positive,
)
from ves_gym.baselines.action_repeat import ActionRepeat, Endings
from ves_gym.baselines.arm_features import arm_features
from ves_gym.baselines.config import TrainConfig
from ves_gym.baselines.controllers import Controller
from ves_gym.baselines.evaluate import make_vector
from ves_gym.baselines.perceptron import ActorCritic, Adam, Floats, clipped
from ves_gym.baselines.policy import Network, Policy
from ves_gym.baselines.ppo import PPO, ObservationStack, Settings, flat
from ves_gym.baselines.registry import get_controller
from ves_gym.envs.vector import VesVectorEnv

_NORM = 1.0  # largest norm of the derivatives
_LATE = 0.6  # share of an episode


@dataclass(frozen=True, kw_only=True)
class ImitationConfig:
    """Length and settings of imitation."""

    rounds: int = 20  # each an episode of every environment
    expert_rounds: int = 10  # over which the controller's share of the actions falls to none
    noise: float = 0.1  # standard deviation of what is added to the actions
    recall: int = 10  # rounds that are learned from, the latest
    epochs: int = 4  # per round, of what is remembered
    batches: int = 0  # per round, drawn from what is remembered; 0: its epochs
    late: float = 0.0  # how much more counts what is seen after `_LATE` of an episode
    batch_size: int = 1024
    learning_rate: float = 1e-3  # falls linearly to a tenth

    def __post_init__(self) -> None:
        require_least(self, 1, "rounds", "expert_rounds", "recall", "epochs", "batch_size")
        require_least(self, 0, "noise", "batches", "late")
        require_positive(self, "learning_rate")


class Imitation:
    """Rounds of episodes, each learned from; the scale of `stack` is that of the first one."""

    def __init__(
        self,
        env: ActionRepeat,
        agent: ActorCritic,
        stack: ObservationStack,
        expert: Controller,
        config: ImitationConfig,
        rng: np.random.Generator,
    ) -> None:
        self.env, self.agent, self.stack, self.expert = env, agent, stack, expert
        self.config, self.rng = config, rng
        self.optimiser = Adam(len(agent.numbers))
        self.round = 0
        self.memory: list[tuple[Floats, Floats]] = []  # rows, targets: of the latest rounds
        self.logged: dict[str, float] = {}

    @property
    def over(self) -> bool:
        """All rounds are done."""
        return self.round >= self.config.rounds

    @property
    def decisions(self) -> int:
        """Decisions of a round."""
        return self._periods * self.env.env.num_envs

    @property
    def _periods(self) -> int:
        """Decisions of an episode."""
        return -(-self.env.env.task.steps // self.env.hold)

    def advance(self) -> int:
        """One round; the decisions that it took."""
        rows, targets = self._episode(max(0.0, 1 - self.round / self.config.expert_rounds))
        if not self.stack.count:
            self.stack.learn(rows)
        self.memory = [*self.memory, (rows, targets)][-self.config.recall :]
        share = self.round / max(1, self.config.rounds - 1)
        self._learn(self.config.learning_rate * (1 - 0.9 * share))
        self.round += 1
        if self.over:
            self.memory = []
        return len(rows)

    def _episode(self, share: float) -> tuple[Floats, Floats]:
        """An episode of each: raw observations, the expert's actions; a share acts."""
        env = self.env.env
        everyone = np.arange(env.num_envs)
        env.reset()
        self.expert.reset(env, everyone)
        rows = self.stack.first(flat(self.env.observe()))
        inputs, targets = [], []
        for remaining in reversed(range(self._periods)):
            target = np.clip(self.expert.act(env, None), -1.0, 1.0).astype(np.float32)
            inputs.append(rows)
            targets.append(target)
            action = self.agent.actor(self.stack.scaled(rows))
            expert_acts = self.rng.random(len(action)) < share
            action = np.where(expert_acts[:, None], target, action)
            noise = self.rng.standard_normal(target.shape, np.float32)
            moved = action + np.float32(self.config.noise) * noise
            observation, _, over, *_ = self.env.step(np.clip(moved, -1.0, 1.0))
            new = flat(observation)
            rows = self.stack.after(rows, new)
            if over.any():
                ids = np.flatnonzero(over)
                rows[ids] = self.stack.first(new[ids])
                if remaining:  # after the last all begin anew
                    self.expert.reset(env, ids)
        return np.concatenate(inputs), np.concatenate(targets)

    def _learn(self, rate: float) -> None:
        """Least squares, over what is remembered."""
        k, agent = self.config, self.agent
        rows = self.stack.scaled(np.concatenate([rows for rows, _ in self.memory]))
        targets = np.concatenate([targets for _, targets in self.memory])
        late = np.arange(len(rows)) % self.decisions >= _LATE * self.decisions
        weight = np.where(late, 1 + k.late, 1).astype(np.float32)
        weight /= weight.mean()
        agent.slopes[:] = 0  # the critic's stay so
        errors = []
        for at in self._batches(len(rows)):
            gap = agent.actor(rows[at]) - targets[at]
            errors.append(float(np.square(gap).mean()))
            gap *= np.float32(2 / gap.size) * weight[at][:, None]
            agent.actor.backward(gap)
            clipped(agent.slopes, _NORM)
            self.optimiser.step(agent.numbers, agent.slopes, rate)
        last = -(-len(errors) // k.epochs)
        self.logged = {
            "imitation_error": float(np.sqrt(np.mean(errors[-last:]))),
            "learning_rate": rate,
        }

    def _batches(self, count: int) -> Iterator[Index]:
        """Rows of the batches of a round, of so many rows."""
        k = self.config
        for _ in range(k.batches):
            yield self.rng.integers(0, count, k.batch_size)
        for _ in range(0 if k.batches else k.epochs):
            order = self.rng.permutation(count)
            for start in range(0, count, k.batch_size):
                yield order[start : start + k.batch_size]

    def state(self) -> dict[str, Any]:
        """Everything that the next round depends on, but agent, stack and environment."""
        return {
            "round": self.round,
            "memory": self.memory,
            "optimiser": self.optimiser.state(),
            "logged": self.logged,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a state."""
        self.round, self.memory, self.logged = state["round"], state["memory"], state["logged"]
        self.optimiser.restore(state["optimiser"])


class Learner:
    """`PPO`, after `Imitation` where the configuration names a controller.

    Args:
        config: of the run.
        seed: of weights, exploration and, plus `episodes`, the episodes.
        env: its environment, taken over.
        episodes: see `seed`.
        on_endings: called with every episode that ends while rewards are learned from.
    """

    def __init__(
        self,
        config: TrainConfig,
        seed: int,
        env: VesVectorEnv,
        episodes: int = 0,
        on_endings: Callable[[Endings], None] = lambda endings: None,
    ) -> None:
        settings: Settings = from_plain(Settings, config.hyperparameters, "PPO")
        self.config, self.settings, self.steps = config, settings, 0
        self._settings, self._first = config.settings, episodes + seed
        env.reset(seed=self._first)
        self.decisions = ActionRepeat(env, hold=config.hold, reward_scale=config.reward_scale)
        rng = np.random.default_rng(seed)
        size = flat(self.decisions.observe()).shape[1]
        features = arm_features(env.task, env.goal) if config.features else None
        size += features.size if features else 0
        self.stack = ObservationStack(size, config.frames, features)
        sizes = (size * config.frames, *config.layers, env.batch.width)
        privileged = config.critic == "privileged"
        beside = env.batch.privileged().shape[1] if privileged else 0
        self.agent = ActorCritic(sizes, config.activation, config.log_std, rng, beside)
        parts = self.decisions, self.agent, self.stack, settings, rng, on_endings
        self.ppo = PPO(*parts, privileged)
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
        """Train up to `total` decisions; `between` is called between rollouts."""
        while self.steps < total:
            self._meet_curriculum()
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

    def _meet_curriculum(self) -> None:
        """Go on in the environment of the present settings, where it is another one."""
        k, old, settings = self.config, self.decisions.env, self.config.settings_at(self.steps)
        if settings != self._settings:
            self._settings = settings
            env = make_vector(k.env, k.n_envs, old.autoreset_mode, threads=1, **settings)
            env.reset(seed=self._first)
            old.close()
            self.decisions.env = env
            self.ppo.restart()

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
        """Everything that training depends on from here, but the environment."""
        return {
            "steps": self.steps,
            "ppo": self.ppo.state(),
            "imitation": None if self.imitation is None else self.imitation.state(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a state."""
        self.steps = state["steps"]
        self._meet_curriculum()
        self.ppo.restore(state["ppo"])
        if self.imitation is not None:
            self.imitation.restore(state["imitation"])
