"""Offline learning: a closed form, and a data set in which the better action is the rarer."""

import dataclasses

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from ves_gym._util.params import ParameterError  # noqa: E402
from ves_gym.baselines.dataset import Episode, Recipe, make_dataset  # noqa: E402
from ves_gym.baselines.offline import OfflineConfig, train_offline  # noqa: E402

QUICK = OfflineConfig(steps=250, layers=(16,), batch_size=128, learning_rate=5e-3, polyak=0.05)


def bandit(rewards, shares, n=600):
    """Episodes of one step from one state: action -0.5 or 0.5, each with a share and reward."""
    draw = np.random.default_rng(0)
    chosen = draw.choice(2, n, p=shares)
    return [
        Episode(
            k,
            "drawn",
            np.ones((2, 1), np.float32),
            np.array([[(-0.5, 0.5)[c]]], np.float32),
            np.array([rewards[c]]),
            np.array([True]),
            np.array([False]),
            False,
        )
        for k, c in enumerate(chosen)
    ]


def action(episodes, config, seed=0):
    return float(train_offline(episodes, config, seed)(np.ones((1, 1)))[0, 0])


def test_cloning_gives_the_mean_action_and_iql_the_better_one():
    """The mean, -0.5 * 0.8 + 0.5 * 0.2, minimises the square; an expectile asks for reward."""
    episodes = bandit(rewards=(0.0, 1.0), shares=(0.8, 0.2))
    mean = float(np.mean([e.actions for e in episodes]))
    cloned = action(episodes, dataclasses.replace(QUICK, method="bc"))
    assert cloned == pytest.approx(mean, abs=0.02)
    better = action(episodes, dataclasses.replace(QUICK, expectile=0.9, beta=10.0))
    assert better == pytest.approx(0.5, abs=0.06)


def test_weights_follow_the_closed_form():
    """Of a bandit the value is the expectile v of the rewards, the action a weighted mean."""
    episodes = bandit(rewards=(0.0, 1.0), shares=(0.8, 0.2))
    p = float(np.mean([e.rewards[0] for e in episodes]))
    tau, beta = 0.7, 1.0
    v = tau * p / (tau * p + (1 - tau) * (1 - p))  # where the weighted distances cancel
    good, bad = p * np.exp(beta * (1 - v)), (1 - p) * np.exp(-beta * v)
    expected = 0.5 * (good - bad) / (good + bad)
    config = dataclasses.replace(QUICK, steps=600, expectile=tau, beta=beta)
    assert action(episodes, config) == pytest.approx(expected, abs=0.03)


def test_a_seed_gives_a_policy_and_episodes_of_an_environment_are_learned_from():
    recipe = Recipe(
        id="ves/x/y-v0",
        env="ves/PumaReachGoal-v1",
        behaviours=("resolved",),
        episodes=2,
        seed=0,
    )
    episodes = make_dataset(recipe).episodes
    config = dataclasses.replace(QUICK, steps=100)
    seen = []
    first = train_offline(episodes, config, 1, progress=lambda k, loss: seen.append(loss))
    again = train_offline(episodes, config, 1)
    for (W, b), (W2, b2) in zip(first.weights, again.weights, strict=True):
        assert np.array_equal(W, W2) and np.array_equal(b, b2)
    assert seen[-1]["actor"] < seen[0]["actor"]
    rows = {k: v[:-1] for k, v in episodes[0].observations.items()}
    assert np.abs(first(rows)).max() <= 1
    assert first.network.inputs == ("achieved_goal", "desired_goal", "observation")


def test_bad_settings_are_refused():
    with pytest.raises(ParameterError, match="method"):
        OfflineConfig(method="td4")
    with pytest.raises(ParameterError, match="expectile"):
        OfflineConfig(expectile=1.0)
    with pytest.raises(ParameterError, match="episodes"):
        train_offline([], QUICK)
