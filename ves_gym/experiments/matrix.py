"""The matrix: methods x machines x tasks x seeds, as units of a sweep.

What needs no training is evaluated first, then come the trainings and the evaluations of what
came of them: three sweeps in one folder. All skip units that have a result. Every method of a
task answers the same episodes on a machine, one that is slow the first of them.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from ves_gym._util.params import Array, ParameterError, from_plain, read_table
from ves_gym._util.statistics import STATISTICS, Estimate, bootstrap, rate
from ves_gym.baselines.comparison import policy_files
from ves_gym.baselines.config import config_from_plain, find_config
from ves_gym.baselines.registry import get_controller
from ves_gym.experiments.spec import changed
from ves_gym.experiments.sweep import Report, do_units
from ves_gym.experiments.units import Unit, evaluate_unit, read_result, train_unit

_APART = 1_000_000  # between the first episodes of two seeds: no episode is shared


@dataclass(frozen=True, kw_only=True)
class MatrixMachine:
    """A machine to try methods on: the ideal system in space, or a laboratory's machine."""

    name: str
    emulated: bool = False
    settings: dict = field(default_factory=dict)  # of the environment


@dataclass(frozen=True, kw_only=True)
class MatrixMethod:
    """A way to act: one of a controller, a released policy, and a configuration to train."""

    name: str
    controller: str | None = None
    released: str | None = None  # name of a policy of the package, such as ppo
    train: str | None = None  # configuration of the package, or a file: a policy per seed
    machine: str | None = None  # that it is trained on; None: the first
    changes: dict = field(default_factory=dict)  # entries of the configuration
    settings: dict = field(default_factory=dict)  # of the environments that it acts in
    episodes: int | None = None  # of each seed in every cell; None: the matrix's

    def __post_init__(self) -> None:
        kinds = [self.controller, self.released, self.train]
        if sum(kind is not None for kind in kinds) != 1:
            raise ParameterError(
                f"method {self.name} needs one of controller, released and train, got {kinds}"
            )
        if self.episodes is not None and self.episodes < 1:
            raise ParameterError(f"method {self.name} needs episodes >= 1, got {self.episodes}")


@dataclass(frozen=True, kw_only=True)
class TaskRow:
    """A task and the methods for it; energies are told over those of the first method."""

    env: str  # name without Emulated and version, such as PumaReach
    methods: tuple[MatrixMethod, ...]


@dataclass(frozen=True, kw_only=True)
class Matrix:
    """Methods, machines and tasks to compare, and on how much."""

    tasks: tuple[TaskRow, ...]
    machines: tuple[MatrixMachine, ...]
    seeds: tuple[int, ...] = (0, 1, 2, 3, 4)
    episodes: int = 20  # of each seed in every cell
    seconds: float | None = None  # that a unit may take

    def __post_init__(self) -> None:
        if not (self.tasks and self.machines and self.seeds) or self.episodes < 1:
            raise ParameterError("a matrix needs tasks, machines, seeds and episodes >= 1")
        names = [machine.name for machine in self.machines]
        for task in self.tasks:
            methods = [method.name for method in task.methods]
            for kind, chosen in (("machine", names), (f"method of {task.env}", methods)):
                if len(set(chosen)) < len(chosen) or not chosen:
                    raise ParameterError(f"each {kind} needs a name of its own, got {chosen}")
            for method in task.methods:
                if method.machine not in (None, *names):
                    raise ParameterError(
                        f"method {method.name} is trained on one of {', '.join(names)}, got"
                        f" {method.machine!r}"
                    )

    def episodes_of(self, method: MatrixMethod) -> int:
        """Return the episodes of each seed of a method: its, but no more than the matrix's."""
        return min(self.episodes, method.episodes or self.episodes)


@dataclass(frozen=True)
class Cell:
    """Place of a unit of evaluation in the matrix."""

    task: str
    machine: str
    method: str
    seed: int
    unit: Unit


def read_matrix(path: str | os.PathLike[str]) -> Matrix:
    """A matrix from a TOML or JSON file, which paths in it start from.

    Raises:
        ParameterError: an unknown key, or a configuration that is not there.
    """
    matrix: Matrix = from_plain(Matrix, read_table(path), str(path))
    base = Path(path).parent

    def found(method: MatrixMethod) -> MatrixMethod:
        return replace(method, train=method.train and str(find_config(method.train, base)))

    return replace(matrix, tasks=_with_methods(matrix, found))


def shortened(matrix: Matrix, steps: int) -> tuple[TaskRow, ...]:
    """Return the tasks of a matrix with so many steps in every training.

    Args:
        matrix: whose tasks.
        steps: at least 1.
    """

    def shorter(method: MatrixMethod) -> MatrixMethod:
        return replace(method, changes={**method.changes, "total_timesteps": steps})

    return _with_methods(matrix, shorter)


def _with_methods(
    matrix: Matrix, change: Callable[[MatrixMethod], MatrixMethod]
) -> tuple[TaskRow, ...]:
    return tuple(
        replace(task, methods=tuple(map(change, task.methods))) for task in matrix.tasks
    )


def environment_of(task: TaskRow, machine: MatrixMachine) -> str:
    """Return the id of a task on a machine."""
    id = f"ves/{task.env}{'Emulated' if machine.emulated else ''}-v0"
    if id not in gym.registry:
        raise ParameterError(f"{id} is no environment of ves_gym")
    return id


# --------------------------------------------------------------------------- units


