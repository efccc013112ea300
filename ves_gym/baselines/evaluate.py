"""`evaluate`: how well a controller does, on episodes that are always the same.

Episode k of seed s is what `env.reset(seed=s + k)` begins, whatever runs beside it and
however many run at once. Every episode counts, failures included.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec, load_env_creator
from gymnasium.vector import AutoresetMode

from ves_gym._util.params import Array, Index, Mask, ParameterError, integer, to_plain
from ves_gym._util.statistics import STATISTICS, Estimate, bootstrap, iqm, rate
from ves_gym._util.suggest import did_you_mean
from ves_gym.baselines.controllers import Controller
from ves_gym.envs.build import build_task
from ves_gym.envs.control import for_system
from ves_gym.envs.vector import VesVectorEnv
from ves_gym.mechanics.arm_library import arm_from
from ves_gym.system.effect import Effect

ENERGIES = ("E_mean", "E_peak", "E_res", "E_int")
MEASURES = ("return", *ENERGIES)
RATES = ("success", "success_once")
MOST_EPISODES = 1_000_000
_AT_ONCE = 128  # environments by default: more gain no speed
_ROUNDING = 1e-15  # J or J s: a base that nothing moves has less

Progress = Callable[[float], None]


@dataclass(frozen=True)
class Evaluation:
    """Results of every episode."""

    name: str
    id: str
    settings: Mapping[str, Any]
    rows: list[dict[str, Any]]
    about: Mapping[str, Any] = field(default_factory=dict)
    seconds: float = 0.0

    def values(self, measure: str) -> list[Array]:
        """A measure's values: (episodes, groups) of the same episodes, else group by group."""
        groups: dict[int, dict[int, float]] = {}
        for row in self.rows:
            groups.setdefault(row["group"], {})[row["seed"]] = float(row[measure])
        strata = list(groups.values())
        if len(strata) > 1 and all(g.keys() == strata[0].keys() for g in strata):
            return [np.array([[g[seed] for g in strata] for seed in strata[0]])]
        return [np.array(list(g.values())) for g in strata]

    @property
    def iqm(self) -> float:
        """Interquartile mean return."""
        return bootstrap(self.values("return"), iqm).value

    def summary(self) -> dict[str, Any]:
        """Mean, median and interquartile mean of the measures, and the rates of success."""
        out: dict[str, Any] = {"episodes": len(self.rows)}
        out["failed"] = sum(row["failed"] for row in self.rows)
        for name in MEASURES:
            values = self.values(name)
            out[name] = {kind: bootstrap(values, k) for kind, k in STATISTICS.items()}
        for name in RATES:
            out[name] = rate(np.concatenate(self.values(name)) > 0)
        return out

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON; what is infinite becomes null."""
        entry = {k: v for k, v in vars(self).items() if k != "id"}
        out: dict[str, Any] = plain({**entry, "summary": self.summary()})
        return out


def evaluate(
    controller: Controller,
    id: str,
    *,
    episodes: int = 100,
    seed: int = 0,
    n_envs: int | None = None,
    threads: int = 0,
    progress: Progress | None = None,
    **settings: Any,
) -> Evaluation:
    """Run a controller or policy on an environment.

    Args:
        id: registered id; its randomisation applies. `randomize={}` turns it off.
        episodes, seed: episode k begins with `env.reset(seed=seed + k)`.
        n_envs: how many run at once; the results do not depend on it.
        threads: of the engine, 0 = one per processor.
        progress: called with the fraction done.
        settings: other settings of the environment (see `envs.build_task`).
    """
    episodes, seed = integer(episodes, "episodes", 1, MOST_EPISODES), integer(seed, "seed")
    n_envs = None if n_envs is None else integer(n_envs, "n_envs", 1, MOST_EPISODES)
    settings = {**settings_of(controller, id), **settings}
    begin = time.perf_counter()
    env = make_vector(
        id, min(n_envs or _AT_ONCE, episodes), AutoresetMode.DISABLED, threads, **settings
    )
    rows: list[dict[str, Any]] = []
    for step in run_episodes(controller, env, range(seed, seed + episodes)):
        if step.ended.any():
            rows += _rows(env, step.ended, step.seeds, step.info)
            if progress is not None:
                progress(len(rows) / episodes)
    env.close()
    rows.sort(key=lambda row: row["seed"])
    about = getattr(controller, "about", {})
    seconds = round(time.perf_counter() - begin, 3)
    return Evaluation(controller.name, id, settings, rows, about, seconds)


def settings_of(controller: Controller, id: str) -> dict[str, Any]:
    """Return the settings of an environment that a controller needs."""
    needs = getattr(controller, "settings", None)
    return dict(needs(spec_of(id))) if needs is not None else {}


@dataclass(frozen=True)
class EpisodePeriod:
    """A control period of n environments, of which some wait while the last episodes end."""

    seeds: Index  # (n,) of their episodes, -1: it waits
    observation: Any  # (n, o) before it
    actions: Array  # (n, a)
    following: Any  # (n, o) after it, before any reset
    reward: Array  # (n,)
    terminated: Mask  # (n,)
    truncated: Mask  # (n,)
    info: Mapping[str, Any]

    @property
    def ended(self) -> Mask:
        """(n,) episodes that end here."""
        return (self.terminated | self.truncated) & (self.seeds >= 0)


def run_episodes(
    controller: Controller, env: VesVectorEnv, seeds: Iterable[int]
) -> Iterator[EpisodePeriod]:
    """Step through an episode of every seed, as many at once as there are environments.

    Args:
        controller: that acts.
        env: with autoreset disabled; between the steps it is as the last one left it.
        seeds: of the episodes, each begun by `env.reset(seed=...)`.
    """
    queue = list(seeds)[::-1]
    running = np.full(env.num_envs, -1)
    ended = np.ones(env.num_envs, bool)
    observation: Any = None
    while queue or not (ended | (running < 0)).all():
        if ended.any():  # idle ones begin any episode
            for i in np.flatnonzero(ended).tolist():
                running[i] = queue.pop() if queue else -1
            begun = ended & (running >= 0)
            chosen = [
                k if begins else None for k, begins in zip(running.tolist(), begun, strict=True)
            ]
            observation = env.reset(seed=chosen, options={"reset_mask": ended})[0]
            if begun.any():
                controller.reset(env, np.flatnonzero(begun))
        idle = running < 0
        actions = controller.act(env, observation)
        if idle.any():
            actions = np.where(idle[:, None], 0.0, actions)
        before = observation
        observation, reward, terminated, truncated, info = env.step(actions)
        ended = terminated | truncated
        yield EpisodePeriod(
            running.copy(), before, actions, observation, reward, terminated, truncated, info
        )


def spec_of(id: str) -> EnvSpec:
    """Return what is registered under an id; an unknown one is refused with the closest.

    Args:
        id: also "module:id", of a module that is imported: an id may come from a file, and
            nothing that is read is run.
    """
    module, _, plain = id.rpartition(":")
    if module and module not in sys.modules:
        raise ParameterError(
            f"{id}: module {module!r} is not imported; import it first (--import {module})"
        )
    try:
        return gym.spec(plain)
    except gym.error.Error:
        ids = sorted(k for k in gym.registry if k.startswith("ves/"))
        hint = did_you_mean(id.rpartition("/")[2].partition("-v")[0], ids)
        hint = hint or f"; known: {', '.join(ids)}"
        raise ParameterError(
            f"no environment {id!r}{hint} (`ves-gym list environments`)"
        ) from None


def make_vector(
    id: str, n: int, mode: AutoresetMode, threads: int = 0, **settings: Any
) -> VesVectorEnv:
    """The native vector environment of a registered id."""
    entry: Any = spec_of(id).vector_entry_point
    entry = load_env_creator(entry) if isinstance(entry, str) else entry
    if not (isinstance(entry, type) and issubclass(entry, VesVectorEnv)):
        raise ParameterError(f"{id} has no vector environment of ves_gym")
    env: Any = gym.make_vec(
        id,
        num_envs=n,
        vectorization_mode="vector_entry_point",
        autoreset_mode=mode,
        threads=threads,
        **settings,
    )
    return env


def with_deviations(
    id: str,
    settings: Mapping[str, Any],
    effects: Sequence[Effect] = (),
    arm: str | Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Return an environment's settings with more effects, and another arm in place of its own.

    Numbers per joint of a control among the settings become those of the arm.
    """
    id = id if "/" in id else f"ves/{id}"
    out = dict(settings)
    if arm is not None:
        described = arm_from(arm)  # refused here, not in a worker
        if "control" in settings:
            task = build_task(**{**spec_of(id).kwargs, **settings})
            system = task.system.replace(arm=described)
            out["control"] = to_plain(for_system(task.control, system))
        out["arm"] = arm
    if effects:
        task = build_task(**{**spec_of(id).kwargs, **out})
        out["effects"] = [to_plain(e) for e in (*task.system.effects, *effects)]
    return out


