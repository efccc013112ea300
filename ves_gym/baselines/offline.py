"""Offline learning: a policy from a data set alone, by behaviour cloning or by IQL.

Implicit Q-learning (Kostrikov, Nair & Levine 2021, arXiv:2110.06169) never asks what an action
that is not in the data is worth. A value network learns an expectile of the critics' values
over the data's actions, the critics learn rewards plus the value of what follows, and the
policy imitates the data's actions, the more the better they were: weight exp(beta * advantage).
Behaviour cloning is the same policy with all weights one.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ves_gym._util.optional import require
from ves_gym._util.params import ParameterError, require_choice
from ves_gym.baselines.dataset import Episode, flat_observations
from ves_gym.baselines.policy import Network, Policy, _layers, versions

if TYPE_CHECKING:
    import torch

METHODS = ("bc", "iql")
_MOST = 100.0  # largest weight of an action, as in the paper

Progress = Callable[[int, dict[str, float]], None]


@dataclass(frozen=True, kw_only=True)
class OfflineConfig:
    """Hyper-parameters; those of IQL under the paper's names."""

    method: str = "iql"
    steps: int = 20_000  # updates of every network
    batch_size: int = 256
    layers: tuple[int, ...] = (256, 256)
    learning_rate: float = 3e-4  # of the policy it falls to zero along a cosine
    gamma: float = 0.99  # discount per control period
    expectile: float = 0.7
    beta: float = 3.0  # inverse temperature of the weights
    polyak: float = 0.005  # of the target critics, per update
    reward_scale: float = 1.0

    def __post_init__(self) -> None:
        require_choice(self, "method", METHODS)
        if min(self.steps, self.batch_size, *self.layers) < 1 or not self.layers:
            raise ParameterError("OfflineConfig needs steps, batch_size and layers >= 1")
        if not (0 < self.gamma <= 1 and 0.5 <= self.expectile < 1 and 0 < self.polyak <= 1):
            raise ParameterError(
                "OfflineConfig needs 0 < gamma <= 1, 0.5 <= expectile < 1 and 0 < polyak <= 1,"
                f" got {self.gamma}, {self.expectile} and {self.polyak}"
            )


