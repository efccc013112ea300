"""Claim: tasks can be learned, and what was learned pays.

200 test episodes (seeds 0, 1, ...), on none of which a policy was trained or chosen.
Intervals are 95 % percentile bootstraps of the interquartile mean.
"""

import gymnasium as gym
import numpy as np
import pytest

from ves_gym.baselines.config import CONFIGS, read_config
from ves_gym.baselines.evaluate import beats, evaluate, ratio
from ves_gym.baselines.policy import load_policy, released
from ves_gym.baselines.registry import get_controller

pytestmark = pytest.mark.slow
pytest.importorskip("safetensors")

EVERY = [
    config
    for path in sorted(CONFIGS.glob("*.toml"))
    if (config := read_config(path)).label in released(config.env)
]
EPISODES = 200


def run(name, id, **settings):
    """A built-in controller, or the released policy, on the test episodes."""
    known = released(id)
    controller = load_policy(known[name]) if name in known else get_controller(name)
    return evaluate(controller, id, episodes=EPISODES, **settings)


@pytest.mark.parametrize("config", EVERY, ids=lambda c: c.name)
def test_the_policy_beats_nothing_and_chance(config):
    """Also where these act through the control that the policy has chosen."""
    learned = run(config.label, config.env)
    policy = load_policy(released(config.env)[config.label])
    for settings in ({}, policy.settings(gym.spec(config.env))):
        for name in ("zero", "random"):
            assert beats(learned, run(name, config.env, **settings))


def test_damping_takes_less_than_high_gains():
    id = "ves/PumaDamp-v0"
    learned, high = run("ppo", id), run("high", id)
    share = ratio(learned, high, "E_int").value
    sums = [np.concatenate(e.values("E_int")).sum() for e in (learned, high)]
    print(f"E_int {share:.3f} of the high gains' in the median, {sums[0] / sums[1]:.3f} summed")
    assert share <= 0.8 and sums[0] <= 0.8 * sums[1]
