"""Data sets: recipes give the recorded content, and fresh environments replay it."""

import dataclasses
import json

import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.baselines.dataset import (
    Recipe,
    choose_recipes,
    differences,
    identity_of,
    make_dataset,
    random_sums,
    recipes,
    recorded,
)

SHORT = Recipe(
    id="ves/test/mixed-v0",
    env="ves/PumaReachGoal-v0",
    behaviours=("random", "resolved", "closing-dagger"),
    episodes=5,
    seed=7,
    noise=0.1,
)
MADE_AGAIN = ("ves/BeamLQR-v0/reference-v0", "ves/PumaReach-v0/random-v0")


@pytest.fixture(scope="module")
def short():
    return make_dataset(SHORT)


@pytest.mark.parametrize("id", MADE_AGAIN)
def test_a_recipe_gives_what_is_recorded(id):
    """Within `TOLERANCE`: of a processor with other instructions the last bits differ."""
    assert differences(make_dataset(recipes()[id]).fingerprint, recorded(recipes()[id])) == []


def test_every_recipe_is_recorded_as_it_is_now():
    """Tasks, settings and weights of policies are those that the fingerprints were made of.

    Where one has changed: `ves-gym dataset make --all --record`.
    """
    stale = [
        id
        for id, recipe in recipes().items()
        if (recorded(recipe) or {}).get("identity") != identity_of(recipe)
    ]
    assert stale == []


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


def test_a_fingerprint_tells_content_from_rounding(short):
    """Single precision's last bit is no difference; one wrong reward or action is."""
    expected = json.loads(json.dumps(short.fingerprint))
    assert differences(short.fingerprint, expected) == []

    def changed(**parts):
        first = dataclasses.replace(short.episodes[0], **parts)
        other = dataclasses.replace(short, episodes=(first, *short.episodes[1:]))
        return differences(other.fingerprint, expected)

    first = short.episodes[0]
    assert changed(actions=np.nextafter(first.actions, np.float32(2))) == []
    assert changed(rewards=first.rewards * (1 + 1e-12)) == []
    actions = first.actions.copy()
    actions[3, 1] += 0.05
    assert "actions differ" in " ".join(changed(actions=actions))
    rewards = first.rewards.copy()
    rewards[3] += 0.1
    assert "rewards differ" in " ".join(changed(rewards=rewards))
    assert "steps is" in " ".join(changed(rewards=first.rewards[:-1]))


def test_random_sums_are_those_of_any_version_of_numpy():
    """Bits of Philox (Salmon et al., 2011) by key and counter; fixed here once."""
    sums = random_sums(np.arange(5.0))
    assert sums[0] == pytest.approx(np.sqrt(6.0))
    assert [round(s * np.sqrt(5)) for s in sums[1:5]] == [4, 0, 10, 6]


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
        identity_of(dataclasses.replace(SHORT, **both))
