"""Every id: doing nothing solves nothing, and the reference controller solves.

The reference is no competitor: it knows the nominal machine and reads the true state.
"""

import numpy as np
import pytest

from tests.envs.walks import IDS, KINDS
from ves_gym.baselines.evaluate import evaluate
from ves_gym.baselines.registry import REFERENCES, get_controller
from ves_gym.envs.registration import IDS as NAMES

LONG = (
    "PoseReach",
    "PayloadTransfer",
    "ServicerCapture",
    "BerthingContact",
)  # their own tests are of fewer episodes


def name_of(id):
    """Of an id's task."""
    return id.removeprefix("ves/").rpartition("-")[0].removesuffix("Emulated")


def cases():
    """(id, reference, episodes): 100 among the slow tests, 20 of each kind that is quick."""
    for id in IDS:
        name = name_of(id)
        if id in KINDS and name not in LONG:
            yield pytest.param(id, REFERENCES[name], 20)
        yield pytest.param(id, REFERENCES[name], 100, marks=pytest.mark.slow)


def test_every_task_has_a_reference():
    assert set(REFERENCES) == set(NAMES)


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
