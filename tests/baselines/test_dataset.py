"""Data sets: recipes, and the episodes made from them."""

import dataclasses

import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.baselines.dataset import (
    Recipe,
    choose_recipes,
    make_dataset,
)

SHORT = Recipe(
    id="ves/test/mixed-v0",
    env="ves/PumaReachGoal-v0",
    behaviours=("random", "resolved", "closing-dagger"),
    episodes=5,
    seed=7,
    noise=0.1,
)


@pytest.fixture(scope="module")
def short():
    return make_dataset(SHORT)


def test_behaviours_take_turns_and_episodes_depend_on_their_seed_alone(short):
    turns = ["random", "resolved", "closing-dagger", "random", "resolved"]
    assert [e.behaviour for e in short.episodes] == turns
    assert [e.seed for e in short.episodes] == list(range(7, 12))
    fewer = make_dataset(dataclasses.replace(SHORT, episodes=2))
    for a, b in zip(fewer.episodes, short.episodes, strict=False):
        assert np.array_equal(a.actions, b.actions) and np.array_equal(a.rewards, b.rewards)
    assert short.episodes[0].observations["desired_goal"].dtype == np.float32


def test_noise_is_added_and_actions_stay_in_their_range(short):
    quiet = make_dataset(dataclasses.replace(SHORT, noise=0.0))
    with_noise, without = (d.episodes[0].actions for d in (short, quiet))  # random ones
    inside = np.abs(without) < 0.5  # five standard deviations from the limits
    assert 0.09 < (with_noise - without)[inside].std() < 0.11
    assert all(np.abs(e.actions).max() <= 1 for e in short.episodes)


def test_recipes_are_checked(tmp_path):
    for changes, message in (
        ({"behaviours": ()}, "behaviours"),
        ({"id": "no version"}, "ves/Env-v0/name-v0"),
        ({"noise": -1.0}, "noise must be >= 0"),
    ):
        with pytest.raises(ParameterError, match=message):
            dataclasses.replace(SHORT, **changes)
    with pytest.raises(ParameterError, match="did you mean"):
        choose_recipes(["PumaReach-v0/mixd-v0"])
    file = tmp_path / "r.toml"
    file.write_text('env = "ves/PumaReach-v0"\nseed = 1\nepisodes = 2\n')
    with pytest.raises(ParameterError, match="set"):
        choose_recipes([str(file)])
    file.write_text(file.read_text() + '[[set]]\nname = "a"\nbehaviours = ["zero"]\nodd = 1\n')
    with pytest.raises(ParameterError, match="odd"):
        choose_recipes([str(file)])


def test_behaviours_that_need_different_settings_cannot_share_a_set():
    both = {"env": "ves/PumaDamp-v0", "behaviours": ("tuned", "receding")}
    with pytest.raises(ParameterError, match="same control"):
        make_dataset(dataclasses.replace(SHORT, **both))
