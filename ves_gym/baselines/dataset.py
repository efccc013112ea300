"""Data sets of episodes: recipes, the episodes made from them, and fingerprints of these.

What is committed of a data set is its recipe (who acts in which environment, from which seeds)
and a fingerprint; the episodes themselves are made again by `ves-gym dataset make`. A seed and
the stored actions give an episode exactly: observations are float32 and so are the actions
that were carried out.

A fingerprint must not depend on the processor, whose rounding reaches the last bits of every
number. Rounded numbers do not do: of a hundred thousand of them some lie so close to the edge
between two roundings that another processor falls on the other side. So it holds sums of all
numbers with signs drawn at random, which differ by as little as the numbers do, and are
compared within `TOLERANCE`. A number that changed by d moves each of the sums by d / sqrt(n).
"""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
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
    content_hash,
    from_plain,
    read_table,
    to_plain,
    write_text,
)
from ves_gym._util.suggest import did_you_mean
from ves_gym.baselines.comparison import line_up
from ves_gym.baselines.controllers import Controller, remember, row_of_step
from ves_gym.baselines.evaluate import make_vector, run_episodes, settings_of, spec_of
from ves_gym.baselines.policy import Policy, task_name
from ves_gym.envs.build import build_task
from ves_gym.envs.vector import VesVectorEnv

SCHEMA = "ves-dataset/1"
RECIPES = Path(__file__).parent / "datasets"
TOLERANCE = 1e-5  # of a fingerprint's sums, over the root mean square of the numbers
_COLUMNS = ("actions", "rewards", "terminations", "truncations")  # of an episode
_SUMS = 16  # random sums of a fingerprint
_DIGITS = 10  # of numbers in an identity
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
    identity: str  # SHA-256 of all that decides the content: recipe, task, weights of policies
    episodes: tuple[Episode, ...]

    @cached_property
    def fingerprint(self) -> dict[str, Any]:
        """Fingerprint of the content, as committed (`fingerprint_of`)."""
        return fingerprint_of(self.identity, self.episodes)


def fingerprint_of(identity: str, episodes: Sequence[Episode]) -> dict[str, Any]:
    """Content as plain data, the same on every processor within `TOLERANCE`.

    Args:
        identity: of the data set.
        episodes: all of them.

    Returns:
        `identity`, numbers of episodes, steps and solved episodes, and `sums` of each array
        (`random_sums`).
    """
    arrays = {
        name: [flat_observations(getattr(e, name)) for e in episodes]
        for name in ("observations", *_COLUMNS)
    }
    return {
        "identity": identity,
        "episodes": len(episodes),
        "steps": sum(len(e.rewards) for e in episodes),
        "solved": sum(e.success for e in episodes),
        "sums": {
            name: random_sums(np.concatenate(parts).astype(np.float64))
            for name, parts in arrays.items()
        },
    }


