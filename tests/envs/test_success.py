"""Ids of version 1: doing nothing solves nothing, and the reference controller solves.

The reference is no competitor: it knows the nominal machine and reads the true state.
"""

import numpy as np
import pytest

from ves_gym.baselines.evaluate import evaluate
from ves_gym.baselines.registry import get_controller

REFERENCES = {
    "PumaRestToRest": "direct",
    "PumaReach": "resolved",
    "PumaReachGoal": "resolved",
    "PumaTrack": "resolved",
    "PumaDamp": "lqi",
    "BeamLQR": "lqr",
}
IN_NOISE = "ves/BeamLQREmulated-v1"  # starts of millimetres against the laboratory's errors
IDS = [
    (f"ves/{name}{suffix}", controller)
    for name, controller in REFERENCES.items()
    for suffix in ("-v1", "Emulated-v1")
    if f"ves/{name}{suffix}" != IN_NOISE
]
IDS += [("ves/FreeFlyerReach-v0", "resolved"), ("ves/FreeFlyerReachEmulated-v1", "resolved")]


def success(controller, id, episodes):
    """Share of episodes solved."""
    result = evaluate(get_controller(controller), id, episodes=episodes, threads=1)
    return float(np.mean([row["success"] for row in result.rows]))


@pytest.mark.parametrize("episodes", [20, pytest.param(100, marks=pytest.mark.slow)])
@pytest.mark.parametrize(("id", "reference"), IDS)
def test_only_doing_something_right_solves(id, reference, episodes):
    """Zero and random below 5 %, the reference at 95 % or more."""
    shares = {name: success(name, id, episodes) for name in ("zero", "random", reference)}
    print(id, shares)
    assert shares["zero"] < 0.05
    assert shares["random"] < 0.05
    assert shares[reference] >= 0.95


@pytest.mark.slow
def test_starts_of_millimetres_are_half_hidden_by_the_laboratory():
    """No share of the optimum tells the optimal feedback from doing nothing: 92 % and 5 %."""
    assert success("lqr", IN_NOISE, 100) >= 0.9
    assert success("zero", IN_NOISE, 100) <= 0.05
    assert success("random", IN_NOISE, 100) < 0.05
