"""`search`: the settings of a sweep that do best, found with Optuna.

A trial is a sweep whose spec has some entries set by the sampler, and its value the mean of one
entry of its units' summaries. Units are those of `sweep`, in the same folder. Trials are asked
for and told in batches, each with a sampler of its own seed, so that they depend on the file
alone: a search that was stopped is begun again, comes to the same trials, and does only the
units that have no result yet.
"""

from __future__ import annotations

import copy
import json
import os
import warnings
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ves_gym._util.optional import require
from ves_gym._util.params import (
    ParameterError,
    canonical_json,
    from_plain,
    read_table,
    require_choice,
    require_least,
    require_one_of,
)
from ves_gym._util.tables import table as text_table
from ves_gym.experiments.spec import Spec, units_of
from ves_gym.experiments.sweep import Progress, do_units, opened
from ves_gym.experiments.units import Unit, read_result

SCHEMA = "ves-search/1"
_SHOWN = 10  # trials printed
_MOST = 1024  # processes
SAMPLERS = ("tpe", "random")
DIRECTIONS = ("minimize", "maximize")


@dataclass(frozen=True, kw_only=True)
class Axis:
    """Range or choices of an entry of the spec."""

    low: float | None = None
    high: float | None = None
    log: bool = False  # drawn evenly in its logarithm
    integer: bool = False
    choices: tuple[Any, ...] = ()

    def __post_init__(self) -> None:
        ranged = self.low is not None and self.high is not None
        if ranged == bool(self.choices) or (self.low is None) != (self.high is None):
            raise ParameterError(f"an axis needs low and high, or choices, got {self}")
        if ranged and not self.low < self.high:  # type: ignore[operator]
            raise ParameterError(f"an axis needs low < high, got {self.low} and {self.high}")
        if self.log and not (self.low or 0) > 0:
            raise ParameterError(f"a logarithmic axis needs low > 0, got {self.low}")

    def draw(self, trial: Any, name: str) -> Any:
        """A value suggested for a trial."""
        if self.choices:
            return json.loads(
                trial.suggest_categorical(name, [canonical_json(c) for c in self.choices])
            )
        if self.integer:
            return trial.suggest_int(name, int(self.low), int(self.high), log=self.log)  # type: ignore[arg-type]
        return trial.suggest_float(name, self.low, self.high, log=self.log)


@dataclass(frozen=True, kw_only=True)
class Search:
    """Varied entries and objective; the table `search` beside the tables of a sweep."""

    trials: int
    objective: str  # an entry of the units' summaries, such as return or E_mean
    space: dict[str, Any]  # `Axis` by the path of an entry: train.0.changes.layers
    direction: str = "minimize"
    sampler: str = "tpe"
    seed: int = 0
    batch: int = 4  # trials asked for at once: the search depends on it, not on the workers

    def __post_init__(self) -> None:
        require_choice(self, "direction", DIRECTIONS)
        require_choice(self, "sampler", SAMPLERS)
        require_least(self, 1, "trials", "batch")
        if not self.space:
            raise ParameterError("Search.space must name an entry to vary, got none")
        axes = {k: from_plain(Axis, v, f"search.space.{k}") for k, v in self.space.items()}
        object.__setattr__(self, "space", axes)


@dataclass(frozen=True)
class SearchResult:
    """Trials of a search and the best of them."""

    trials: list[dict[str, Any]]  # number, state, value, params, units, why
    objective: str
    direction: str

    @property
    def complete(self) -> list[dict[str, Any]]:
        """Trials that have a value, the best first."""
        sign = 1.0 if self.direction == "minimize" else -1.0
        complete = [t for t in self.trials if t["state"] == "complete"]
        return sorted(complete, key=lambda t: sign * t["value"])

    @property
    def best(self) -> dict[str, Any] | None:
        """Number, value and params of the best trial; None: all failed."""
        for trial in self.complete:
            return {k: trial[k] for k in ("number", "value", "params")}
        return None

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return {"schema": SCHEMA, "best": self.best, **vars(self)}

    def __str__(self) -> str:
        done, rows = self.complete, []
        for trial in done[:_SHOWN]:
            settings = (
                f"{k.rpartition('.')[2]} {f'{v:.4g}' if isinstance(v, float) else v}"
                for k, v in trial["params"].items()
            )
            rows.append((trial["number"], f"{trial['value']:.5g}", ", ".join(settings)))
        title = f"{len(done)} of {len(self.trials)} trials complete, best first"
        return text_table(("trial", self.objective, "settings"), rows, title=title, left=(2,))


