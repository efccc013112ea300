"""Data sets of episodes: recipes, and the episodes made from them.

What is committed of a data set is its recipe: who acts in which environment, from which seeds.
The episodes are made by `ves-gym dataset make`. A seed and the stored actions give an episode
exactly: observations are float32 and so are the actions that were carried out.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode

from ves_gym._util.params import (
    Array,
    Index,
    Mask,
    ParameterError,
    from_plain,
    read_table,
)
from ves_gym._util.suggest import did_you_mean
from ves_gym.baselines.comparison import line_up
from ves_gym.baselines.controllers import Controller, remember, row_of_step
from ves_gym.baselines.evaluate import make_vector, run_episodes, settings_of
from ves_gym.envs.vector import VesVectorEnv

RECIPES = Path(__file__).parent / "datasets"
COLUMNS = ("actions", "rewards", "terminations", "truncations")  # of an episode
_AT_ONCE = 32  # episodes
_ID = re.compile(r"[-\w]+(/[-\w]+)*-v\d+")  # as Minari takes it

Float32 = npt.NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """Recipe of a data set; episode k begins with `env.reset(seed=seed + k)`."""

    id: str  # of the data set, such as ves/PumaReach-v0/mixed-v0
    env: str
    behaviours: tuple[str, ...]  # controllers and released policies, which take turns
    episodes: int
    seed: int
    noise: float = 0.0  # standard deviation of what is added to the actions

    def __post_init__(self) -> None:
        if not _ID.fullmatch(self.id):
            raise ParameterError(f"Recipe.id must be like ves/Env-v0/name-v0, got {self.id!r}")
        if not self.behaviours or self.episodes < 1 or self.seed < 0:
            raise ParameterError(
                "Recipe needs behaviours, episodes >= 1 and seed >= 0, got"
                f" {self.behaviours}, {self.episodes} and {self.seed}"
            )
        if not 0 <= self.noise < math.inf:
            raise ParameterError(f"Recipe.noise must be >= 0, got {self.noise}")


@dataclass(frozen=True, eq=False)
class Episode:
    """One episode of T steps, as it is stored."""

    seed: int
    behaviour: str
    observations: Any  # (T + 1, o) in float32, or a dictionary of such
    actions: Float32  # (T, a) as they were carried out
    rewards: Array  # (T,)
    terminations: Mask  # (T,)
    truncations: Mask  # (T,)
    success: bool


@dataclass(frozen=True, eq=False)
class Dataset:
    """Episodes and the recipe that they follow."""

    recipe: Recipe
    settings: Mapping[str, Any]  # of the environment, that the behaviours need
    episodes: tuple[Episode, ...]


# ------------------------------------------------------------------------- recipes


def recipes() -> dict[str, Recipe]:
    """Recipes that come with the package, by id."""
    return {r.id: r for path in sorted(RECIPES.glob("*.toml")) for r in read_recipes(path)}


def read_recipes(path: str | os.PathLike[str]) -> list[Recipe]:
    """Recipes from a TOML file: `env`, `seed`, `episodes`, and a table [[set]] of each."""
    table = read_table(path)
    shared = {k: v for k, v in table.items() if k != "set"}
    out = []
    for entry in table.get("set", ()):
        plain = {**shared, **entry}
        if "name" in plain:
            plain["id"] = f"{plain.get('env')}/{plain.pop('name')}-v0"
        recipe: Recipe = from_plain(Recipe, plain, f"{path}: set")
        out.append(recipe)
    if not out:
        raise ParameterError(f"{path}: expected tables [[set]], got none")
    return out


def choose_recipes(words: Sequence[str]) -> list[Recipe]:
    """Return the recipes that words stand for.

    Args:
        words: ids of recipes or of environments, or .toml files of recipes; none: all of
            those that come with the package.

    Raises:
        ParameterError: an unknown word.
    """
    shipped = recipes()
    out: dict[str, Recipe] = {} if words else dict(shipped)
    for word in words:
        name = word if word.startswith("ves/") else f"ves/{word}"
        if Path(word).suffix == ".toml":
            chosen = read_recipes(word)
        else:
            chosen = [r for r in shipped.values() if name in (r.id, r.env)]
        if not chosen:
            raise ParameterError(
                f"data set must be a .toml file or one of {', '.join(shipped)}, got"
                f" {word!r}{did_you_mean(name, shipped)}"
            )
        out |= {r.id: r for r in chosen}
    return list(out.values())


# -------------------------------------------------------------------------- making


class _Stored:
    """Acts as another controller does, with noise, in the float32 that is stored."""

    _added: Array  # (n, steps, width)

    def __init__(self, inner: Controller, noise: float) -> None:
        self.inner, self.noise = inner, noise
        self.name, self.privileged = inner.name, inner.privileged

    def reset(self, env: VesVectorEnv, ids: Index) -> None:
        self.inner.reset(env, ids)
        shape = env.task.steps, env.batch.width
        remember(self, env.num_envs, _added=shape)
        for i in ids.tolist() if self.noise else ():
            draw = np.random.default_rng((int(env.batch.episodes.root[i]), 1))
            self._added[i] = self.noise * draw.standard_normal(shape)

    def act(self, env: VesVectorEnv, observation: Any) -> Any:
        added = row_of_step(env, self._added)
        actions = np.clip(self.inner.act(env, observation) + added, -1.0, 1.0)
        return actions.astype(np.float32)


def make_dataset(recipe: Recipe) -> Dataset:
    """Make the episodes of a recipe."""
    controllers = [_behaviour(recipe, name) for name in recipe.behaviours]
    settings = _settings(recipe, controllers)
    episodes: dict[int, Episode] = {}
    for turn, controller in enumerate(controllers):
        first, end = recipe.seed + turn, recipe.seed + recipe.episodes
        seeds = range(first, end, len(controllers))
        if not seeds:
            continue
        n = min(_AT_ONCE, len(seeds))
        env = make_vector(recipe.env, n, AutoresetMode.DISABLED, 1, **settings)
        for episode in _episodes(_Stored(controller, recipe.noise), env, seeds):
            episodes[episode.seed] = episode
        env.close()
    in_order = tuple(episodes[seed] for seed in sorted(episodes))
    return Dataset(recipe, settings, in_order)


def _behaviour(recipe: Recipe, name: str) -> Controller:
    ((_, group),) = line_up(recipe.env, [name], recipe.seed)
    if len(group) != 1:
        raise ParameterError(f"{recipe.id}: {name} must be one policy, got {len(group)}")
    return group[0]


def _settings(recipe: Recipe, controllers: Sequence[Controller]) -> dict[str, Any]:
    """Settings of the environment that the behaviours need, each of them the same."""
    out: dict[str, Any] = {}
    for controller in controllers:
        for key, value in settings_of(controller, recipe.env).items():
            if out.setdefault(key, value) != value:
                raise ParameterError(
                    f"{recipe.id}: behaviours that share a data set must need the same {key},"
                    f" got {out[key]!r} and {value!r}"
                )
    return out


def _episodes(
    controller: Controller, env: VesVectorEnv, seeds: Sequence[int]
) -> Iterator[Episode]:
    steps: dict[int, list[tuple[Any, ...]]] = {}
    for period in run_episodes(controller, env, seeds):
        columns = (period.actions, period.reward, period.terminated, period.truncated)
        for i in np.flatnonzero(period.seeds >= 0).tolist():
            seed = int(period.seeds[i])
            row = (_row(period.observation, i), *(column[i] for column in columns))
            steps.setdefault(seed, []).append(row)
            if period.ended[i]:
                before, *parts = zip(*steps.pop(seed), strict=True)
                rows = _stacked([*before, _row(period.following, i)])
                arrays = dict(zip(COLUMNS, map(np.array, parts), strict=True))
                success = bool(period.info["success"][i])
                yield Episode(seed, controller.name, rows, success=success, **arrays)


def _row(observation: Any, i: int) -> dict[str, Array]:
    """A row by the names of its parts, "" of an array."""
    parts = observation if isinstance(observation, Mapping) else {"": observation}
    return {k: v[i].copy() for k, v in parts.items()}


def _stacked(rows: Sequence[dict[str, Array]]) -> Any:
    out = {k: np.stack([row[k] for row in rows]) for k in rows[0]}
    return out.get("", out)
