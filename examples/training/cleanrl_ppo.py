# /// script
# dependencies = ["torch"]
# ///
"""PumaDamp by PPO in one file, in CleanRL's style: `python cleanrl_ppo.py [DECISIONS]`.

Follows CleanRL's `ppo_continuous_action.py`, whose own package asks for a Gymnasium of before
1.0. Episodes begin anew in the step that ends them, and none is truncated.
"""

import torch
from puma_damp import BATCH, DECISIONS, ENVS, EPOCHS, RATE, ROLLOUT, run, solved, vector
from torch import nn
from torch.distributions import Normal

GAMMA, LAMBDA, CLIP = 0.99, 0.95, 0.2


def layer(inputs: int, outputs: int, gain: float = 2**0.5) -> nn.Linear:
    """Return a linear layer with orthogonal weights."""
    linear = nn.Linear(inputs, outputs)
    nn.init.orthogonal_(linear.weight, gain)
    nn.init.zeros_(linear.bias)
    return linear


class Agent(nn.Module):
    """Actor and critic, and a standard deviation that does not depend on the state."""

    def __init__(self, size: int, width: int) -> None:
        super().__init__()

        def network(outputs: int, gain: float) -> nn.Sequential:
            hidden = layer(size, 64), nn.Tanh(), layer(64, 64), nn.Tanh()
            return nn.Sequential(*hidden, layer(64, outputs, gain))

        self.actor, self.critic = network(width, 0.01), network(1, 1.0)
        self.log_std = nn.Parameter(torch.full((width,), -1.0))

    def forward(
        self, x: torch.Tensor, action: torch.Tensor | None = None
    ) -> tuple[torch.Tensor, ...]:
        """Return action, its log probability and the value of observations x."""
        normal = Normal(self.actor(x), self.log_std.exp())
        action = normal.sample() if action is None else action
        return action, normal.log_prob(action).sum(1), self.critic(x).flatten()


def main(decisions: int = DECISIONS) -> float:
    """Train; the share of test episodes that the policy solves."""
    torch.manual_seed(0)
    torch.set_num_threads(1)  # layers this small are slower on more
    envs = vector()
    first = envs.reset(seed=1)[0]
    size, width = first.shape[1], envs.single_action_space.shape[0]
    agent = Agent(size, width)
    optimiser = torch.optim.Adam(agent.parameters(), lr=RATE, eps=1e-5)
    obs = torch.zeros(ROLLOUT + 1, ENVS, size)
    actions = torch.zeros(ROLLOUT, ENVS, width)
    logprobs, rewards, dones = torch.zeros(3, ROLLOUT, ENVS)
    values = torch.zeros(ROLLOUT + 1, ENVS)
    obs[-1] = torch.as_tensor(first)
    updates = max(1, decisions // (ROLLOUT * ENVS))
    for update in range(updates):
        optimiser.param_groups[0]["lr"] = RATE * (1 - update / updates)
        obs[0] = obs[-1]
        for t in range(ROLLOUT):
            with torch.no_grad():
                actions[t], logprobs[t], values[t] = agent(obs[t])
            after, reward, done, *_ = envs.step(actions[t].clamp(-1, 1).numpy())
            obs[t + 1], rewards[t] = torch.as_tensor(after), torch.as_tensor(reward)
            dones[t] = torch.as_tensor(done)
        with torch.no_grad():
            values[-1] = agent(obs[-1])[2]
        advantages, last = torch.zeros_like(rewards), torch.zeros(ENVS)
        for t in reversed(range(ROLLOUT)):
            alive = 1 - dones[t]
            delta = rewards[t] + GAMMA * values[t + 1] * alive - values[t]
            advantages[t] = last = delta + GAMMA * LAMBDA * alive * last
        flat_obs, flat_actions = obs[:-1].reshape(-1, size), actions.reshape(-1, width)
        before, gains = logprobs.flatten(), advantages.flatten()
        targets = gains + values[:-1].flatten()
        for _ in range(EPOCHS):
            for rows in torch.randperm(len(gains)).split(BATCH):
                _, logprob, value = agent(flat_obs[rows], flat_actions[rows])
                ratio = (logprob - before[rows]).exp()
                gain = (gains[rows] - gains[rows].mean()) / (gains[rows].std() + 1e-8)
                clipped = ratio.clamp(1 - CLIP, 1 + CLIP)
                policy = torch.max(-gain * ratio, -gain * clipped).mean()
                loss = policy + 0.5 * ((value - targets[rows]) ** 2).mean()
                optimiser.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
                optimiser.step()
    with torch.no_grad():
        return solved(lambda x: agent.actor(torch.as_tensor(x)).numpy())


if __name__ == "__main__":
    run(main)