def read_search(path: str | os.PathLike[str]) -> tuple[Search, dict[str, Any]]:
    """A search from a TOML or JSON file, and the plain data of the spec that it varies."""
    table = read_table(path)
    entries = table.pop("search", None)
    if not isinstance(entries, dict):
        raise ParameterError(f"{path}: expected a table [search] beside those of a sweep")
    search: Search = from_plain(Search, entries, f"{path}: search")
    changed = table
    for name, axis in search.space.items():  # every path leads somewhere
        sample = axis.choices[0] if axis.choices else axis.low
        changed = _put(changed, name, int(sample) if axis.integer else sample)
    from_plain(Spec, changed, str(path))
    return search, table


def _put(plain: Any, path: str, value: Any) -> Any:
    """Plain data with the entry at a path set; numbers in the path count in lists."""
    out = plain = copy.deepcopy(plain)
    *way, last = path.split(".")
    try:
        for step in way:
            if isinstance(plain, list):
                plain = plain[int(step)]
            else:
                plain = plain.setdefault(step, {})
        if isinstance(plain, list):
            plain[int(last)] = value
        else:
            plain[last] = value
    except (ValueError, IndexError, AttributeError, TypeError):
        raise ParameterError(f"search.space: {path!r} leads to no entry of the spec") from None
    return out


# --------------------------------------------------------------------------- searching


def search(
    path: str | os.PathLike[str],
    folder: str | os.PathLike[str],
    *,
    workers: int | Executor | None = None,
    seed: int = 0,
    progress: Progress = lambda stage, done: None,
) -> SearchResult:
    """Run the file's number of trials, see `sweep`; `seed` is added to the search's.

    A trial whose units fail is entered as failed.
    """
    optuna = _optuna()
    plan, plain = read_search(path)
    spec: Spec = from_plain(Spec, plain, str(path))
    study = optuna.create_study(direction=plan.direction)
    with opened(workers, spec.seconds, _MOST) as pool:
        for ended in range(0, plan.trials, plan.batch):
            progress("search", ended / plan.trials)
            study.sampler = _sampler(plan, seed, ended)
            trials = [study.ask() for _ in range(min(plan.batch, plan.trials - ended))]
            _batch(study, trials, plan, plain, Path(folder), Path(path).parent, pool)
        progress("search", 1.0)
    trials = [
        {
            "number": t.number,
            "state": t.state.name.lower(),
            "value": t.value,
            "params": dict(t.params),
            "units": [],
            "why": None,
            **t.user_attrs,
        }
        for t in study.get_trials(deepcopy=False)
    ]
    return SearchResult(trials, plan.objective, plan.direction)


def _batch(
    study: Any,
    trials: list[Any],
    plan: Search,
    plain: dict[str, Any],
    root: Path,
    base: Path,
    pool: Any,
) -> None:
    """Run some trials side by side, then report their values, in order."""
    units: dict[int, list[Unit]] = {}
    wrong: dict[int, str] = {}
    for trial in trials:
        changed = plain
        for name, axis in plan.space.items():
            changed = _put(changed, name, axis.draw(trial, name))
        try:
            units[trial.number] = units_of(from_plain(Spec, changed), base)
        except ParameterError as error:  # settings that do not go together
            wrong[trial.number] = str(error)
    every = {unit.id: unit for named in units.values() for unit in named}
    report = do_units(every.values(), root, workers=pool)
    for trial in trials:
        its_units = units.get(trial.number, [])
        trial.set_user_attr("units", [unit.id for unit in its_units])
        failed = [report.failed[u.id] for u in its_units if u.id in report.failed]
        why = wrong.get(trial.number) or next(iter(failed), None)
        value = None if why else _value(root, its_units, plan.objective)
        if value is None:
            why = why or f"its units have no number {plan.objective}"
            trial.set_user_attr("why", why)
            study.tell(trial, state=_optuna().trial.TrialState.FAIL)
        else:
            study.tell(trial, value)


def _value(root: Path, units: list[Unit], objective: str) -> float | None:
    """Mean over the units of an entry of their summaries."""
    values = []
    for unit in units:
        summary = read_result(root / "results" / f"{unit.id}.json")["summary"]
        require_one_of("objective", objective, summary)
        values.append(summary[objective])
    return None if None in values or not values else sum(values) / len(values)


def _sampler(plan: Search, seed: int, ended: int) -> Any:
    """A sampler for the next batch: the seed and what was found decide what it draws."""
    samplers, mixed = _optuna().samplers, (plan.seed + seed) * 1_000_003 + ended
    if plan.sampler == "random":
        return samplers.RandomSampler(seed=mixed % 2**32)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", _optuna().exceptions.ExperimentalWarning)
        return samplers.TPESampler(seed=mixed % 2**32, constant_liar=True)


def _optuna() -> Any:
    require("search", "optuna")
    import optuna

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    return optuna
