"""Data sets in Minari's format: written, read, and replayed in the environment they name.

Minari (Younis et al., 2024, DOI 10.5281/zenodo.13767625) keeps a folder with `metadata.json`,
which holds the environment's specification, and `main_data.hdf5`, which holds the episodes.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from ves_gym._util.optional import require
from ves_gym._util.params import Array, ParameterError
from ves_gym._util.version import __version__
from ves_gym.baselines.dataset import (
    Dataset,
    Episode,
    Float32,
    flat_observations,
)

PACKAGES = ("minari", "h5py")
# What replaying may differ by on another processor: rewards are computed in double precision,
# observations are rounded to single (two neighbours of numbers up to 5 are 5e-7 apart).
REWARDS, OBSERVATIONS = 1e-9, 1e-6


@dataclass(frozen=True)
class Replay:
    """How far stored episodes are from those of a fresh environment."""

    episodes: int
    steps: int
    rewards: float  # largest difference
    observations: float  # the same
    ends: bool  # all episodes end where they ended

    @property
    def exact(self) -> bool:
        """True if every number has the same bits."""
        return self.ends and self.rewards == self.observations == 0.0

    @property
    def sound(self) -> bool:
        """True if the differences are those of another processor's rounding."""
        return self.ends and self.rewards <= REWARDS and self.observations <= OBSERVATIONS


def write_dataset(dataset: Dataset, root: str | os.PathLike[str]) -> Path:
    """Write a data set below a folder of data sets, completely or not at all.

    Args:
        dataset: whose id names the folder in `root`; one that is there is replaced.
        root: such as Minari's `MINARI_DATASETS_PATH`.

    Returns:
        The folder, which `open_dataset` and `minari.load_dataset` read.
    """
    require("a data set", *PACKAGES)
    from minari.data_collector import EpisodeBuffer
    from minari.dataset.minari_storage import MinariStorage

    recipe = dataset.recipe
    noise = f" with noise of {recipe.noise:g} added to every action" if recipe.noise else ""
    target = Path(root) / recipe.id
    target.parent.mkdir(parents=True, exist_ok=True)
    env = gym.make(recipe.env, **dataset.settings)
    with tempfile.TemporaryDirectory(
        dir=target.parent, prefix=".", ignore_cleanup_errors=True
    ) as scratch:
        storage = MinariStorage.new(
            Path(scratch) / "data",
            observation_space=env.observation_space,
            action_space=env.action_space,
            env_spec=env.spec,
        )
        storage.update_metadata(
            {
                "dataset_id": recipe.id,
                "minari_version": version("minari"),
                "algorithm_name": " and ".join(recipe.behaviours),
                "author": {"the ves_gym authors"},
                "description": (
                    f"{recipe.episodes} episodes of {recipe.env} by"
                    f" {', '.join(recipe.behaviours)} in turn{noise}; episode k begins with"
                    f" env.reset(seed={recipe.seed} + k)"
                ),
                "requirements": [f"ves-gym=={__version__}"],
                "code_permalink": f"ves-gym dataset make {recipe.id}",
            }
        )
        storage.update_episodes(
            EpisodeBuffer(
                id=k,
                seed=e.seed,
                observations=e.observations,
                actions=e.actions,
                rewards=e.rewards,
                terminations=e.terminations,
                truncations=e.truncations,
            )
            for k, e in enumerate(dataset.episodes)
        )
        storage.update_episode_metadata(
            {"behaviour": e.behaviour, "success": e.success} for e in dataset.episodes
        )
        env.close()
        shutil.rmtree(target, ignore_errors=True)
        Path(scratch).replace(target)
    return target


def open_dataset(path: str | os.PathLike[str]) -> Any:
    """Return Minari's `MinariDataset` of a folder.

    Raises:
        ParameterError: no data set there.
    """
    require("a data set", *PACKAGES)
    import minari

    folder = Path(path) / "data"  # as in Minari's own folders
    folder = folder if folder.is_dir() else Path(path)
    if not (folder / "metadata.json").is_file():
        raise ParameterError(
            f"{folder}: expected the folder of a data set, got no metadata.json"
        )
    try:
        return minari.MinariDataset(folder)
    except (OSError, ValueError, KeyError, AssertionError) as error:
        raise ParameterError(f"{folder}: is no data set of Minari: {error}") from error


def read_episodes(path: str | os.PathLike[str]) -> list[Episode]:
    """Read the episodes of a data set's folder.

    Args:
        path: of a data set, also of one that Minari wrote elsewhere, with its seeds.

    Raises:
        ParameterError: no data set, or episodes without seeds.
    """
    stored = open_dataset(path)
    abouts = stored.storage.get_episode_metadata(stored.episode_indices)
    out = []
    for episode, about in zip(stored.iterate_episodes(), abouts, strict=True):
        if about.get("seed") is None:
            raise ParameterError(f"{path}: expected the seed of every episode, got none")
        out.append(
            Episode(
                int(about["seed"]),
                str(about.get("behaviour", "")),
                episode.observations,
                episode.actions,
                episode.rewards,
                episode.terminations,
                episode.truncations,
                bool(about.get("success", False)),
            )
        )
    return out


def replay(path: str | os.PathLike[str]) -> Replay:
    """Carry out the stored actions in the environment that the data set names.

    Args:
        path: folder of the data set. The environment is made from the specification in it,
            every episode is begun from its stored seed.
    """
    env = open_dataset(path).recover_environment()
    steps, rewards, observations, ends = 0, 0.0, 0.0, True
    episodes = read_episodes(path)
    for episode in episodes:
        rows, paid, over = _again(env, episode.seed, episode.actions)
        before = flat_observations(episode.observations)
        ended = episode.terminations | episode.truncations
        if not np.array_equal(over, ended) or len(rows) != len(before):
            ends = False
            continue
        steps += len(paid)
        rewards = max(rewards, float(np.abs(paid - episode.rewards).max()))
        observations = max(observations, float(np.abs(rows - before).max()))
    env.close()
    return Replay(len(episodes), steps, rewards, observations, ends)


def _again(env: Any, seed: int, actions: Float32) -> tuple[Float32, Array, Array]:
    """Observations, rewards and ends of an episode with given actions, until it is over."""
    observation, _ = env.reset(seed=seed)
    rows, rewards, over = [flat_observations(observation)], [], []
    for action in actions:
        observation, reward, terminated, truncated, _ = env.step(action)
        rows.append(flat_observations(observation))
        rewards.append(reward)
        over.append(terminated or truncated)
        if over[-1]:
            break
    return np.stack(rows), np.array(rewards), np.array(over)
