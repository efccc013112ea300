"""Every id: doing nothing solves nothing, and the reference controller solves.

The reference is no competitor: it knows the nominal machine and reads the true state.
"""

import numpy as np
import pytest

from tests.envs.walks import ALL
from ves_gym.baselines.evaluate import evaluate
from ves_gym.baselines.registry import REFERENCES, get_controller
from ves_gym.envs.registration import IDS as NAMES

LONG = (
    "PoseReach",
    "PayloadTransfer",
    "ServicerCapture",
)  # their own tests are of fewer episodes
# Shares of 100 episodes solved by zero, random and reference. Version 0 is why there is a
# version 1.
MISSES = {
    "ves/PumaRestToRest-v0": (1.0, 1.0, 0.99),
    "ves/PumaRestToRestEmulated-v0": (1.0, 1.0, 0.84),
    "ves/PumaDamp-v0": (0.50, 0.39, 0.88),
    "ves/PumaDampEmulated-v0": (0.50, 0.39, 0.88),
    "ves/BeamLQR-v0": (0.0, 0.0, 0.43),
    "ves/BeamLQREmulated-v0": (0.0, 0.0, 0.15),
    "ves/PayloadTransferEmulated-v0": (0.0, 0.0, 0.93),
}


def name_of(id):
    """Of an id's task."""
    return id.removeprefix("ves/").rpartition("-")[0].removesuffix("Emulated")


def cases():
    """(id, reference, episodes): 100 among the slow tests, 20 of the latest versions."""
    for id in ALL:
        name = name_of(id)
        if id in MISSES:
            continue
        later = id.removesuffix("-v0") + "-v1"
        if name not in LONG and (id == later or later not in ALL):
            yield pytest.param(id, REFERENCES[name], 20)
        yield pytest.param(id, REFERENCES[name], 100, marks=pytest.mark.slow)


def test_every_id_is_tested():
    assert set(REFERENCES) == set(NAMES)
    assert {case.values[0] for case in cases()} | set(MISSES) == set(ALL)


def played(controller, id, episodes):
    """Share of episodes solved, and the median return."""
    result = evaluate(get_controller(controller), id, episodes=episodes, threads=1)
    solved = float(np.mean([row["success"] for row in result.rows]))
    return solved, float(np.median([row["return"] for row in result.rows]))


@pytest.mark.parametrize(("id", "reference", "episodes"), list(cases()))
def test_only_doing_something_right_solves(id, reference, episodes):
    """Zero and random below 5 %, the reference at 95 % or more, which the reward pays for."""
    names = ("zero", "random", reference)
    shares, returns = zip(*(played(name, id, episodes) for name in names), strict=True)
    print(id, shares, returns)
    assert shares[0] < 0.05
    assert shares[1] < 0.05
    assert shares[2] >= 0.95
    assert returns[2] > max(returns[:2])


@pytest.mark.slow
@pytest.mark.parametrize("id", MISSES)
def test_what_misses_that_is_as_stated(id):
    """Zero, random and reference, to what 100 episodes on another processor may differ by."""
    shares = [played(name, id, 100)[0] for name in ("zero", "random", REFERENCES[name_of(id)])]
    print(id, shares)
    np.testing.assert_allclose(shares, MISSES[id], atol=0.03)
