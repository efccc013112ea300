"""What episodes return: solved above unsolved, bounded, and never more for ending early."""

import numpy as np
import pytest

from tests.envs.walks import IDS
from ves_gym.baselines.evaluate import evaluate
from ves_gym.baselines.policy import load_policy, released
from ves_gym.baselines.registry import REFERENCES, get_controller
from ves_gym.envs.arm_task import gap
from ves_gym.envs.batch import Batch
from ves_gym.envs.build import build_task
from ves_gym.envs.registration import IDS as NAMES

EPISODES = 6
BOUND = 3.0  # worst return of a degenerate policy over that of doing nothing


class Degenerate:
    """Actions that nothing has been thought about: constant, or from end to end."""

    privileged = False

    def __init__(self, name, periods):
        self.name, self.periods, self.step = name, periods, 0

    def reset(self, env, ids):
        """Nothing to prepare."""

    def act(self, env, observation):
        steps = env.batch.episodes.steps[:, None]
        sign = 1.0 if not self.periods else np.where(steps // self.periods % 2, -1.0, 1.0)
        return sign * np.where(np.arange(env.batch.width) % 2, -1.0, 1.0) * np.ones_like(steps)


def policies(id):
    """Reference, degenerate and trained ones."""
    name = id.removeprefix("ves/").rpartition("-")[0].removesuffix("Emulated")
    made = [get_controller(k) for k in ("zero", "random", REFERENCES[name])]
    made += [Degenerate("constant", 0), Degenerate("bang-bang", 1), Degenerate("swing", 20)]
    return made + [load_policy(path) for path in released(id).values()]


@pytest.mark.slow
@pytest.mark.parametrize("id", IDS)
def test_solved_episodes_return_more_and_the_worst_is_bounded(id):
    """Over all pairs of episodes of an id, whatever made them."""
    rows, worst, nothing = [], [], 0.0
    for policy in policies(id):
        result = evaluate(policy, id, episodes=EPISODES, threads=1).rows
        rows += result
        returns = [row["return"] for row in result]
        print(id, policy.name, np.mean([row["success"] for row in result]), min(returns))
        if policy.name == "zero":
            nothing = float(np.mean(returns))
        worst.append(min(returns))
    solved, unsolved = (
        [row["return"] for row in rows if row["success"] == k] for k in (True, False)
    )
    assert solved and unsolved and min(solved) > max(unsolved)
    assert min(worst) >= BOUND * nothing
    if "Goal" not in id:
        assert min(unsolved) >= -1 - 1e-6 and min(solved) > 0 and max(solved) <= 1


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
