"""Data sets in Minari's own hands: read by Minari, replayed in the environment it recovers."""

import json
import sys

import numpy as np
import pytest

minari = pytest.importorskip("minari")
h5py = pytest.importorskip("h5py")

from ves_gym._util.params import ParameterError  # noqa: E402
from ves_gym.baselines.dataset import Recipe, make_dataset  # noqa: E402
from ves_gym.baselines.minari_files import (  # noqa: E402
    read_episodes,
    replay,
    write_dataset,
)

ENVS = {
    "PumaReachGoal-v0": ("random", "resolved"),
    "PumaDampEmulated-v0": ("random", "lqi"),
    "PumaRestToRest-v0": ("refined",),
}


def recipe(env, behaviours):
    return Recipe(
        id=f"ves/{env}/test-v0", env=f"ves/{env}", behaviours=behaviours, episodes=2, seed=3
    )


@pytest.fixture(scope="module", params=ENVS)
def made(request, tmp_path_factory):
    root = tmp_path_factory.mktemp("sets")
    data = make_dataset(recipe(request.param, ENVS[request.param]))
    return root, data, write_dataset(data, root)


def test_a_fresh_environment_replays_every_bit(made):
    _, data, folder = made
    again = replay(folder)
    assert again.exact and again.steps == sum(len(e.rewards) for e in data.episodes)


def test_minari_reads_what_was_made(made, monkeypatch):
    root, data, _ = made
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(root))
    stored = minari.load_dataset(data.recipe.id)
    assert stored.total_episodes == 2 and stored.total_steps == replay(made[2]).steps
    env = stored.recover_environment()
    assert env.spec.id == data.recipe.env
    for episode, ours in zip(stored.iterate_episodes(), data.episodes, strict=True):
        assert np.array_equal(episode.rewards, ours.rewards)
        assert np.array_equal(episode.actions, ours.actions)
        # by hand, as a user of Minari would
        env.reset(seed=ours.seed)
        assert [env.step(a)[1] for a in episode.actions] == episode.rewards.tolist()


def test_a_relative_folder_will_do(made, tmp_path, monkeypatch):
    _, data, _ = made
    monkeypatch.chdir(tmp_path)
    assert replay(write_dataset(data, "sets")).exact


def test_a_changed_episode_is_seen(made, tmp_path):
    _, data, _ = made
    folder = write_dataset(data, tmp_path)
    with h5py.File(folder / "data" / "main_data.hdf5", "a") as file:
        file["episode_0"]["rewards"][5] += 1e-3
    again = replay(folder)
    assert not again.sound and again.rewards == pytest.approx(1e-3)
    with h5py.File(folder / "data" / "main_data.hdf5", "a") as file:
        del file["episode_0"].attrs["seed"]
    with pytest.raises(ParameterError, match="seed"):
        read_episodes(folder)


def test_a_data_set_is_replaced_whole_and_other_folders_are_refused(made, tmp_path):
    _, data, _ = made
    first = write_dataset(data, tmp_path)
    assert write_dataset(data, tmp_path) == first and replay(first).exact
    assert [p.name for p in first.parent.iterdir()] == [first.name]
    with pytest.raises(ParameterError, match=r"metadata\.json"):
        replay(tmp_path)
    (tmp_path / "metadata.json").write_text(json.dumps({"data_format": "hdf5"}))
    with pytest.raises(ParameterError, match="no data set"):
        replay(tmp_path)


def test_code_that_a_data_set_names_is_not_run(made, tmp_path):
    """Claim: of a data set's specification only a registered id and plain settings are used:
    entry points, wrappers and folders in it do nothing."""
    _, data, _ = made
    folder = write_dataset(data, tmp_path)
    file, sign = folder / "data" / "metadata.json", tmp_path / "sign"
    metadata = json.loads(file.read_text())
    call = {"entry_point": "subprocess:call", "kwargs": {"args": ["touch", str(sign)]}}
    wrapper = {"name": "x", "entry_point": "subprocess:call", "kwargs": {"args": ["true"]}}
    plain = json.loads(metadata["env_spec"])
    kwargs = plain["kwargs"] | {"dump": str(tmp_path / "dump")}
    for changes, said in (
        ({"id": "mine/Own-v0", **call}, "known: ves/"),
        (call, "args"),
        ({"additional_wrappers": [wrapper], "kwargs": kwargs}, None),
        ({"kwargs": plain["kwargs"] | {"task": "this:s"}}, "task must be one of"),
        ({"id": "CartPole-v1", "kwargs": {}}, "an environment of ves_gym"),
    ):
        metadata["env_spec"] = json.dumps(plain | changes)
        file.write_text(json.dumps(metadata))
        if said is None:
            assert replay(folder).exact
        else:
            with pytest.raises((ParameterError, TypeError), match=said):
                replay(folder)
    assert not sign.exists() and not (tmp_path / "dump").exists()
    assert "this" not in sys.modules
