"""Proximal policy optimisation whose data never leave the device that simulates.

Short on purpose: one optimiser, tensors of `DeviceVectorEnv` as they come. What the host sees
is one mean return per update. Policies to keep are trained by `ves-gym train`.

    python -m benchmarks.device_ppo                        # a GPU, within three minutes
    python -m benchmarks.device_ppo --n 64 --updates 40    # Warp's CPU device
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from typing import Any

import torch
from torch import nn

from ves_gym.envs.device import DeviceVectorEnv


@dataclass(frozen=True)
class Settings:
    """Numbers of the algorithm (Schulman et al. 2017, arXiv:1707.06347)."""

    horizon: int = 32  # periods between updates
    epochs: int = 4
    minibatches: int = 4
    rate: float = 1e-3  # of Adam
    discount: float = 0.99
    trace: float = 0.95  # lambda of the advantages
    clip: float = 0.2
    hidden: int = 64


@dataclass(frozen=True)
class Progress:
    """What a training was like."""

    returns: list[float]  # mean of the episodes that ended in each update; NaN: none
    steps: int
    seconds: float
    stepping: float  # seconds of it in `env.step`


class Policy(nn.Module):
    """Gaussian actions and values from two networks of two layers."""

    def __init__(self, observations: int, actions: int, hidden: int) -> None:
        super().__init__()

        def layers(out: int) -> nn.Sequential:
            sizes = [nn.Linear(observations, hidden), nn.Linear(hidden, hidden)]
            last = nn.Linear(hidden, out)
            nn.init.orthogonal_(last.weight, 0.01)
            return nn.Sequential(sizes[0], nn.Tanh(), sizes[1], nn.Tanh(), last)

        self.mean, self.worth = layers(actions), layers(1)
        self.spread = nn.Parameter(torch.full((actions,), -0.5))

    def forward(self, rows: Any) -> tuple[Any, Any]:
        """Distribution of actions, and values."""
        actions = torch.distributions.Normal(self.mean(rows), self.spread.exp())
        return actions, self.worth(rows)[:, 0]


def train(
    env: DeviceVectorEnv, updates: int, *, settings: Settings | None = None, seed: int = 0
) -> tuple[Policy, Progress]:
    """Train a policy.

    Args:
        env: where.
        updates: how many, of `horizon` periods of every simulation each.
        settings: of the algorithm.
        seed: of episodes, network and actions.
    """
    k = settings or Settings()
    torch.manual_seed(seed)
    device, n = env.device, env.num_envs
    sizes = (env.single_observation_space.shape[0], env.single_action_space.shape[0])
    policy = Policy(*sizes, k.hidden).to(device)
    optimiser = torch.optim.Adam(policy.parameters(), k.rate, eps=1e-5)
    rows, _ = env.reset(seed=seed)
    running = torch.zeros(n, device=device)
    returns, stepping, begin = [], 0.0, time.perf_counter()
    for _ in range(updates):
        columns = {name: [] for name in ("rows", "action", "chance", "value", "reward", "over")}
        ended, summed = torch.zeros((), device=device), torch.zeros((), device=device)
        for _ in range(k.horizon):
            with torch.no_grad():
                actions, value = policy(rows)
                action = actions.sample()
                chance = actions.log_prob(action).sum(1)
            start = time.perf_counter()
            after, reward, terminated, truncated, info = env.step(action)
            stepping += time.perf_counter() - start
            reward, over = reward.float(), terminated | truncated
            running += reward
            if "final_obs" in info:
                ended += over.sum()
                summed += running[over].sum()
                running = torch.where(over, 0.0, running)
                with torch.no_grad():  # what lies beyond a truncation counts
                    reward = reward + k.discount * truncated * policy(info["final_obs"])[1]
            parts = (rows, action, chance, value, reward, over)
            for column, part in zip(columns.values(), parts, strict=True):
                column.append(part)
            rows = after
        _improve(policy, optimiser, k, {m: torch.stack(v) for m, v in columns.items()}, rows)
        returns.append(float(summed / ended))  # the host waits here, once per update
    seconds = time.perf_counter() - begin
    return policy, Progress(returns, updates * k.horizon * n, seconds, stepping)


def _improve(
    policy: Policy, optimiser: Any, k: Settings, data: dict[str, Any], last: Any
) -> None:
    """One update from columns (horizon, n, ...) and the observations that follow them."""
    with torch.no_grad():
        following = policy(last)[1]
    advantage, ahead = torch.zeros_like(data["reward"]), torch.zeros_like(following)
    for t in reversed(range(k.horizon)):
        going = ~data["over"][t]
        surprise = data["reward"][t] + k.discount * going * following - data["value"][t]
        ahead = surprise + k.discount * k.trace * going * ahead
        advantage[t], following = ahead, data["value"][t]
    aim = (advantage + data["value"]).flatten()
    advantage = advantage.flatten()
    rows = {name: data[name].flatten(0, 1) for name in ("rows", "action", "chance")}
    count = len(aim)
    for _ in range(k.epochs):
        order = torch.randperm(count, device=aim.device)
        for at in order.split(-(-count // k.minibatches)):
            actions, value = policy(rows["rows"][at])
            chance = actions.log_prob(rows["action"][at]).sum(1)
            ratio = (chance - rows["chance"][at]).exp()
            gain = advantage[at]
            gain = (gain - gain.mean()) / (gain.std() + 1e-8)
            bounded = ratio.clamp(1 - k.clip, 1 + k.clip)
            loss = -torch.minimum(ratio * gain, bounded * gain).mean()
            loss = loss + 0.5 * (value - aim[at]).square().mean()
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(policy.parameters(), 0.5)
            optimiser.step()


def main() -> None:
    """Train and print the curve, the rate, and what share of it is in `env.step`."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--task", default="lqr", help="of `build_task` (lqr: BeamLQR)")
    parser.add_argument("--n", type=int, default=8192, help="simulations")
    parser.add_argument("--updates", type=int, default=400)
    parser.add_argument("--duration", type=float, default=1.0, help="of an episode [s]")
    args = parser.parse_args()
    begin = time.perf_counter()
    env = DeviceVectorEnv(args.n, args.task, precision="float32", duration=args.duration)
    train(env, 1)  # compiles and captures
    print(
        f"{env.device}, n = {args.n}: ready in {time.perf_counter() - begin:.0f} s", flush=True
    )
    _, progress = train(env, args.updates)
    rate, share = (k / progress.seconds for k in (progress.steps, progress.stepping))
    print(
        f"{progress.steps:,} steps in {progress.seconds:.0f} s: {rate:,.0f} steps/s,"
        f" {share:.0%} of the time in env.step"
    )
    every = max(1, args.updates // 20)
    for update in range(every - 1, args.updates, every):
        print(f"update {update + 1:4d}: mean return {progress.returns[update]:.4f}")


if __name__ == "__main__":
    main()
