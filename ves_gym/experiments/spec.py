"""`Spec`: what a sweep is made of, as a TOML file, and the units that it names."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ves_gym._util.params import ParameterError, from_plain, read_table, require_types, to_plain
from ves_gym.baselines.comparison import policy_files
from ves_gym.baselines.config import TrainConfig, choose_config
from ves_gym.baselines.evaluate import MOST_EPISODES
from ves_gym.baselines.registry import CONTROLLERS
from ves_gym.experiments.units import Unit, evaluate_unit, plan_unit, train_unit
from ves_gym.planners.registry import get_planner
from ves_gym.planners.suites import get_suite
from ves_gym.system.system import System


@dataclass(frozen=True, kw_only=True)
class Evaluations:
    """Environments x policies x seeds, each so many episodes."""

    envs: tuple[str, ...]
    policies: tuple[str, ...]  # controllers, `released`, files, folders of `ves-gym train`
    seeds: tuple[int, ...] = (0,)  # of a unit's first episode
    episodes: int = 100
    settings: dict[str, Any] = field(default_factory=dict)  # of the environments


@dataclass(frozen=True, kw_only=True)
class Trainings:
    """Configurations x seeds."""

    configs: tuple[str, ...]  # names of those of the package, or files
    seeds: tuple[int, ...] | None = None  # None: the configuration's
    changes: dict[str, Any] = field(
        default_factory=dict
    )  # entries of the configuration that differ


@dataclass(frozen=True, kw_only=True)
class Plannings:
    """Planners x the queries of a suite x seeds."""

    suite: str
    planners: tuple[str, ...]
    seeds: tuple[int, ...] = (0,)
    vehicle: str | None = None
    obstacles: str = "off"
    durations: tuple[float, ...] | None = None  # s; None: all of them
    queries: int | None = None  # per duration; None: all of them
    system: dict[str, Any] = field(default_factory=dict)  # what differs from `System()`


@dataclass(frozen=True, kw_only=True)
class Spec:
    """A sweep."""

    evaluate: tuple[Evaluations, ...] = ()
    train: tuple[Trainings, ...] = ()
    plan: tuple[Plannings, ...] = ()
    seconds: float | None = None  # that a unit may take

    def __post_init__(self) -> None:
        require_types(self, "evaluate", "train", "plan")
        if not (self.evaluate or self.train or self.plan):
            raise ParameterError("a sweep needs [[evaluate]], [[train]] or [[plan]], got none")
        if self.seconds is not None and not self.seconds > 0:
            raise ParameterError(f"Spec.seconds must be > 0 s, got {self.seconds}")
        tables: tuple[Evaluations | Trainings | Plannings, ...]
        tables = (*self.evaluate, *self.train, *self.plan)
        for table in tables:
            if any(seed < 0 for seed in table.seeds or ()) or table.seeds == ():
                raise ParameterError(f"seeds must be numbers >= 0, got {table.seeds}")
        for entry in self.evaluate:
            if not 1 <= entry.episodes <= MOST_EPISODES:
                raise ParameterError(
                    f"episodes must be 1 to {MOST_EPISODES}, got {entry.episodes}"
                )


def read_spec(path: str | os.PathLike[str]) -> Spec:
    """A sweep from a TOML or JSON file; unknown keys are an error."""
    spec: Spec = from_plain(Spec, read_table(path), str(path))
    return spec


def units_of(spec: Spec, base: Path = Path()) -> list[Unit]:
    """The units of a sweep in order, none twice.

    Args:
        base: folder that paths in the spec start from.
    """
    units: dict[str, Unit] = {}
    for tables, expand in (
        (spec.evaluate, _evaluations),
        (spec.train, _trainings),
        (spec.plan, _plannings),
    ):
        for table in tables:
            for unit in expand(table, base):  # type: ignore[arg-type]
                units.setdefault(unit.id, unit)
    return list(units.values())


def _evaluations(table: Evaluations, base: Path) -> Iterable[Unit]:
    for name in table.envs:
        env = name if "/" in name else f"ves/{name}"
        for policy in table.policies:
            for who in policies_of(policy, env, base):
                for seed in table.seeds:
                    yield evaluate_unit(env, who, seed, table.episodes, table.settings)


def policies_of(text: str, env: str, base: Path) -> list[str]:
    """Return a controller's name, or the files of policies that a text stands for."""
    if text in CONTROLLERS:
        return [text]
    return [str(file.resolve()) for file in policy_files(text, env, base)]


def _trainings(table: Trainings, base: Path) -> Iterable[Unit]:
    for name in table.configs:
        stated = choose_config(name, base=base).to_dict()
        config: TrainConfig = from_plain(TrainConfig, changed(stated, table.changes), name)
        for seed in config.seeds if table.seeds is None else table.seeds:
            yield train_unit(config, seed)


def changed(table: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return a table with some of its entries replaced, those of tables in it one by one."""
    out = dict(table)
    for key, value in changes.items():
        old = out.get(key)
        both = isinstance(old, Mapping) and isinstance(value, Mapping)
        out[key] = changed(old, value) if both else value  # type: ignore[arg-type]
    return out


def _plannings(table: Plannings, base: Path) -> Iterable[Unit]:
    system = System.from_dict(changed(to_plain(System()), table.system), "plan.system")
    suite = get_suite(
        table.suite, system=system, vehicle=table.vehicle, obstacles=table.obstacles
    )
    for planner in table.planners:
        get_planner(planner)
    count: dict[tuple[str, float], int] = {}
    taken = 0
    for vehicle, query in suite.queries:
        if table.durations is not None and query.duration not in table.durations:
            continue
        at = vehicle, query.duration
        count[at] = count.get(at, 0) + 1
        if table.queries is not None and count[at] > table.queries:
            continue
        taken += 1
        for planner in table.planners:
            for seed in table.seeds:
                yield plan_unit(suite.name, vehicle, query, planner, seed)
    if not taken:
        durations = ", ".join(
            f"{d:g}" for d in dict.fromkeys(q.duration for _, q in suite.queries)
        )
        raise ParameterError(
            f"suite {suite.name} has durations {durations} s, got {table.durations} and"
            f" {table.queries} queries of each"
        )