def random_sums(x: Array) -> list[float]:
    """Return the root mean square of numbers and `_SUMS` sums of them with random signs.

    Args:
        x: any shape.

    Returns:
        1 + `_SUMS` numbers; the sums are over sqrt(x.size). The signs are raw bits of a
        counter-based generator, which no version of NumPy draws otherwise.
    """
    flat = x.ravel()
    bits = np.random.Philox(key=0).random_raw(_SUMS * -(-flat.size // 64))
    ones = np.unpackbits(bits.astype("<u8").view(np.uint8)).reshape(_SUMS, -1)
    signs = 2.0 * ones[:, : flat.size] - 1.0
    scale = math.sqrt(flat.size)
    root_mean_square = math.sqrt(math.fsum(flat * flat)) / scale
    return [root_mean_square, *(math.fsum(row * flat) / scale for row in signs)]


def differences(got: Mapping[str, Any], expected: Mapping[str, Any]) -> list[str]:
    """Return what tells two of `fingerprint_of` apart, in words; nothing where they agree."""
    out = [
        f"{name} is {got[name]}, expected {expected[name]}"
        for name in ("identity", "episodes", "steps", "solved")
        if got[name] != expected[name]
    ]
    for name, sums in expected["sums"].items():
        a, b = np.array(got["sums"][name]), np.array(sums)
        gap = float(np.abs(a - b).max())
        if not gap <= TOLERANCE * max(float(b[0]), 1e-12):
            out.append(f"{name} differ: random sums by {gap:.3g} of {b[0]:.3g}")
    return out


# ------------------------------------------------------------------------- recipes


def recipes() -> dict[str, Recipe]:
    """Recipes that come with the package, by id."""
    return {r.id: r for path in sorted(RECIPES.glob("*.toml")) for r in read_recipes(path)}


def read_recipes(path: str | os.PathLike[str]) -> list[Recipe]:
    """Recipes from a TOML file: `env`, `seed`, `episodes`, and a table [[set]] of each.

    Args:
        path: of the file; unknown keys in it are an error.
    """
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


def recorded(recipe: Recipe) -> dict[str, Any] | None:
    """Return the fingerprint that is committed of a recipe, None if there is none."""
    path = _beside(recipe)
    if not path.exists():
        return None
    fingerprint: dict[str, Any] | None = read_table(path).get(recipe.id)
    return fingerprint


def record(datasets: Sequence[Dataset]) -> None:
    """Write the fingerprints of data sets beside their recipes in the package.

    Args:
        datasets: made from recipes of the package.
    """
    for dataset in datasets:
        path = _beside(dataset.recipe)
        table = read_table(path) if path.exists() else {}
        table[dataset.recipe.id] = dataset.fingerprint
        write_text(path, json.dumps(table, indent=1, sort_keys=True) + "\n")


def _beside(recipe: Recipe) -> Path:
    return RECIPES / f"{task_name(recipe.env)}.json"


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
    return Dataset(recipe, settings, identity_of(recipe), in_order)


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
                arrays = dict(zip(_COLUMNS, map(np.array, parts), strict=True))
                success = bool(period.info["success"][i])
                yield Episode(seed, controller.name, rows, success=success, **arrays)


def _row(observation: Any, i: int) -> Any:
    if isinstance(observation, Mapping):
        return {k: v[i].copy() for k, v in observation.items()}
    return observation[i].copy()


def _stacked(rows: Sequence[Any]) -> Any:
    if isinstance(rows[0], Mapping):
        return {k: np.stack([row[k] for row in rows]) for k in rows[0]}
    return np.stack(rows)


def flat_observations(observations: Any) -> Float32:
    """Return observations as one array; parts of a dictionary by name, one after another.

    Args:
        observations: (..., o) or a dictionary of such.
    """
    if isinstance(observations, Mapping):
        return np.concatenate([observations[k] for k in sorted(observations)], axis=-1)
    return np.asarray(observations)


def _rounded(value: Any) -> Any:
    """Plain data with numbers to `_DIGITS` of the largest in their array.

    The last ones of a stiffness that LAPACK computes are those of the processor.
    """
    if isinstance(value, dict):
        return {k: _rounded(x) for k, x in value.items()}
    if not isinstance(value, float | list | tuple):
        return value
    try:
        array = np.asarray(value, float)
    except (TypeError, ValueError):  # of tables, of words
        return [_rounded(x) for x in value] if isinstance(value, list | tuple) else value
    largest = float(np.abs(array).max(initial=0.0))
    if not 0 < largest < np.inf:
        return value
    return (np.round(array, _DIGITS - math.ceil(math.log10(largest))) + 0.0).tolist()


def identity_of(recipe: Recipe) -> str:
    """Return the SHA-256 of all that decides the content: recipe, task, weights of policies.

    It is the same on every processor, and nothing is simulated.
    """
    controllers = [_behaviour(recipe, name) for name in recipe.behaviours]
    settings = _settings(recipe, controllers)
    kwargs = {**spec_of(recipe.env).kwargs, **settings}
    goal = bool(kwargs.pop("goal", False))
    weights = [
        [to_plain(c.network), [[W.tolist(), b.tolist()] for W, b in c.weights]]
        if isinstance(c, Policy)
        else None
        for c in controllers
    ]
    return content_hash(
        {
            "schema": SCHEMA,
            "recipe": to_plain(recipe),
            "task": _rounded(build_task(**kwargs).to_dict()),
            "goal": goal,
            "weights": weights,
        }
    )
