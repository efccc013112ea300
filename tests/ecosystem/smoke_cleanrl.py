# /// script
# dependencies = ["torch"]
# ///
"""CleanRL's style: PPO in one file of torch around `gym.make_vec`.

CleanRL's own package asks for a Gymnasium of before 1.0; its `ppo_continuous_action.py` is
followed here line by line, with next-step autoreset.
"""

import gymnasium as gym
import numpy as np
import torch
from gymnasium.wrappers import vector
from torch import nn
from torch.distributions import Normal

import ves_gym  # noqa: F401  files the ids

NUM_ENVS, NUM_STEPS, UPDATES = 8, 64, 4
GAMMA, LAMBDA, CLIP = 0.99, 0.95, 0.2


class Agent(nn.Module):
    """Actor and critic, and a standard deviation that does not depend on the state."""

    def __init__(self, size: int, width: int) -> None:
        super().__init__()
        self.critic = nn.Sequential(nn.Linear(size, 64), nn.Tanh(), nn.Linear(64, 1))
        self.actor = nn.Sequential(nn.Linear(size, 64), nn.Tanh(), nn.Linear(64, width))
        self.log_std = nn.Parameter(torch.zeros(1, width))

    def forward(self, x, action=None):
        """Return action, its log probability and the value of observations x."""
        normal = Normal(self.actor(x), self.log_std.exp())
        action = normal.sample() if action is None else action
        return action, normal.log_prob(action).sum(1), self.critic(x).flatten()


def main() -> str:
    """Train; return what was run."""
    torch.manual_seed(0)
    envs = gym.make_vec("ves/PumaReach-v0", num_envs=NUM_ENVS, duration=0.25)
    envs = vector.ClipAction(vector.RecordEpisodeStatistics(envs))
    envs = vector.NormalizeReward(vector.NormalizeObservation(envs), gamma=GAMMA)
    size, width = envs.single_observation_space.shape[0], envs.single_action_space.shape[0]
    agent = Agent(size, width)
    optimiser = torch.optim.Adam(agent.parameters(), lr=3e-4, eps=1e-5)
    obs = torch.zeros(NUM_STEPS + 1, NUM_ENVS, size)
    actions = torch.zeros(NUM_STEPS, NUM_ENVS, width)
    logprobs, rewards = torch.zeros(2, NUM_STEPS, NUM_ENVS)
    dones, values = torch.zeros(2, NUM_STEPS + 1, NUM_ENVS)
    obs[0] = torch.as_tensor(envs.reset(seed=1)[0])
    returns: list[float] = []
    for _ in range(UPDATES):
        for t in range(NUM_STEPS):
            with torch.no_grad():
                actions[t], logprobs[t], values[t] = agent(obs[t])
            after, reward, terminated, truncated, infos = envs.step(actions[t].numpy())
            obs[t + 1], rewards[t] = torch.as_tensor(after), torch.as_tensor(reward)
            dones[t + 1] = torch.as_tensor(terminated | truncated)
            if "episode" in infos:
                returns += infos["episode"]["r"][infos["_episode"]].tolist()
        advantages, last = torch.zeros_like(rewards), torch.zeros(NUM_ENVS)
        with torch.no_grad():
            values[-1] = agent(obs[-1])[2]
        for t in reversed(range(NUM_STEPS)):
            alive = 1 - dones[t + 1]
            delta = rewards[t] + GAMMA * values[t + 1] * alive - values[t]
            advantages[t] = last = delta + GAMMA * LAMBDA * alive * last
        target, flat = (advantages + values[:-1]).flatten(), advantages.flatten()
        for rows in torch.randperm(NUM_STEPS * NUM_ENVS).chunk(4):
            _, logprob, value = agent(
                obs[:-1].reshape(-1, size)[rows], actions.reshape(-1, width)[rows]
            )
            ratio = (logprob - logprobs.flatten()[rows]).exp()
            gain = (flat[rows] - flat[rows].mean()) / (flat[rows].std() + 1e-8)
            policy = torch.max(-gain * ratio, -gain * ratio.clamp(1 - CLIP, 1 + CLIP)).mean()
            loss = policy + 0.25 * ((value - target[rows]) ** 2).mean()
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
            optimiser.step()
            assert torch.isfinite(loss)
        obs[0], dones[0] = obs[-1], dones[-1]
    assert len(returns) >= 80 and np.isfinite(returns).all()
    return (
        f"PPO in CleanRL's style on PumaReach, native vector of {NUM_ENVS}, statistics and"
        f" normalisation by Gymnasium's wrappers: {UPDATES * NUM_STEPS * NUM_ENVS} steps,"
        f" {len(returns)} episodes"
    )


if __name__ == "__main__":
    print("ran:", main())
