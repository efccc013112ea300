"""Claim: released policies of version 1 solve their tasks, at no more energy than `resolved`.

Test episodes (seeds 0, 1, ...): on none of them a policy was trained or chosen. Success is that
of the task: 1 cm for half a second at the deadline (PumaReach, PumaReachGoal), 5 mm root mean
square over the whole path (PumaTrack). Figures are those of docs/training.md.
"""

import numpy as np
import pytest

from ves_gym.baselines.config import CONFIGS, read_config
from ves_gym.baselines.evaluate import evaluate, ratio
from ves_gym.baselines.policy import load_policy, released
from ves_gym.baselines.registry import get_controller

pytest.importorskip("safetensors")

SOLVED = sorted(
    config.env
    for path in CONFIGS.glob("*.toml")
    if (config := read_config(path)).label == "closing-dagger"
)


def played(id, episodes, seed):
    """Rate of success, median E_mean over that of `resolved`, successes of `resolved`."""
    some = {"episodes": episodes, "seed": seed, "threads": 1}
    policy = load_policy(released(id)["closing-dagger"])
    learned, resolved = (evaluate(c, id, **some) for c in (policy, get_controller("resolved")))
    rates = [np.mean([row["success"] for row in e.rows]) for e in (learned, resolved)]
    return rates[0], ratio(learned, resolved), rates[1]


@pytest.mark.parametrize("id", SOLVED)
def test_a_few_episodes(id):
    """Of 12 with 97 % success, three or more fail once in 200 times: never by rounding."""
    success, energy, _ = played(id, 12, 7000)
    assert success >= 10 / 12
    assert energy.value < 1.1


@pytest.mark.slow
@pytest.mark.parametrize("id", SOLVED)
def test_two_hundred_episodes(id):
    success, energy, reference = played(id, 200, 0)
    print(f"{id}: success {success:.3f} ({reference:.3f}), E_mean {energy}")
    assert success >= 0.95
    assert energy.value <= 1.0
