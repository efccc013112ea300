"""Learning what a controller does before learning from rewards.

DAgger (Ross, Gordon & Bagnell 2011, arXiv:1011.0686): first the controller acts, then now the
controller and now the policy, then the policy, and always the controller says what it would do.
So the policy sees the states that its own mistakes lead to, with what mends them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ves_gym._util.params import Index, ParameterError
from ves_gym.baselines.controllers import Controller
from ves_gym.baselines.decisions import Decisions
from ves_gym.baselines.perceptron import ActorCritic, Adam, Floats, clipped
from ves_gym.baselines.ppo import ObservationStack, flat

_NORM = 1.0  # largest norm of the derivatives
_LATE = 0.6  # share of an episode


@dataclass(frozen=True, kw_only=True)
class ImitationConfig:
    """How long to imitate, and how."""

    rounds: int = 20  # each an episode of every environment
    expert_rounds: int = (
        10  # rounds over which the controller's share of the actions falls to none
    )
    noise: float = 0.1  # standard deviation of what is added to the actions
    recall: int = 10  # rounds that are learned from, the latest
    epochs: int = 4  # per round, of what is remembered
    batches: int = 0  # per round, drawn from what is remembered; 0: its epochs
    late: float = 0.0  # how much more counts what is seen after `_LATE` of an episode
    batch_size: int = 1024
    learning_rate: float = 1e-3  # falls linearly to a tenth

    def __post_init__(self) -> None:
        for name in ("rounds", "expert_rounds", "recall", "epochs", "batch_size"):
            if getattr(self, name) < 1:
                raise ParameterError(
                    f"imitation: {name} must be >= 1, got {getattr(self, name)}"
                )
        for name in ("noise", "batches", "late"):
            if not getattr(self, name) >= 0:
                raise ParameterError(
                    f"imitation: {name} must be >= 0, got {getattr(self, name)}"
                )
        if not self.learning_rate > 0:
            raise ParameterError(f"imitation needs learning_rate > 0, got {self.learning_rate}")


class Imitation:
    """Rounds of episodes, each learned from.

    Args:
        env: where.
        agent: whose actor learns.
        stack: how it sees; its scale is that of the first round from then on.
        expert: says what to do.
        config: how many.
        rng: of noise and of the batches' order.
    """

    def __init__(
        self,
        env: Decisions,
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
        """One episode per environment: raw observations (k, o) and the expert's actions.

        Args:
            share: of the actions that are the expert's.
        """
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
            observation, _, over, _ = self.env.step(np.clip(moved, -1.0, 1.0))
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
