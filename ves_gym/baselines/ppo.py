"""Proximal policy optimisation on the native vector environment, in NumPy alone.

The algorithm is that of Schulman et al. (arXiv:1707.06347) with the details of
Stable-Baselines3's PPO, which it agrees with: from the same weights and the same data an update
gives the same weights (tests/baselines/test_ppo.py). Faster, for networks this small: nothing
is dispatched per operation, derivatives are written out, and an environment's arrays are used
as they come.

One iteration is `collect`, decisions of every environment, then `update`, from them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ves_gym._util.params import (
    Array,
    Index,
    Mask,
    ParameterError,
    require_least,
    require_positive,
)
from ves_gym.baselines.action_repeat import ActionRepeat, Endings
from ves_gym.baselines.arm_features import ArmFeatures
from ves_gym.baselines.perceptron import ActorCritic, Adam, Floats, clipped

_LEAST = 0.1  # of an entry's scale: what seldom moves saturates no network when it does


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Hyper-parameters, with Stable-Baselines3's names and defaults, and three more."""

    learning_rate: float = 3e-4
    n_steps: int = 2048  # decisions of every environment between updates
    batch_size: int = 64
    n_epochs: int = 10
    gamma: float = 0.99
    gae_lambda: float = 0.95
    clip_range: float = 0.2
    ent_coef: float = 0.0
    vf_coef: float = 0.5
    max_grad_norm: float = 0.5
    normalise: bool = False  # observations, by their mean and spread so far
    # Rewards less the mean of those that end no episode: a constant that changes nothing where
    # episodes are equally long, and which a critic would have to learn before anything else
    # ("Reward Centering", Naik et al., arXiv:2405.09999).
    centre: bool = False
    critic_first: int = 0  # updates at first that leave the actor as it is

    def __post_init__(self) -> None:
        require_least(self, 1, "n_steps", "n_epochs")
        require_least(self, 2, "batch_size")
        for name in ("gamma", "gae_lambda"):
            if not 0 <= getattr(self, name) <= 1:
                raise ParameterError(f"PPO: {name} must be 0 to 1, got {getattr(self, name)}")
        require_positive(self, "learning_rate", "clip_range", "max_grad_norm")


@dataclass
class Experience:
    """Decisions collected for an update: leading axes (n_steps, n)."""

    inputs: Floats  # observations as the networks take them
    beside: Floats  # what the critic alone sees
    action: Floats  # as drawn, not clipped
    chance: Floats  # logarithm of its density
    value: Floats
    reward: Floats
    over: Mask
    following: Floats  # (n,) values after the last step

    def advantages(self, gamma: float, gae_lambda: float) -> Floats:
        """(n_steps, n), generalised (Schulman et al., arXiv:1506.02438)."""
        out, ahead, following = np.empty_like(self.value), np.float32(0), self.following
        for t in reversed(range(len(out))):
            going = np.float32(gamma) * ~self.over[t]
            surprise = self.reward[t] + going * following - self.value[t]
            ahead = surprise + np.float32(gae_lambda) * going * ahead
            out[t], following = ahead, self.value[t]
        return out


class ObservationStack:
    """Observations as the networks take them: `frames` of them in a row, normalised.

    The oldest comes first, and an episode begins with so many times the same. `size` counts the
    numbers of one, its `features` included.
    """

    def __init__(self, size: int, frames: int, features: ArmFeatures | None = None) -> None:
        self.size, self.frames, self.features = size, frames, features
        self.mean = np.zeros(size * frames)
        self.variance = np.ones(size * frames)
        self.count = 0

    @property
    def spread(self) -> np.ndarray:
        """(inputs,) unit of each entry."""
        return np.maximum(np.sqrt(self.variance), _LEAST)

    def first(self, observation: Floats) -> Floats:
        """Rows (k, frames * size) at the beginning of episodes."""
        return np.tile(self._with_features(observation), self.frames)

    def after(self, rows: Floats, observation: Floats) -> Floats:
        """Rows after the next observation (k, size)."""
        newest = self._with_features(observation)
        if self.frames == 1:
            return newest
        return np.concatenate([rows[:, self.size :], newest], axis=1)

    def _with_features(self, observation: Floats) -> Floats:
        """Observations with their features."""
        if self.features is None:
            return observation
        extra = self.features(observation)
        return np.concatenate([observation, extra], axis=1, dtype=np.float32)

    def scaled(self, rows: Floats) -> Floats:
        """Rows by mean and spread."""
        if not self.count:
            return rows
        return ((rows - self.mean) / self.spread).astype(np.float32)

    def learn(self, scaled: Floats) -> tuple[Floats, Floats]:
        """Take rows (k, inputs), scaled so far, into mean and spread.

        Returns:
            shift, factor: (inputs,): what was x is `factor` x + `shift` in the new scale.
        """
        old, stretch = self.mean, self.spread
        rows = scaled.reshape(-1, scaled.shape[-1])
        mean = old + stretch * rows.mean(axis=0, dtype=float)
        variance = stretch**2 * rows.var(axis=0, dtype=float)
        share = len(rows) / (self.count + len(rows))
        difference = mean - old
        self.variance = (1 - share) * (self.variance if self.count else 0.0) + share * (
            variance + (1 - share) * difference**2
        )
        self.mean = old + share * difference
        self.count += len(rows)
        shift, factor = (self.mean - old) / stretch, self.spread / stretch
        return shift.astype(np.float32), factor.astype(np.float32)


