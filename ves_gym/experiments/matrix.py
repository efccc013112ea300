"""The matrix: methods x machines x tasks x seeds, as units of a sweep.

Every method of a task answers the same episodes on a machine, one that is slow the first of
them.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from ves_gym._util.params import Array, ParameterError, from_plain, read_table
from ves_gym._util.statistics import STATISTICS, Estimate, bootstrap, rate
from ves_gym.experiments.spec import policies_of
from ves_gym.experiments.sweep import Report, do_units
from ves_gym.experiments.units import Unit, evaluate_unit, read_result

_APART = 1_000_000  # between the first episodes of two seeds: no episode is shared


@dataclass(frozen=True, kw_only=True)
class MatrixMachine:
    """A machine to try methods on: the ideal system in space, or a laboratory's machine."""

    name: str
    emulated: bool = False
    settings: dict[str, Any] = field(default_factory=dict)  # of the environment


@dataclass(frozen=True, kw_only=True)
class MatrixMethod:
    """A way to act: a controller, a released policy, a policy's file or a folder of `train`."""

    name: str
    policy: str  # a folder has a policy per seed
    settings: dict[str, Any] = field(
        default_factory=dict
    )  # of the environments that it acts in
    episodes: int | None = None  # of each seed in every cell; None: the matrix's


@dataclass(frozen=True, kw_only=True)
class TaskRow:
    """A task and the methods for it; energies are relative to those of the first method."""

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
        fewer = [m.episodes for t in self.tasks for m in t.methods if m.episodes is not None]
        if (
            not (self.tasks and self.machines and self.seeds)
            or min(self.episodes, *fewer, 1) < 1
        ):
            raise ParameterError("a matrix needs tasks, machines, seeds and episodes >= 1")
        kinds = {"machine": [machine.name for machine in self.machines]}
        kinds |= {
            f"method of {t.env}": [method.name for method in t.methods] for t in self.tasks
        }
        for kind, names in kinds.items():
            if len(set(names)) < len(names) or not names:
                raise ParameterError(f"each {kind} needs a name of its own, got {names}")

    def episodes_of(self, method: MatrixMethod) -> int:
        """Return the episodes of each seed of a method: its, but no more than the matrix's."""
        return min(self.episodes, method.episodes or self.episodes)


@dataclass(frozen=True)
class Cell:
    """Place in the matrix, and its unit of every seed."""

    task: str
    machine: str
    method: str
    units: tuple[Unit, ...]


def read_matrix(path: str | os.PathLike[str]) -> Matrix:
    """A matrix from a TOML or JSON file; unknown keys are an error."""
    matrix: Matrix = from_plain(Matrix, read_table(path), str(path))
    return matrix


def cells(matrix: Matrix, base: Path = Path()) -> list[Cell]:
    """Return the cells, in the matrix's order.

    Args:
        matrix: what is compared.
        base: folder that paths of policies start from.
    """
    return [
        Cell(
            task.env,
            machine.name,
            method.name,
            tuple(_units(matrix, machine, method, id, base)),
        )
        for task in matrix.tasks
        for machine in matrix.machines
        for method in task.methods
        for id in [_environment(task, machine)]
    ]


def _units(
    matrix: Matrix, machine: MatrixMachine, method: MatrixMethod, id: str, base: Path
) -> Iterable[Unit]:
    who = policies_of(method.policy, id, base)  # which the seeds take in turn
    settings, episodes = {**machine.settings, **method.settings}, matrix.episodes_of(method)
    for k, seed in enumerate(matrix.seeds):
        yield evaluate_unit(id, who[k % len(who)], _APART * seed, episodes, settings)


def _environment(task: TaskRow, machine: MatrixMachine) -> str:
    id = f"ves/{task.env}{'Emulated' if machine.emulated else ''}-v0"
    if id not in gym.registry:
        raise ParameterError(f"{id} is no environment of ves_gym")
    return id


def run_matrix(matrix: Matrix, chosen: list[Cell], folder: Path, **options: Any) -> Report:
    """Do the units of some cells that have no result yet, see `do_units`."""
    units = {unit.id: unit for cell in chosen for unit in cell.units}
    return do_units(units.values(), folder, stage="matrix", seconds=matrix.seconds, **options)


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


def entries(chosen: list[Cell], folder: Path) -> list[MatrixEntry]:
    """Return the figures of cells that are done.

    Intervals are stratified bootstraps: seeds are strata, of each as many episodes are drawn
    as it has. Energies that have nothing to be compared with are left out.
    """
    out: list[MatrixEntry] = []
    reference: dict[tuple[str, str], list[list[dict[str, Any]]]] = {}
    for cell in chosen:
        paths = [folder / "results" / f"{unit.id}.json" for unit in cell.units]
        seeds = [read_result(path)["rows"] for path in paths]
        first = reference.setdefault((cell.task, cell.machine), seeds)
        out.append(_entry((cell.task, cell.machine, cell.method), seeds, first))
    return out


def _entry(
    key: tuple[str, str, str],
    seeds: list[list[dict[str, Any]]],
    reference: list[list[dict[str, Any]]],
) -> MatrixEntry:
    strata = [_column(rows, "return") for rows in seeds]
    success = np.concatenate([_column(rows, "success") for rows in seeds])
    ratios = [
        _column(rows, "E_mean") / _column(over[: len(rows)], "E_mean")
        for rows, over in zip(seeds, reference, strict=True)
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
