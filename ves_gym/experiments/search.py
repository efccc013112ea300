"""`search`: the settings of a sweep that do best, found with Optuna.

A trial is a sweep whose spec has some entries set by the sampler, and its value the mean of one
entry of its units' summaries. Units are those of `sweep`, in the same folder: what is finished
is not done again, and where they run changes nothing. Trials are asked for and told in batches,
each with a sampler of its own seed, so that a search that was killed goes on as if it had not
been. Without `storage` the study is a journal file in the folder, of one search at a time;
across machines it is a database.
"""

from __future__ import annotations

import contextlib
import copy
import fcntl
import json
import os
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping
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
    write_bytes,
)
from ves_gym._util.suggest import did_you_mean
from ves_gym.experiments.executors import Executor, open_executor
from ves_gym.experiments.spec import spec_from_plain, units_of
from ves_gym.experiments.sweep import Report, finished, run_units
from ves_gym.experiments.units import Unit, read_result

SAMPLERS = ("tpe", "random")
DIRECTIONS = ("minimize", "maximize")
JOURNAL = "study.jsonl"
_HEARTBEAT = 30  # s between signs of life in a database; four missed ones are a death
_WHY, _UNITS = "why", "units"  # what a trial remembers beside its parameters

Progress = Callable[[str, float], None]


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
    space: Mapping[str, Axis]  # by the path of an entry: train.0.changes.layers
    direction: str = "minimize"
    sampler: str = "tpe"
    seed: int = 0
    batch: int = 4  # trials asked for at once: the search depends on it, not on the workers

    def __post_init__(self) -> None:
        require_choice(self, "direction", DIRECTIONS)
        require_choice(self, "sampler", SAMPLERS)
        for name in ("trials", "batch"):
            if getattr(self, name) < 1:
                raise ParameterError(f"Search.{name} must be >= 1, got {getattr(self, name)}")
        if not self.space:
            raise ParameterError("Search.space must name an entry to vary, got none")


@dataclass(frozen=True)
class SearchResult:
    """Trials of a search and the best of them."""

    best: dict[str, Any] | None  # number, value, params of the best trial; None: all failed
    trials: list[dict[str, Any]]  # number, state, value, params, units, why


def read_search(path: str | os.PathLike[str]) -> tuple[Search, dict[str, Any]]:
    """A search from a TOML or JSON file, and the plain data of the spec that it varies."""
    table = read_table(path)
    entries = table.pop("search", None)
    if not isinstance(entries, dict):
        raise ParameterError(f"{path}: expected a table [search] beside those of a sweep")
    where = f"{path}: search"
    space = entries.get("space", {})
    if not isinstance(space, dict):
        raise ParameterError(f"{where}.space must be a table, got {space!r}")
    axes = {k: from_plain(Axis, v, f"{where}.space.{k}") for k, v in space.items()}
    search: Search = from_plain(_Plain, {**entries, "space": space}, where).search(axes)
    changed = table
    for name, axis in axes.items():  # every path leads somewhere
        sample = axis.choices[0] if axis.choices else axis.low
        changed = _put(changed, name, int(sample) if axis.integer else sample)  # type: ignore[arg-type]
    spec_from_plain(changed, str(path))
    return search, table


@dataclass(frozen=True, kw_only=True)
class _Plain:
    """`Search` as it is in a file."""

    trials: int
    objective: str
    space: dict
    direction: str = "minimize"
    sampler: str = "tpe"
    seed: int = 0
    batch: int = 4

    def search(self, axes: Mapping[str, Axis]) -> Search:
        return Search(**{**vars(self), "space": axes})


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
    executor: str = "local",
    workers: int | None = None,
    storage: str | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    **options: Any,
) -> SearchResult:
    """Search until the file's number of trials have ended.

    A trial whose units fail, and one whose process died, is entered as failed; the units of
    the latter are done again.

    Args:
        executor, workers, options: where units run, as in `sweep`.
        storage: URL of a database, shared by searches on several machines.
        seed: added to the search's: one of its own for each machine.
    """
    _optuna()
    plan, plain = read_search(path)
    spec = spec_from_plain(plain, str(path))
    root = Path(folder)
    on_progress = progress or (lambda stage, done: None)
    with (
        open_executor(
            executor,
            workers=workers or os.cpu_count() or 1,
            folder=root,
            seconds=spec.seconds,
            deaths=spec.deaths,
            **options,
        ) as pool,
        _study(root, plan, storage) as (study, beat),
    ):
        while (ended := len(_ended(study))) < plan.trials:
            on_progress("search", ended / plan.trials)
            study.sampler = _sampler(plan, seed, ended)
            size = plan.batch - ended % plan.batch
            trials = [_ask(study) for _ in range(min(size, plan.trials - ended))]
            with beat(trials):
                _batch(study, trials, plan, plain, root, Path(path).parent, pool)
        on_progress("search", 1.0)
        return _outcome(study)


