"""Data sets in Minari's format: written, read, and replayed in the environment they name.

Minari (Younis et al., 2024, DOI 10.5281/zenodo.13767625) keeps a folder with `metadata.json`,
which holds the environment's specification, and `main_data.hdf5`, which holds the episodes.
"""

from __future__ import annotations

import json
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
from ves_gym._util.reading import named, read_apart
from ves_gym._util.version import __version__
from ves_gym.baselines.dataset import COLUMNS, Dataset, Episode, Float32
from ves_gym.baselines.evaluate import spec_of
from ves_gym.baselines.ppo import flat

PACKAGES = ("minari", "h5py")
_OURS = ("dump", "render_mode")  # what whoever replays decides
# What replaying may differ by on another processor: rewards are computed in double precision,
# observations are rounded to single (two neighbours of numbers up to 5 are 5e-7 apart).
REWARDS, OBSERVATIONS = 1e-9, 1e-6


@dataclass(frozen=True)
class Replay:
    """Differences of stored episodes from those of a fresh environment."""

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
    """Write a data set to its id's folder in `root`, completely or not at all; the folder."""
    require("a data set", *PACKAGES)
    from minari.data_collector import EpisodeBuffer
    from minari.dataset.minari_storage import MinariStorage

    recipe = dataset.recipe
    noise = f" with noise of {recipe.noise:g} added to every action" if recipe.noise else ""
    # absolute, for names of temporary folders are relative before Python 3.12
    target = Path(root).absolute() / recipe.id
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
                **{name: getattr(e, name) for name in COLUMNS},
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


def read_episodes(path: str | os.PathLike[str]) -> list[Episode]:
    """Read the episodes of a data set's folder, also of one that Minari wrote elsewhere.

    Raises:
        ParameterError: no data set, or episodes without seeds.
    """
    return _read(path)[1]


def _read(path: str | os.PathLike[str]) -> tuple[dict[str, Any], list[Episode]]:
    """Specification of the environment, and the episodes."""
    require("a data set", *PACKAGES)
    folder = Path(path) / "data"  # as in Minari's own folders
    folder = folder if folder.is_dir() else Path(path)
    for name in ("metadata.json", "main_data.hdf5"):
        if not (folder / name).is_file():
            raise ParameterError(f"{folder}: is no data set of Minari: it has no {name}")
    with named(folder):
        arrays = read_apart(
            "ves_gym.baselines.minari_files:arrays_of", folder / "main_data.hdf5"
        )
        about = json.loads(str(arrays["about"]))
        if any(k["seed"] is None for k in about["episodes"]):
            raise ParameterError("expected the seed of every episode, got none")
    episodes = []
    for number, k in enumerate(about["episodes"]):
        fields = {name: arrays[f"{number}:observations:{name}"] for name in about["fields"]}
        columns = {name: arrays[f"{number}:{name}"] for name in COLUMNS}
        observations = fields.get("", fields)  # goals have names
        episodes.append(Episode(observations=observations, **columns, **k))
    return about["env"], episodes


def arrays_of(file: Path) -> dict[str, Any]:
    """A data set as plain arrays, for `read_apart`."""
    import minari

    try:
        stored = minari.MinariDataset(file.parent)
        spec = json.loads(json.loads((file.parent / "metadata.json").read_text())["env_spec"])
        abouts = list(stored.storage.get_episode_metadata(stored.episode_indices))
    except (OSError, ValueError, KeyError, TypeError, AssertionError) as error:
        raise ParameterError(f"is no data set of Minari: {error}") from None
    out: dict[str, Any] = {}
    fields: dict[str, Any] = {}
    episodes = [
        {
            "seed": None if about.get("seed") is None else int(about["seed"]),
            "behaviour": str(about.get("behaviour", "")),
            "success": bool(about.get("success", False)),
        }
        for about in abouts
    ]
    for number, episode in enumerate(stored.iterate_episodes()):
        fields = episode.observations
        fields = fields if isinstance(fields, dict) else {"": fields}
        out |= {f"{number}:observations:{name}": values for name, values in fields.items()}
        out |= {f"{number}:{name}": getattr(episode, name) for name in COLUMNS}
    about = json.dumps({"env": spec, "episodes": episodes, "fields": list(fields)})
    return {"about": np.array(about), **{k: np.asarray(v) for k, v in out.items()}}


def replay(path: str | os.PathLike[str]) -> Replay:
    """Carry out the stored actions, from the stored seeds, in the environment that is named.

    Raises:
        ParameterError: no data set, or an environment that is none of this package.
    """
    about, episodes = _read(path)
    with named(path):
        env = _environment(about)
    steps, rewards, observations, ends = 0, 0.0, 0.0, True
    for episode in episodes:
        rows, paid, over = _replay(env, episode.seed, episode.actions)
        before = flat(episode.observations)
        ended = episode.terminations | episode.truncations
        if not np.array_equal(over, ended) or len(rows) != len(before):
            ends = False
            continue
        steps += len(paid)
        rewards = max(rewards, float(np.abs(paid - episode.rewards).max()))
        observations = max(observations, float(np.abs(rows - before).max()))
    env.close()
    return Replay(len(episodes), steps, rewards, observations, ends)


def _environment(about: dict[str, Any]) -> Any:
    """The environment of a specification: of its names only the id, registered, is used."""
    spec = spec_of(str(about.get("id")))
    if not (isinstance(spec.entry_point, str) and spec.entry_point.startswith("ves_gym.")):
        raise ParameterError(f"expected an environment of ves_gym, got {spec.id}")
    settings = {k: v for k, v in (about.get("kwargs") or {}).items() if k not in _OURS}
    return gym.make(spec, **settings)


def _replay(env: Any, seed: int, actions: Float32) -> tuple[Float32, Array, Array]:
    """Observations, rewards and ends of an episode with given actions, until it is over."""
    observation, _ = env.reset(seed=seed)
    rows, rewards, over = [flat(observation)], [], []
    for action in actions:
        observation, reward, terminated, truncated, _ = env.step(action)
        rows.append(flat(observation))
        rewards.append(reward)
        over.append(terminated or truncated)
        if over[-1]:
            break
    return np.stack(rows), np.array(rewards), np.array(over)