def trainings(matrix: Matrix) -> dict[tuple[str, str, int], Unit]:
    """Return the training units by task, method and seed."""
    machines = {machine.name: machine for machine in matrix.machines}
    out = {}
    for task in matrix.tasks:
        for method in task.methods:
            if method.train is None:
                continue
            machine = machines[method.machine or matrix.machines[0].name]
            path = find_config(method.train, Path())
            table = changed(read_table(path), {"settings": machine.settings})
            table = changed(table, {**method.changes, "env": environment_of(task, machine)})
            config = config_from_plain(table, str(path))
            for seed in matrix.seeds:
                out[task.env, method.name, seed] = train_unit(config, seed)
    return out


def cells(matrix: Matrix, folder: Path, trained: bool | None = None) -> list[Cell]:
    """Return the units of evaluation, without methods that are not trained with every seed.

    Args:
        matrix: what is compared.
        folder: of the results, where trained policies lie.
        trained: only those of policies that the matrix trains, or only the others; None: all.
    """
    units = trainings(matrix)
    lacking = {
        (task, method)
        for (task, method, _), unit in units.items()
        if not (folder / "results" / f"{unit.id}.json").exists()
    }
    return [
        Cell(
            task.env,
            machine.name,
            method.name,
            seed,
            evaluate_unit(
                environment_of(task, machine),
                _who(task, method, seed, units, folder),
                _APART * seed,
                matrix.episodes_of(method),
                {**machine.settings, **method.settings},
            ),
        )
        for task in matrix.tasks
        for machine in matrix.machines
        for method in task.methods
        if trained in (None, method.train is not None)
        if (task.env, method.name) not in lacking
        for seed in matrix.seeds
    ]


def _who(
    task: TaskRow,
    method: MatrixMethod,
    seed: int,
    trained: Mapping[tuple[str, str, int], Unit],
    folder: Path,
) -> str:
    """A controller's name, or the file of the policy that acts with a seed."""
    if method.controller is not None:
        get_controller(method.controller)
        return method.controller
    if method.released is not None:
        return str(policy_files(method.released, f"ves/{task.env}-v0")[0])
    unit = trained[task.env, method.name, seed]
    return str((folder / "policies" / unit.id / "best.json").resolve())


# ------------------------------------------------------------------------- running


def run_matrix(matrix: Matrix, folder: str | os.PathLike[str], **options: Any) -> Report:
    """Do the units of a matrix that have no result yet, what needs no training first.

    Args:
        matrix: what is compared.
        folder: of the results.
        options: see `do_units`.

    Returns:
        What was done, skipped and failed. Policies are evaluated where the training of every
        seed has a result: the next run tries the others again.
    """
    root, total = Path(folder), Report(Path(folder))

    stages: dict[str, Callable[[], list[Unit]]] = {
        "evaluate controllers": lambda: _units(cells(matrix, root, trained=False)),
        "train": lambda: list(trainings(matrix).values()),
        "evaluate policies": lambda: _units(cells(matrix, root, trained=True)),
    }
    for stage, units in stages.items():
        report = do_units(units(), root, stage=stage, seconds=matrix.seconds, **options)
        total.done.extend(report.done)
        total.skipped.extend(report.skipped)
        total.failed.update(report.failed)
    return total


def _units(chosen: list[Cell]) -> list[Unit]:
    """Units of cells, each once."""
    return list({cell.unit.id: cell.unit for cell in chosen}.values())


# ------------------------------------------------------------------------- figures


@dataclass(frozen=True)
class MatrixEntry:
    """Figures of a method on a machine."""

    task: str
    machine: str
    method: str
    success: Estimate
    ret: Estimate  # interquartile mean of the returns
    energy: Estimate | None  # interquartile mean of E_mean over the first method's
    failed: int
    episodes: int  # of each seed


def entries(matrix: Matrix, folder: str | os.PathLike[str]) -> list[MatrixEntry]:
    """Return the figures of the cells that have all their results, in the matrix's order.

    Intervals are stratified bootstraps: seeds are strata, of each as many episodes are drawn
    as it has. Energies that have nothing to be compared with are left out.

    Args:
        matrix: what was compared.
        folder: of its results.
    """
    root = Path(folder)
    rows: dict[tuple[str, str, str], list[list[dict[str, Any]]]] = {}
    for cell in cells(matrix, root):
        path = root / "results" / f"{cell.unit.id}.json"
        if path.exists():
            key = cell.task, cell.machine, cell.method
            rows.setdefault(key, []).append(read_result(path)["rows"])
    rows = {key: seeds for key, seeds in rows.items() if len(seeds) == len(matrix.seeds)}
    first = {task.env: task.methods[0].name for task in matrix.tasks}
    return [
        _entry(key, seeds, rows.get((key[0], key[1], first[key[0]]), []))
        for key, seeds in rows.items()
    ]


def _entry(
    key: tuple[str, str, str],
    seeds: list[list[dict[str, Any]]],
    reference: list[list[dict[str, Any]]],
) -> MatrixEntry:
    strata = [_column(rows, "return") for rows in seeds]
    success = np.concatenate([_column(rows, "success") for rows in seeds])
    ratios = [
        _column(rows, "E_mean") / _column(over[: len(rows)], "E_mean")
        for rows, over in zip(seeds, reference, strict=False)
        if np.all(_column(over, "E_mean") > 0)
    ]
    usable = len(ratios) == len(seeds) and not any(np.isnan(r).any() for r in ratios)
    return MatrixEntry(
        *key,
        success=rate(success > 0),
        ret=bootstrap(strata, STATISTICS["iqm"]),
        energy=bootstrap(ratios, STATISTICS["iqm"]) if usable else None,
        failed=int(sum(_column(rows, "failed").sum() for rows in seeds)),
        episodes=len(seeds[0]),
    )


def _column(rows: list[dict[str, Any]], name: str) -> Array:
    """Values of a measure, episode by episode; what is missing is infinite."""
    return np.array([np.inf if row[name] is None else row[name] for row in rows], float)