def flat(observation: Any) -> Floats:
    """(..., o) an observation; the parts of a dictionary side by side, by name."""
    if isinstance(observation, Mapping):
        return np.concatenate([observation[k] for k in sorted(observation)], axis=-1)
    return np.asarray(observation)


class PPO:
    """The algorithm, between an environment and an actor with its critic.

    `rng` is of noise and of the batches' order, `on_endings` is called with every episode that
    ends; a `privileged` critic sees `Batch.privileged` beside the observation.
    """

    def __init__(
        self,
        env: ActionRepeat,
        agent: ActorCritic,
        stack: ObservationStack,
        settings: Settings,
        rng: np.random.Generator,
        on_endings: Callable[[Endings], None] = lambda endings: None,
        privileged: bool = False,
    ) -> None:
        self.privileged = privileged
        self.env, self.agent, self.stack, self.settings = env, agent, stack, settings
        self.rng, self.on_endings = rng, on_endings
        self.optimiser = Adam(len(agent.numbers))
        self.updates = 0
        self.logged: dict[str, float] = {}
        self.restart()

    def restart(self) -> None:
        """Every environment has begun an episode."""
        self.rows, self.beside = self.stack.first(flat(self.env.observe())), self._beside()

    def _beside(self) -> Floats:
        """(n, k) what the critic alone sees."""
        batch = self.env.env.batch
        return batch.privileged() if self.privileged else np.empty((batch.n, 0), np.float32)

    def _worth(self, inputs: Floats, beside: Floats) -> Floats:
        """(k,) values; overwritten by the next call."""
        if self.privileged:
            inputs = np.concatenate([inputs, beside], axis=1)
        return self.agent.critic(inputs)[:, 0]

    # ------------------------------------------------------------------ collect

    def collect(self) -> Experience:
        """Act for `n_steps` decisions in every environment."""
        k, n, agent = self.settings, self.env.env.num_envs, self.agent
        width = len(agent.log_std)
        inputs = np.empty((k.n_steps, n, self.rows.shape[1]), np.float32)
        beside = np.empty((k.n_steps, *self.beside.shape), np.float32)
        action = np.empty((k.n_steps, n, width), np.float32)
        reward = np.empty((k.n_steps, n), np.float32)
        over = np.empty((k.n_steps, n), bool)
        noise = self.rng.standard_normal(action.shape, np.float32)
        spread = np.exp(agent.log_std)
        for t in range(k.n_steps):
            inputs[t] = self.stack.scaled(self.rows)
            action[t] = agent.actor(inputs[t]) + spread * noise[t]
            beside[t] = self.beside
            reward[t], over[t] = self._step(np.clip(action[t], -1.0, 1.0))
        if k.centre and not over.all():
            reward -= reward[~over].mean()
        chance = -0.5 * np.square(noise).sum(axis=2) - self._volume()
        # all at once: a third of the time of a call per decision
        rows = (part.reshape(reward.size, part.shape[2]) for part in (inputs, beside))
        value = self._worth(*rows).reshape(reward.shape).copy()
        following = self._worth(self.stack.scaled(self.rows), self.beside).copy()
        return Experience(inputs, beside, action, chance, value, reward, over, following)

    def _volume(self) -> np.float32:
        """Minus the logarithm of the density of the mean action."""
        log_std = self.agent.log_std
        return np.float32(log_std.sum() + len(log_std) * math.log(2 * math.pi) / 2)

    def _step(self, actions: Floats) -> tuple[Array, Mask]:
        observation, reward, over, _, info = self.env.step(actions)
        for ended in info.get("endings", ()):
            self.on_endings(ended)
        new, self.beside = flat(observation), self._beside()
        self.rows = self.stack.after(self.rows, new)
        if over.any():
            ids = np.flatnonzero(over)
            self.rows[ids] = self.stack.first(new[ids])
        return reward, over

    # ------------------------------------------------------------------- update

    def update(
        self, rollout: Experience, rate: float, orders: Iterable[Index] | None = None
    ) -> None:
        """Learn from a rollout; `orders` of its decisions (n_steps * n,), an epoch each."""
        k = self.settings
        gain = rollout.advantages(k.gamma, k.gae_lambda)
        aim = (gain + rollout.value).ravel()
        count = len(aim)
        parts = (
            rollout.inputs.reshape(count, -1),
            rollout.beside.reshape(count, rollout.beside.shape[2]),
            rollout.action.reshape(count, -1),
            rollout.chance.ravel(),
            gain.ravel(),
            aim,
        )
        figures: list[tuple[float, ...]] = []
        if orders is None:
            orders = (self.rng.permutation(count) for _ in range(k.n_epochs))
        for order in orders:
            for start in range(0, count, k.batch_size):
                at = order[start : start + k.batch_size]
                figures.append(self._learn([part.take(at, axis=0) for part in parts], rate))
        self.updates += 1
        names = ("clip_fraction", "policy_gradient_loss", "value_loss", "approx_kl")
        self.logged = dict(zip(names, np.mean(figures, axis=0).tolist(), strict=True))
        last = figures[-math.ceil(count / k.batch_size) :]  # of the last epoch
        self.logged["approx_kl"] = float(np.mean([divergence for *_, divergence in last]))
        self.logged["std"] = float(np.exp(self.agent.log_std).mean())
        self.logged["learning_rate"] = rate
        spread = aim.var()
        self.logged["explained_variance"] = float(1 - gain.var() / spread) if spread else 0.0
        if k.normalise:
            self.agent.rescale(*self.stack.learn(rollout.inputs))

    def _learn(self, batch: list[Floats], rate: float) -> tuple[float, float, float, float]:
        """One step of the optimiser; share clipped, losses of both, KL divergence."""
        inputs, beside, action, chance, gain, aim = batch
        # sums, for `mean` and `std` take ten times as long of so few numbers
        k, agent, count = self.settings, self.agent, np.float32(len(aim))
        if len(gain) > 1:
            gain = gain - gain.sum() / count
            gain /= np.sqrt(gain @ gain / (count - 1)) + np.float32(1e-8)
        inverse = np.exp(-agent.log_std)
        z = (action - agent.actor(inputs)) * inverse
        square = z * z
        log_ratio = -0.5 * square.sum(axis=1) - self._volume() - chance
        ratio = np.exp(log_ratio)
        divergence = float((ratio - 1 - log_ratio).sum() / count)
        limit = 1 + np.float32(k.clip_range) * np.sign(gain)
        beyond = np.where(gain > 0, ratio > limit, ratio < limit)
        # by the logarithm of the density: the clipped ratio does not depend on it
        slope = np.where(beyond, 0, ratio * gain) * (-1 / count)
        agent.actor.backward(slope[:, None] * (z * inverse))
        agent.log_std_slope[:] = slope @ (square - 1) - np.float32(k.ent_coef)
        miss = self._worth(inputs, beside) - aim
        agent.critic.backward((np.float32(2 * k.vf_coef) / count * miss)[:, None])
        if self.updates < k.critic_first:
            agent.slopes[: agent.actor_size] = 0
        clipped(agent.slopes, k.max_grad_norm)
        self.optimiser.step(agent.numbers, agent.slopes, rate)
        loss = float(-np.where(beyond, limit, ratio) @ gain / count)
        outside = np.count_nonzero(np.abs(ratio - 1) > k.clip_range) / len(aim)
        return outside, loss, float(miss @ miss / count), divergence

    # -------------------------------------------------------------------- state

    def state(self) -> dict[str, Any]:
        """Everything that the next iteration depends on, but the environment's own."""
        return {
            "numbers": self.agent.numbers.copy(),
            "optimiser": self.optimiser.state(),
            "stack": (self.stack.mean, self.stack.variance, self.stack.count),
            "rows": (self.rows, self.beside),
            "updates": self.updates,
            "logged": self.logged,
            "random": self.rng.bit_generator.state,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a state."""
        self.agent.numbers[:] = state["numbers"]
        self.optimiser.restore(state["optimiser"])
        self.stack.mean, self.stack.variance, self.stack.count = state["stack"]
        self.rows, self.beside = state["rows"]
        self.updates, self.logged = state["updates"], state["logged"]
        self.rng.bit_generator.state = state["random"]