def _batch(
    study: Any,
    trials: list[Any],
    plan: Search,
    plain: dict[str, Any],
    root: Path,
    base: Path,
    pool: Executor,
) -> None:
    """Run some trials side by side, then tell how they ended, in order."""
    units: dict[int, list[Unit]] = {}
    wrong: dict[int, str] = {}
    for trial in trials:
        changed = plain
        for name, axis in plan.space.items():
            changed = _put(changed, name, axis.draw(trial, name))
        try:
            units[trial.number] = units_of(spec_from_plain(changed), base)
        except ParameterError as error:  # settings that do not go together
            wrong[trial.number] = str(error)
    every = {unit.id: unit for own_units in units.values() for unit in own_units}
    report = Report(root)
    run_units(pool, [unit for unit in every.values() if not finished(root, unit)], report)
    for trial in trials:
        own_units = units.get(trial.number, [])
        trial.set_user_attr(_UNITS, [unit.id for unit in own_units])
        why = wrong.get(trial.number)
        why = why or next(
            (report.failed[u.id] for u in own_units if u.id in report.failed), None
        )
        value = None if why else _value(root, own_units, plan.objective)
        if value is None:
            why = why or f"its units have no number {plan.objective}"
            trial.set_user_attr(_WHY, why)
            study.tell(trial, state=_optuna().trial.TrialState.FAIL)
        else:
            study.tell(trial, value)


def _value(root: Path, units: list[Unit], objective: str) -> float | None:
    """Mean over the units of an entry of their summaries."""
    values = []
    for unit in units:
        summary = read_result(root / "results" / f"{unit.id}.json")["summary"]
        if objective not in summary:
            raise ParameterError(
                f"objective must be one of {', '.join(summary)}, got {objective!r}"
                f"{did_you_mean(objective, summary)}"
            )
        values.append(summary[objective])
    return None if None in values or not values else sum(values) / len(values)


