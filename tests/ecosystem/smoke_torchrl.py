# /// script
# dependencies = ["torchrl", "torch"]
# ///
"""TorchRL: single and vector environment, info, collector and a PPO update."""

import gymnasium as gym
import torch
from tensordict.nn import TensorDictModule
from tensordict.nn.distributions import NormalParamExtractor
from torch import nn
from torchrl.collectors import Collector
from torchrl.envs import (
    GymEnv,
    GymWrapper,
    RewardSum,
    StepCounter,
    TransformedEnv,
    default_info_dict_reader,
)
from torchrl.envs.utils import check_env_specs
from torchrl.modules import ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

import ves_gym  # noqa: F401  files the ids


def train(name: str, frames: int, **kwargs: object) -> int:
    """Return the number of frames that one update of PPO was made with."""
    env = TransformedEnv(GymEnv(name, **kwargs))
    env.append_transform(StepCounter())
    env.append_transform(RewardSum())
    size, width = env.observation_spec["observation"].shape[-1], env.action_spec.shape[-1]
    net = nn.Sequential(nn.Linear(size, 2 * width), NormalParamExtractor())
    actor = ProbabilisticActor(
        TensorDictModule(net, in_keys=["observation"], out_keys=["loc", "scale"]),
        in_keys=["loc", "scale"],
        distribution_class=TanhNormal,
        return_log_prob=True,
    )
    critic = ValueOperator(nn.Linear(size, 1), in_keys=["observation"])
    loss, advantage = (
        ClipPPOLoss(actor, critic),
        GAE(gamma=0.99, lmbda=0.95, value_network=critic),
    )
    optimiser = torch.optim.Adam(loss.parameters(), 1e-3)
    collector = Collector(env, actor, frames_per_batch=frames // 2, total_frames=frames)
    total = 0
    for data in collector:
        assert data["next", "done"].any()
        advantage(data)
        terms = loss(data.reshape(-1))
        value = sum(v for k, v in terms.items() if k.startswith("loss_"))
        optimiser.zero_grad()
        value.backward()
        optimiser.step()
        assert torch.isfinite(value)
        total += data.numel()
    collector.shutdown()
    return total


def main() -> str:
    """Check, collect and train; return what was run."""
    torch.manual_seed(0)
    ids = sorted(k for k in gym.registry if k.startswith("ves/"))
    for name in ids:
        env = GymEnv(name)
        check_env_specs(env)
        env.close()
    env = GymEnv("ves/PumaReach-v0", duration=0.25)
    keys = ["reward/energy", "energy/E_mean"]
    env.set_info_dict_reader(default_info_dict_reader(keys))
    rows = env.rollout(30)["next"]
    assert len(rows) == 20 and (rows[keys[0]] != 0).all() and rows[keys[1]][-1] > 0
    for name in ids:
        rows = GymEnv(name, num_envs=2, duration=0.25).rollout(45, break_when_any_done=False)
        assert rows["next", "done"].sum() >= 4 and torch.isfinite(rows["next", "reward"]).all()
    native = gym.make_vec(
        "ves/PumaReach-v0", num_envs=3, duration=0.25, autoreset_mode="Disabled"
    )
    rows = GymWrapper(native).auto_register_info_dict().rollout(45, break_when_any_done=False)
    assert rows["next", "done"].sum() == 6 and (rows["next", "reward/energy"] != 0).any()
    single = train("ves/PumaDamp-v0", 400, duration=0.25)
    vector = train("ves/PumaReach-v0", 400, num_envs=4, duration=0.25)
    return (
        f"GymEnv, check_env_specs and num_envs=2 on {len(ids)} ids; infos of a single"
        " environment and of the native vector (autoreset disabled); PPO on"
        f" {single} frames of PumaDamp, and on {vector} of PumaReach with num_envs=4"
    )


if __name__ == "__main__":
    print("ran:", main())
