"""From a mapping file to a machine in MJCF and its runs; docs/diagnosis.md has an example."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from ves_gym._util.params import (
    Array,
    ParameterError,
    from_plain,
    read_table,
    require_positive,
    unit,
)
from ves_gym._util.recordings import column_of, read_columns
from ves_gym.diagnosis.data.measured_run import BAND, Run, require_steady, run_of_signals
from ves_gym.diagnosis.machines.mjcf import MjcfJoint, MjcfMachine, RateError, Tolerance
from ves_gym.system.effect import Effect

SCHEMA = "ves-machine/1"
Loader = Callable[[str | os.PathLike[str]], Run]


@dataclass(frozen=True)
class Column:
    """gain x column + offset, in m, rad, their rates, N, N m or s."""

    column: str
    gain: float = 1.0
    offset: float = 0.0

    def of(self, columns: dict[str, Array], where: str) -> Array:
        """Return the quantity (T,).

        Args:
            columns: of the file, by name.
            where: the file, in messages.

        Raises:
            ParameterError: the column is not there, or not finite.
        """
        return self.gain * column_of(columns, self.column, where) + self.offset


@dataclass(frozen=True)
class JointColumns:
    """Columns in which a joint was measured."""

    name: str
    position: Column
    velocity: Column | None = None
    force: tuple[Column, ...] = ()  # of the motor and known from outside, they add up
    type: str = "hinge"
    radius: float = unit("m", default=1.0)

    @property
    def joint(self) -> MjcfJoint:
        """The joint."""
        return MjcfJoint(self.name, self.type, self.radius)


@dataclass(frozen=True)
class NoiseLevel:
    """Standard deviations of what was measured, where the data themselves hide them."""

    position: float | None = None
    velocity: float | None = None
    force: float | None = None

    def __post_init__(self) -> None:
        stated = [f.name for f in fields(self) if getattr(self, f.name) is not None]
        require_positive(self, *stated)

    @property
    def by_signal(self) -> dict[str, float]:
        """As the metadata of a run has them."""
        every = {"q": self.position, "v": self.velocity, "tau": self.force}
        return {key: std for key, std in every.items() if std is not None}


@dataclass(frozen=True)
class MachineFile:
    """A machine and where its signals are."""

    schema: str
    name: str
    time: Column
    joint: tuple[JointColumns, ...]
    model: str | None = None  # MJCF, beside the mapping file
    band: float = unit("Hz", default=BAND)
    noise: NoiseLevel = field(default_factory=NoiseLevel)
    tolerance: Tolerance = field(default_factory=Tolerance)
    effect: tuple[Effect, ...] = ()  # of the machine, beside the model; a slide on its pinion
    rate: tuple[RateError, ...] = ()  # of the log

    def __post_init__(self) -> None:
        if self.schema != SCHEMA:
            raise ParameterError(f"schema must be {SCHEMA!r}, got {self.schema!r}")
        require_positive(self, "band")
        for what in ("velocity", "force"):
            have = [bool(getattr(j, what)) for j in self.joint]
            if any(have) and not all(have):
                lacks = self.joint[have.index(False)].name
                raise ParameterError(f"joint {lacks} has no {what}, others have")

    def machine(self, model: mujoco.MjModel | None) -> MjcfMachine:
        """The machine."""
        joints = [j.joint for j in self.joint]
        return MjcfMachine(self.name, joints, model, self.tolerance, self.effect, self.rate)

    def run(self, columns: dict[str, Array], name: str) -> Run:
        """A run from the columns of a file.

        Raises:
            ParameterError: columns missing, not finite or of different lengths, a clock that
                runs backwards or has gaps, or too slow or short for the band.
        """
        t = self.time.of(columns, name)
        parts = {"q": [j.position.of(columns, name) for j in self.joint]}
        if self.joint[0].velocity is not None:
            parts["v"] = [j.velocity.of(columns, name) for j in self.joint if j.velocity]
        if self.joint[0].force:
            parts["tau"] = [sum_of(j.force, columns, name) for j in self.joint]
        for key, series in parts.items():
            for joint, x in zip(self.joint, series, strict=True):
                if x.shape != t.shape:
                    raise ParameterError(
                        f"{name}: {key} of {joint.name} has {len(x)} rows, the clock {len(t)}"
                    )
        require_steady(t, name)
        signals = {key: np.stack(series, axis=1) for key, series in parts.items()}
        return run_of_signals(t, signals, name, self.band, {"noise_std": self.noise.by_signal})


def sum_of(parts: tuple[Column, ...], columns: dict[str, Array], where: str) -> Array:
    """Return the sum (T,) of several columns.

    Args:
        parts: to add up.
        columns: of the file, by name.
        where: the file, in messages.
    """
    return np.asarray(
        sum(p.of(columns, where) for p in parts[1:]) + parts[0].of(columns, where)
    )


def read_machine(
    path: str | os.PathLike[str], band: float | None = None
) -> tuple[MjcfMachine, Loader]:
    """Return machine and loader of its data files from a mapping file (.toml, .json).

    Args:
        path: of the mapping file.
        band: Hz, in place of the file's.

    Raises:
        ParameterError: naming file and key.
    """
    path = Path(path)
    table = read_table(path) if band is None else {**read_table(path), "band": band}
    file, machine = machine_of(table, path)

    def load(data: str | os.PathLike[str]) -> Run:
        return file.run(read_columns(data), Path(data).name)

    return machine, load


def machine_of(table: dict[str, Any], path: Path) -> tuple[MachineFile, MjcfMachine]:
    """Return the content of a mapping file that is, or would be, at `path`, and its machine.

    Args:
        table: content as plain data.
        path: models are found from its folder.

    Raises:
        ParameterError: naming file and key.
    """
    try:
        file: MachineFile = from_plain(MachineFile, table, str(path))
        model = None if file.model is None else read_model(path.parent / file.model)
        return file, file.machine(model)
    except ParameterError as error:
        text = str(error)
        raise ParameterError(
            text if text.startswith(str(path)) else f"{path}: {text}"
        ) from None


def read_model(path: Path) -> mujoco.MjModel:
    """Return a compiled MJCF file.

    Raises:
        ParameterError: naming the file.
    """
    try:
        return mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise ParameterError(f"model {path}: {error}") from None