def _ask(study: Any) -> Any:
    """A trial; that signs of life need `Study.optimize` is not so, see `_alive`."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Heartbeat of storage", UserWarning)
        return study.ask()


def _ended(study: Any) -> list[Any]:
    """Trials with a value, or that failed by themselves."""
    states = _optuna().trial.TrialState
    trials = study.get_trials(deepcopy=False)
    return [t for t in trials if t.state == states.COMPLETE or _WHY in t.user_attrs]


def _sampler(plan: Search, seed: int, ended: int) -> Any:
    """A sampler for the next batch: the seed and what was found decide what it draws."""
    samplers, mixed = _optuna().samplers, (plan.seed + seed) * 1_000_003 + ended
    if plan.sampler == "random":
        return samplers.RandomSampler(seed=mixed % 2**32)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", _optuna().exceptions.ExperimentalWarning)
        return samplers.TPESampler(seed=mixed % 2**32, constant_liar=True)


def _outcome(study: Any) -> SearchResult:
    trials = [
        {
            "number": t.number,
            "state": t.state.name.lower(),
            "value": t.value,
            "params": dict(t.params),
            "units": t.user_attrs.get(_UNITS, []),
            "why": t.user_attrs.get(_WHY),
        }
        for t in study.get_trials(deepcopy=False)
    ]
    complete = [t for t in trials if t["state"] == "complete"]
    sign = 1.0 if study.direction.name == "MINIMIZE" else -1.0
    best = min(complete, key=lambda t: sign * t["value"], default=None)
    return SearchResult(best and {k: best[k] for k in ("number", "value", "params")}, trials)


# ------------------------------------------------------------------------------ storage

Beat = Callable[[list[Any]], contextlib.AbstractContextManager[None]]


@contextlib.contextmanager
def _study(root: Path, plan: Search, storage: str | None) -> Iterator[tuple[Any, Beat]]:
    """The study, and a context that shows a database that trials are alive."""
    optuna = _optuna()
    named = {"study_name": "search", "direction": plan.direction, "load_if_exists": True}
    if storage is None:
        root.mkdir(parents=True, exist_ok=True)
        with _alone(root / ".search.lock"):
            (root / f"{JOURNAL}.lock").unlink(missing_ok=True)  # whoever held it is dead
            journal = open_journal(root / JOURNAL)
            study = optuna.create_study(storage=journal, **named)
            _take_over(study, plan)
            yield study, lambda trials: contextlib.nullcontext()
        return
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        try:
            database = optuna.storages.RDBStorage(
                storage, heartbeat_interval=_HEARTBEAT, grace_period=4 * _HEARTBEAT
            )
        except Exception as error:  # of any database's driver
            why = str(error).splitlines()[0]
            raise ParameterError(f"no database at {storage}: {why}") from None
    study = optuna.create_study(storage=database, **named)
    _fail_dead(study)
    yield study, lambda trials: _alive(database, study, trials)


def _take_over(study: Any, plan: Search) -> None:
    """Fail what is left running by a search that died, and ask for the same again.

    Where it died while it asked, its next batch is drawn again, to the same trials.
    """
    state = _optuna().trial.TrialState
    dead = [t for t in study.get_trials(deepcopy=False) if t.state == state.RUNNING]
    for trial in dead:
        study.tell(trial.number, state=state.FAIL)
    complete = [t for t in dead if t.params.keys() == plan.space.keys()]
    ended = len(_ended(study))
    offset = ended % plan.batch
    if offset + len(complete) == min(plan.batch, offset + plan.trials - ended):
        for trial in complete:
            study.enqueue_trial(trial.params)


def _fail_dead(study: Any) -> None:
    """Fail the trials of searches that gave no sign of life, and ask for the same again."""
    optuna = _optuna()
    state = optuna.trial.TrialState
    running = [t for t in study.get_trials(deepcopy=False) if t.state == state.RUNNING]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        optuna.storages.fail_stale_trials(study)
    current = study.get_trials(deepcopy=False)
    for trial in running:
        if current[trial.number].state == state.FAIL:
            study.enqueue_trial(trial.params)


@contextlib.contextmanager
def _alive(database: Any, study: Any, trials: list[Any]) -> Iterator[None]:
    """Give signs of life for some trials meanwhile, and look for those of the dead."""
    over = threading.Event()

    def beat() -> None:
        while True:
            for trial in trials:
                database.record_heartbeat(trial._trial_id)
            if over.wait(_HEARTBEAT):
                return

    thread = threading.Thread(target=beat, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
    _fail_dead(study)


@contextlib.contextmanager
def _alone(path: Path) -> Iterator[None]:
    """Nobody else searches in the folder; the lock goes with its process."""
    with open(path, "w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ParameterError(
                f"{path.parent}: another search is at work in this folder; several machines"
                " need a database (--storage)"
            ) from None
        yield


def open_journal(path: str | os.PathLike[str]) -> Any:
    """Optuna's storage in a journal file, repaired where a write was cut short.

    A last line without its end would make the next one unreadable and, with it, the study.
    Under the journal's own lock the rest of it is cut off; what is sound is kept beside the
    file, as `.snapshot`.

    Raises:
        ParameterError: a line before the last is no JSON.
    """
    from optuna.storages.journal import JournalFileBackend, JournalFileOpenLock, JournalStorage

    path = Path(path)
    lock = JournalFileOpenLock(str(path))
    lock.acquire()
    try:
        if path.exists():
            _repair(path)
    finally:
        lock.release()
    return JournalStorage(JournalFileBackend(str(path), lock_obj=lock))


def _repair(path: Path) -> None:
    data = path.read_bytes()
    lines = data.splitlines(keepends=True)
    sound = 0
    for k, entry in enumerate(lines):
        try:
            json.loads(entry)
            if not entry.endswith(b"\n"):
                raise ValueError
        except ValueError:
            if k < len(lines) - 1:
                raise ParameterError(
                    f"{path}: line {k + 1} of {len(lines)} is no JSON; what was sound when the"
                    f" search last began is in {path.name}.snapshot"
                ) from None
            break
        sound += len(entry)
    write_bytes(path.with_name(path.name + ".snapshot"), data[:sound])
    if sound < len(data):
        with open(path, "r+b") as file:
            file.truncate(sound)
            file.flush()
            os.fsync(file.fileno())


def _optuna() -> Any:
    require("search", "optuna")
    import optuna

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    return optuna