def _rows(
    env: VesVectorEnv, which: Mask, running: Index, info: Mapping[str, Any]
) -> list[dict[str, Any]]:
    e = env.batch.episodes
    columns = {
        "seed": running,
        "group": np.zeros_like(running),
        "return": e.total,
        "length": e.steps,
        "success": info["success"],
        "success_once": info["success_once"],
        "failed": (info["reward/failure"] < 0) | info["diverged"],
    }
    for name in ENERGIES:
        value = info[f"energy/{name}"]
        columns[name] = np.where(np.isfinite(value), value, np.inf)
    rows = zip(*(column[which].tolist() for column in columns.values()), strict=True)
    return [dict(zip(columns, row, strict=True)) for row in rows]


def pool(evaluations: Sequence[Evaluation], name: str) -> Evaluation:
    """Several policies of one kind as one, a group each; their episodes are drawn together."""
    first = evaluations[0]
    rows = [{**row, "group": g} for g, e in enumerate(evaluations) for row in e.rows]
    about = {"policies": [dict(e.about) for e in evaluations]}
    seconds = sum(e.seconds for e in evaluations)
    return Evaluation(name, first.id, first.settings, rows, about, seconds)


# --------------------------------------------------------------------- comparison


def ratio(a: Evaluation, b: Evaluation, measure: str = "E_mean") -> Estimate:
    """Median over episodes of a's measure over b's on the same episode."""
    reference = {row["seed"]: float(row[measure]) for row in b.rows}
    groups: dict[int, list[float]] = {}
    for row in a.rows:
        if reference.get(row["seed"], 0.0) > _ROUNDING:
            groups.setdefault(row["group"], []).append(
                float(row[measure]) / reference[row["seed"]]
            )
    if not groups:
        raise ParameterError(
            f"{a.name} and {b.name} share no episode with {measure} > {_ROUNDING:g}"
        )
    return bootstrap([np.array(g) for g in groups.values()], STATISTICS["median"])


def beats(a: Evaluation, b: Evaluation) -> bool:
    """Return True if a has more return than b, 95 % intervals of interquartile means apart."""
    better, worse = (bootstrap(e.values("return"), iqm) for e in (a, b))
    return better.low > worse.high


def ratio_or_none(a: Evaluation, b: Evaluation, measure: str) -> Estimate | None:
    """Return `ratio`, None where nothing moves the base."""
    try:
        return ratio(a, b, measure)
    except ParameterError:
        return None


def plain(value: Any) -> Any:
    """Return plain data for JSON; what is infinite becomes null."""
    if isinstance(value, Estimate):
        return {k: plain(v) for k, v in value._asdict().items()}
    if isinstance(value, Mapping):
        return {k: plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, float) and not np.isfinite(value):
        return None
    json.dumps(value)  # anything else is no plain data, and says so
    return value
