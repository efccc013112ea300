"""What episodes return: solved above unsolved, bounded, and never more for ending early."""

import numpy as np
import pytest

from benchmarks.ranking import Ranking, rank
from tests.envs.walks import IDS
from ves_gym.envs.arm_task import gap
from ves_gym.envs.batch import Batch
from ves_gym.envs.build import build_task
from ves_gym.envs.registration import IDS as NAMES

EPISODES = 4  # of twelve kinds of policies
BOUND = 3.0  # worst return of what nobody has thought about over that of doing nothing


@pytest.mark.slow
@pytest.mark.parametrize("id", IDS)
def test_solved_episodes_return_more_and_the_worst_is_bounded(id):
    """Over all pairs of episodes of an id, whatever made them."""
    found = rank(id, EPISODES)
    assert len(found.solved) and len(found.unsolved) and found.inversions == 0
    assert found.excess <= BOUND
    if "Goal" not in id:
        assert min(found.unsolved) >= -1 - 1e-6
        assert min(found.solved) > 0 and max(found.solved) <= 1


def test_an_unsolved_episode_that_returns_as_much_is_counted():
    found = Ranking(np.array([0.5, 0.7, 0.9]), np.array([0.7, 0.1, 0.6]), 1.0)
    assert found.inversions == 3


@pytest.mark.parametrize("name", NAMES)
def test_a_failure_costs_at_least_what_remains(name):
    """In the first period and in the middle: everything that an episode can lose."""
    task = build_task(
        NAMES[name].task, **{k: v for k, v in NAMES[name].settings.items() if k != "goal"}
    )
    batch = Batch(task, 2, compiled=False)
    everyone = np.arange(2)
    batch.seed(everyone, 0, everyone)
    batch.reset(everyone)
    for _ in range(3):
        reward, *_, info = batch.step(np.zeros((2, batch.width)))
    before = batch.episodes.total.copy()
    object.__setattr__(task, "failed", lambda s: np.array([True, False]))
    reward, terminated, *_, info = batch.step(np.zeros((2, batch.width)))
    least = -task.steps if task.goal_fields else -1
    assert terminated.tolist() == [True, False] and not info["success"].any()
    np.testing.assert_allclose((before + reward)[0], least, rtol=1e-6)
    assert (before + reward)[1] > least


def test_ways_and_success_are_paid_as_they_are_made():
    """What the episode would return if it ended now, but for what was missing at first."""
    task = build_task("reach", duration=0.1)
    batch = Batch(task, 2, compiled=False)
    everyone = np.arange(2)
    batch.seed(everyone, 0, everyone)
    batch.reset(everyone)
    first = 0.0
    for k, now in enumerate([False, True] * 4, start=1):
        object.__setattr__(task, "success", lambda s, now=now: np.array([now, False]))
        *_, info = batch.step(np.full((2, batch.width), 0.5))
        missing = gap(batch.scene.memory[:, 0], task.tolerance, task.far)
        first = missing if k == 1 else first
        J = batch.episodes.cost + missing
        due = -J / (1 + J) + (1 - k / task.steps) * first / (1 + first) + [float(now), 0.0]
        np.testing.assert_allclose(batch.episodes.total, due, rtol=1e-9)
        assert info["reward/success"].tolist() == [float(now) - (k in (3, 5, 7)), 0.0]
