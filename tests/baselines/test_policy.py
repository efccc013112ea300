"""The safe policy format."""

import itertools
import json
import pickle

import gymnasium as gym
import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.baselines.policy import (
    Network,
    Policy,
    load_policy,
    save_policy,
)


def some_policy(sizes=(5, 8, 8, 3), **settings):
    rng = np.random.default_rng(0)
    weights = tuple(
        (rng.normal(size=(a, b)).astype(np.float32).astype(float), np.zeros(b))
        for a, b in itertools.pairwise(sizes)
    )
    return Policy(Network(sizes=sizes, **settings), weights, {"env": "x", "steps": 3})


def test_round_trip_is_exact(tmp_path):
    policy = some_policy(activation="relu", output="tanh", inputs=("a", "b"), hold=3)
    path = save_policy(policy, tmp_path / "mine.json")
    again = load_policy(path)
    assert again.network == policy.network and again.about == policy.about
    assert again.name == "mine"
    observation = {"a": np.full((4, 2), 0.3), "b": np.full((4, 3), -9.0)}
    np.testing.assert_array_equal(again(observation), policy(observation))


def test_an_environment_is_asked_for_what_actions_mean_and_nothing_else():
    settings = {"control": "pd_target", "goal": True, "task": "os:system", "dump": "/tmp"}
    plain = some_policy()
    policy = Policy(plain.network, plain.weights, {"settings": settings})
    spec = gym.spec("ves/PumaReachGoal-v0")
    assert policy.settings(spec) == {"control": "pd_target", "goal": True}


def test_a_row_does_not_depend_on_its_neighbours():
    policy = some_policy((26, 64, 64, 3))
    x = np.random.default_rng(1).normal(size=(200, 26)).astype(np.float32)
    whole = policy(x)
    for n in (1, 7, 64):
        np.testing.assert_array_equal(policy(x[:n]), whole[:n])
    assert np.abs(whole).max() <= 1


def test_an_action_is_held_from_each_episodes_start():
    policy = some_policy((26, 3), hold=4)
    env = gym.make_vec("ves/PumaRestToRest-v0", num_envs=2, threads=1, duration=0.5)
    observation, _ = env.reset(seed=0)
    fresh = np.zeros((2, 3))
    for step in range(90):
        now = env.batch.episodes.steps % 4 == 0
        fresh = np.where(now[:, None], policy(observation), fresh)
        np.testing.assert_array_equal(policy.act(env, observation), fresh)
        if step == 10:  # out of step with each other
            observation, _ = env.reset(options={"reset_mask": np.array([True, False])})
        else:
            observation = env.step(fresh)[0]


def test_a_slip_in_a_released_name_gets_the_name():
    with pytest.raises(
        ParameterError, match="got 'PumaDamp/pp'; did you mean \"PumaDamp/ppo\""
    ):
        load_policy("PumaDamp/pp")


def test_pickles_are_refused_unread(tmp_path):
    class Bomb:
        def __reduce__(self):
            return (tmp_path.joinpath("went-off").touch, ())

    for name in ("policy.pkl", "policy.pt", "policy.json"):
        (tmp_path / name).write_bytes(pickle.dumps(Bomb(), protocol=4))
        with pytest.raises(ParameterError):
            load_policy(tmp_path / name)
    save_policy(some_policy(), tmp_path / "good.json")
    (tmp_path / "good.safetensors").write_bytes(pickle.dumps(Bomb()))
    with pytest.raises(ParameterError, match=r"not the weights that good\.json names"):
        load_policy(tmp_path / "good.json")
    assert not (tmp_path / "went-off").exists()


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("schema", "ves-policy/9", "expected a policy ves-policy/1"),
        ("extra", 1, "expected a policy"),
        ("network", {"sizes": [5, 8, 8, 3], "activation": "eval"}, "activation must be one of"),
        ("network", {"sizes": [5, 9, 8, 3]}, "weights must have shapes"),
        ("network", {"sizes": [5, 3]}, r"expected layer0\.weight"),
        ("network", {"sizes": [5, 10**9, 3]}, "two or more of 1 to 4096"),
        ("network", {"sizes": [5, 8, 8, 3], "code": "x"}, "unknown key 'code'"),
    ],
)
def test_what_does_not_fit_is_refused(tmp_path, key, value, message):
    path = save_policy(some_policy(), tmp_path / "p.json")
    plain = json.loads(path.read_text())
    plain[key] = value
    path.write_text(json.dumps(plain))
    with pytest.raises(ParameterError, match=message):
        load_policy(path)


def test_wrong_observations_are_refused():
    policy = some_policy()
    with pytest.raises(ParameterError, match=r"observations \(n, 5\), got \(2, 4\)"):
        policy(np.zeros((2, 4)))
    with pytest.raises(ParameterError, match="dictionary of a, b"):
        some_policy(inputs=("a", "b"))(np.zeros((2, 5)))
    env = gym.make_vec("ves/PumaRestToRest-v0", num_envs=2, threads=1)
    env.reset(seed=0)
    with pytest.raises(ParameterError, match="takes 5 observations"):
        policy.reset(env, np.arange(2))
    with pytest.raises(ParameterError, match="finite"):
        Policy(Network(sizes=(1, 1)), ((np.array([[np.nan]]), np.zeros(1)),))