def train_offline(
    episodes: Sequence[Episode],
    config: OfflineConfig,
    seed: int = 0,
    *,
    about: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
) -> Policy:
    """Learn a policy from episodes, on one thread: the same seed gives the same policy.

    Args:
        episodes: of a data set, of one environment.
        config: how.
        seed: of initial weights and of batches.
        about: where the data come from, for the policy's file.
        progress: called with the updates done and the losses, a hundred times.
    """
    require("offline learning", "torch")
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            learner = _Learner(_transitions(episodes, config), config, seed)
            for step in range(config.steps):
                losses = learner.update()
                if progress is not None and (step + 1) % max(1, config.steps // 100) == 0:
                    progress(step + 1, {k: v.item() for k, v in losses.items()})
    finally:
        torch.set_num_threads(threads)
    first = episodes[0].observations
    layers, _ = _layers(list(learner.actor))
    network = Network(
        sizes=(layers[0][0].shape[0], *(W.shape[1] for W, _ in layers)),
        activation="relu",
        output="tanh",
        inputs=tuple(sorted(first)) if isinstance(first, Mapping) else (),
    )
    made = {"algorithm": config.method, "seed": seed, "steps": config.steps}
    made |= {"versions": versions("torch"), **dict(about or {})}
    return Policy(network, tuple(layers), made, config.method)


def _transitions(episodes: Sequence[Episode], config: OfflineConfig) -> dict[str, torch.Tensor]:
    """Observation, action, reward, what follows, and whether the episode is over by then."""
    import torch

    if not episodes:
        raise ParameterError("offline learning needs episodes, got none")
    rows = [flat_observations(e.observations) for e in episodes]
    columns: dict[str, list[Any]] = {
        "now": [row[:-1] for row in rows],
        "next": [row[1:] for row in rows],
        "action": [e.actions for e in episodes],
        "reward": [config.reward_scale * e.rewards for e in episodes],
        "over": [e.terminations for e in episodes],  # a truncated one would have gone on
    }
    return {
        name: torch.from_numpy(np.concatenate(parts).astype(np.float32))
        for name, parts in columns.items()
    }


class _Learner:
    """Networks and their optimisers."""

    def __init__(self, data: dict[str, torch.Tensor], config: OfflineConfig, seed: int) -> None:
        import torch

        self.data, self.config = data, config
        width, moves = data["now"].shape[1], data["action"].shape[1]
        self.actor = _perceptron((width, *config.layers, moves))
        self.value = _perceptron((width, *config.layers, 1))
        self.critics = torch.nn.ModuleList(
            _perceptron((width + moves, *config.layers, 1)) for _ in range(2)
        )
        self.targets = copy.deepcopy(self.critics)
        parts = (self.actor, self.value, self.critics)
        self.optimisers = [
            torch.optim.Adam(part.parameters(), lr=config.learning_rate) for part in parts
        ]
        self.schedule = torch.optim.lr_scheduler.CosineAnnealingLR(
            self.optimisers[0], config.steps
        )
        self.rng = np.random.default_rng(seed)

    def update(self) -> dict[str, torch.Tensor]:
        """One batch through all networks; the losses."""
        import torch

        size = min(self.config.batch_size, len(self.data["now"]))
        rows = torch.from_numpy(self.rng.integers(len(self.data["now"]), size=size))
        batch = {name: column[rows] for name, column in self.data.items()}
        losses: dict[str, torch.Tensor] = {}
        weights = torch.ones(size)
        if self.config.method == "iql":
            losses, weights = self._values(batch)
        # the network ends before the tanh that brings its actions into [-1, 1]
        gap = torch.tanh(self.actor(batch["now"])) - batch["action"]
        losses["actor"] = (weights * gap.square().sum(1)).mean()
        self._step(0, losses["actor"])
        self.schedule.step()
        return losses

    def _values(
        self, batch: dict[str, torch.Tensor]
    ) -> tuple[dict[str, torch.Tensor], torch.Tensor]:
        """Equations 5 to 7 of the paper: losses, and the weights of the data's actions."""
        import torch

        k = self.config
        pair = torch.cat([batch["now"], batch["action"]], 1)
        with torch.no_grad():
            worth = torch.minimum(*(q(pair)[:, 0] for q in self.targets))
            later = self.value(batch["next"])[:, 0]
            aim = batch["reward"] + k.gamma * (1 - batch["over"]) * later
        advantage = worth - self.value(batch["now"])[:, 0]
        share = torch.where(advantage > 0, k.expectile, 1 - k.expectile)
        losses = {"value": (share * advantage.square()).mean()}
        self._step(1, losses["value"])
        losses["critic"] = torch.stack(
            [(q(pair)[:, 0] - aim).square().mean() for q in self.critics]
        ).sum()
        self._step(2, losses["critic"])
        with torch.no_grad():
            for mean, new in zip(
                self.targets.parameters(), self.critics.parameters(), strict=True
            ):
                mean.lerp_(new, k.polyak)
        return losses, torch.exp(k.beta * advantage.detach()).clamp(max=_MOST)

    def _step(self, which: int, loss: torch.Tensor) -> None:
        self.optimisers[which].zero_grad()
        loss.backward()
        self.optimisers[which].step()


def _perceptron(sizes: Sequence[int]) -> torch.nn.Sequential:
    """Linear modules with ReLU between them."""
    from torch import nn

    modules: list[nn.Module] = []
    for k in range(len(sizes) - 1):
        modules.append(nn.Linear(sizes[k], sizes[k + 1]))
        if k + 2 < len(sizes):
            modules.append(nn.ReLU())
    return nn.Sequential(*modules)
