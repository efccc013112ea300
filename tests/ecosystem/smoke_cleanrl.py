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
    envs = vector.RecordEpisodeStatistics(envs)
    envs = vector.ClipAction(envs)
    envs = vector.NormalizeObservation(envs)
    envs = vector.TransformObservation(envs, lambda o: np.clip(o, -10, 10))
    envs = vector.NormalizeReward(envs, gamma=GAMMA)
    size, width = envs.single_observation_space.shape[0], envs.single_action_space.shape[0]
    agent = Agent(size, width)
    optimiser = torch.optim.Adam(agent.parameters(), lr=3e-4, eps=1e-5)
    obs = torch.zeros(NUM_STEPS, NUM_ENVS, size)
    actions = torch.zeros(NUM_STEPS, NUM_ENVS, width)
    logprobs, rewards, dones, values = torch.zeros(4, NUM_STEPS, NUM_ENVS)
    first, _ = envs.reset(seed=1)
    next_obs = torch.as_tensor(first, dtype=torch.float32)
    next_done = torch.zeros(NUM_ENVS)
    returns: list[float] = []
    for _ in range(UPDATES):
        for t in range(NUM_STEPS):
            obs[t], dones[t] = next_obs, next_done
            with torch.no_grad():
                actions[t], logprobs[t], values[t] = agent(next_obs)
            observation, reward, terminated, truncated, infos = envs.step(actions[t].numpy())
            rewards[t] = torch.as_tensor(reward)
            next_obs = torch.as_tensor(observation, dtype=torch.float32)
            next_done = torch.as_tensor(terminated | truncated, dtype=torch.float32)
            if "episode" in infos:
                returns += infos["episode"]["r"][infos["_episode"]].tolist()
        with torch.no_grad():
            advantages, last = torch.zeros_like(rewards), torch.zeros(NUM_ENVS)
            for t in reversed(range(NUM_STEPS)):
                final = t == NUM_STEPS - 1
                alive = 1 - (next_done if final else dones[t + 1])
                after = agent(next_obs)[2] if final else values[t + 1]
                delta = rewards[t] + GAMMA * after * alive - values[t]
                advantages[t] = last = delta + GAMMA * LAMBDA * alive * last
        target, flat = (advantages + values).flatten(), advantages.flatten()
        for rows in torch.randperm(NUM_STEPS * NUM_ENVS).chunk(4):
            _, logprob, value = agent(
                obs.reshape(-1, size)[rows], actions.reshape(-1, width)[rows]
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
    assert len(returns) >= 80 and np.isfinite(returns).all()
    return (
        f"PPO in CleanRL's style on PumaReach, native vector of {NUM_ENVS}, statistics and"
        f" normalisation by Gymnasium's wrappers: {UPDATES * NUM_STEPS * NUM_ENVS} steps,"
        f" {len(returns)} episodes"
    )


if __name__ == "__main__":
    print("ran:", main())
