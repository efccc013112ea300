"""Mapping files of small machines: static poses, an arm over a force plate, a linear plant."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ves_gym._util.params import Array, ParameterError, from_plain, require_positive, unit
from ves_gym.diagnosis.data.measured_run import BAND, Run, require_steady
from ves_gym.diagnosis.machines.force_plate import ForcePlateArm, PlateTolerance
from ves_gym.diagnosis.machines.linear_plant import (
    LinearMachine,
    PlantTolerance,
    StateSpace,
    structure,
)
from ves_gym.diagnosis.machines.mjcf_mapping import Clock, Column, sampled_run
from ves_gym.diagnosis.machines.plant import PlantEffect, PlantMachine
from ves_gym.diagnosis.machines.static_poses import StaticTolerance, StaticTool, static_run

Rows = tuple[tuple[float, ...], ...]
_AXES6 = 6


@dataclass(frozen=True)
class OutputColumn:
    """A column in which an output was measured."""

    name: str
    column: str
    gain: float = 1.0
    offset: float = 0.0
    unit: str = "1"


@dataclass(frozen=True)
class StructureMatrices:
    """M x'' + D x' + K x = force u; the output reads `output` times x or its derivative."""

    M: Rows
    D: Rows
    K: Rows
    force: Rows  # (n, inputs)
    output: Rows  # (outputs, n)
    reads: str = "displacement"


@dataclass(frozen=True)
class SystemMatrices:
    """x' = A x + B u, y = C x + D u."""

    A: Rows
    B: Rows
    C: Rows
    D: Rows


@dataclass(frozen=True)
class PlantFile:
    """A linear plant and where its signals are."""

    schema: str
    name: str
    time: Clock
    input: tuple[Column, ...]
    output: tuple[OutputColumn, ...]
    structure: StructureMatrices | None = None
    matrices: SystemMatrices | None = None
    input_exact: bool = True
    held: bool = False
    band: float = unit("Hz", default=BAND)
    noise: float | None = None  # standard deviation of the outputs
    tolerance: PlantTolerance = field(default_factory=PlantTolerance)
    effect: tuple[PlantEffect, ...] = ()
    known: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        require_positive(self, "band")
        if (self.structure is None) == (self.matrices is None):
            raise ParameterError("give [structure] (M, D, K) or [matrices] (A, B, C, D)")

    def machine(self, folder: Path) -> LinearMachine:
        """The machine."""
        if self.structure is not None:
            s = self.structure
            M, D, K, force, output = (_matrix(x) for x in (s.M, s.D, s.K, s.force, s.output))
            plant = structure(M, D, K, force, output, s.reads)
        else:
            assert self.matrices is not None
            m = self.matrices
            plant = StateSpace(_matrix(m.A), _matrix(m.B), _matrix(m.C), _matrix(m.D))
        if plant.B.shape[1] != len(self.input):
            raise ParameterError(
                f"{plant.B.shape[1]} inputs are described, {len(self.input)} have columns"
            )
        return LinearMachine(
            self.name,
            plant,
            [(o.name, o.unit) for o in self.output],
            self.tolerance,
            self.effect,
            input_exact=self.input_exact,
            held=self.held,
            known=self.known,
        )

    def run(self, columns: dict[str, Array], name: str) -> Run:
        """Return a run from the columns of a file."""
        parts = [Column(o.column, o.gain, o.offset) for o in self.output]
        signals = {"input": self.input, "output": tuple(parts)}
        meta = {} if self.noise is None else {"noise_std": {"output": self.noise}}
        return _sampled(self.time, columns, signals, name, self.band, meta)


@dataclass(frozen=True)
class ToolDescription:
    """The tool as described, sensor axes."""

    mass: float = unit("kg", default=0.0)
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)  # m


@dataclass(frozen=True)
class Orientation:
    """Columns of the sensor's orientation, sensor axes -> world axes with z up."""

    quaternion: tuple[str, ...] = ()  # w, x, y, z
    rpy: tuple[str, ...] = ()  # roll, pitch, yaw about the world's x, y, z [rad]

    def __post_init__(self) -> None:
        if sorted((len(self.quaternion), len(self.rpy))) not in ([0, 3], [0, 4]):
            raise ParameterError("orientation needs quaternion (w, x, y, z) or rpy columns")

    def of(self, columns: dict[str, Array], where: str) -> Rotation:
        """Return (T,) orientations."""
        names = self.quaternion or self.rpy
        values = np.stack([Column(k).of(columns, where) for k in names], axis=1)
        if self.rpy:
            return Rotation.from_euler("xyz", values)
        return Rotation.from_quat(values[:, [1, 2, 3, 0]])


@dataclass(frozen=True)
class StaticNoise:
    """Standard deviations of the readings, one pose each."""

    force: float = unit("N")
    torque: float = unit("N m")
    orientation: float = unit("rad", default=0.0)

    def __post_init__(self) -> None:
        require_positive(self, "force", "torque")


@dataclass(frozen=True)
class StaticFile:
    """A tool on a force-torque sensor, poses at rest: a row each."""

    schema: str
    name: str
    orientation: Orientation
    wrench: tuple[Column, ...]
    noise: StaticNoise
    tool: ToolDescription = field(default_factory=ToolDescription)
    tolerance: StaticTolerance = field(default_factory=StaticTolerance)
    effect: tuple[PlantEffect, ...] = ()
    known: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        _require_six(wrench=self.wrench)

    def machine(self, folder: Path) -> StaticTool:
        """The machine."""
        tool = self.tool
        return StaticTool(
            self.name, tool.mass, tool.centre, self.tolerance, self.effect, self.known
        )

    def run(self, columns: dict[str, Array], name: str) -> Run:
        """Return poses from the columns of a file."""
        wrench = np.stack([c.of(columns, name) for c in self.wrench], axis=1)
        noise = np.repeat([self.noise.force, self.noise.torque], 3)
        turned = self.orientation.of(columns, name)
        return static_run(name, turned, wrench, noise, self.noise.orientation)


@dataclass(frozen=True)
class PlateJoint:
    """A joint's column."""

    name: str
    position: Column


@dataclass(frozen=True)
class PlateNoise:
    """Standard deviations of what was measured, where the data hide them."""

    position: float | None = unit("rad", default=None)
    force: float | None = unit("N", default=None)
    torque: float | None = unit("N m", default=None)


@dataclass(frozen=True)
class PlateFile:
    """An arm on a base that gives way over a force plate."""

    schema: str
    name: str
    model: str  # URDF; its root link is the base
    time: Clock
    joint: tuple[PlateJoint, ...]
    base: tuple[Column, ...]  # x, y, z [m] and rotation vector [rad] from the unloaded place
    plate: tuple[Column, ...]  # N, N m about that place: on the base, world axes
    stiffness: tuple[float, ...] = ()  # (6,) N/m, N m/rad; none: no port `mount`
    damping: tuple[float, ...] = ()
    band: float = unit("Hz", default=BAND)
    noise: PlateNoise = field(default_factory=PlateNoise)
    tolerance: PlateTolerance = field(default_factory=PlateTolerance)
    effect: tuple[PlantEffect, ...] = ()
    known: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        require_positive(self, "band")
        _require_six(base=self.base, plate=self.plate)
        for name in ("stiffness", "damping"):
            if len(getattr(self, name)) not in (0, _AXES6):
                raise ParameterError(f"{name} must have 6 numbers, got {getattr(self, name)}")

    def machine(self, folder: Path) -> ForcePlateArm:
        """The machine."""
        K, D = (np.diag(x) if x else None for x in (self.stiffness, self.damping))
        names = [j.name for j in self.joint]
        return ForcePlateArm(
            self.name, folder / self.model, names, K, D, self.tolerance, self.effect, self.known
        )

    def run(self, columns: dict[str, Array], name: str) -> Run:
        """Return a run from the columns of a file."""
        signals = {
            "q": tuple(j.position for j in self.joint),
            "y": self.base,
            "plate": self.plate,
        }
        stated: dict[str, Any] = {}
        if self.noise.position is not None:
            stated["q"] = self.noise.position
        if self.noise.force is not None and self.noise.torque is not None:
            stated["plate"] = [self.noise.force] * 3 + [self.noise.torque] * 3
        return _sampled(self.time, columns, signals, name, self.band, {"noise_std": stated})


PlantMapping = PlantFile | StaticFile | PlateFile
SCHEMAS: dict[str, type[PlantFile] | type[StaticFile] | type[PlateFile]] = {
    "ves-plant/1": PlantFile,
    "ves-static/1": StaticFile,
    "ves-plate/1": PlateFile,
}


def plant_of(table: dict[str, Any], path: Path) -> tuple[PlantMapping, PlantMachine]:
    """Return the content of a mapping file of a small machine, and the machine.

    Args:
        table: content as plain data.
        path: where the file is, or would be.

    Raises:
        ParameterError: naming file and key.
    """
    cls = SCHEMAS[table["schema"]]
    try:
        file: PlantMapping = from_plain(cls, table, str(path))
        return file, file.machine(path.parent)
    except ParameterError as error:
        text = str(error)
        raise ParameterError(
            text if text.startswith(str(path)) else f"{path}: {text}"
        ) from None


def _matrix(rows: Rows) -> Array:
    """Return (n, m) of rows.

    Raises:
        ParameterError: rows of different lengths.
    """
    if not rows or len({len(row) for row in rows}) > 1:
        raise ParameterError(f"a matrix needs rows of one length, got {rows}")
    return np.array(rows, float)


def _require_six(**parts: tuple[Column, ...]) -> None:
    for name, columns in parts.items():
        if len(columns) != _AXES6:
            raise ParameterError(f"{name} must have 6 columns, got {len(columns)}")


def _sampled(
    time: Clock,
    columns: dict[str, Array],
    signals: dict[str, tuple[Column, ...]],
    name: str,
    band: float,
    meta: dict[str, Any],
) -> Run:
    parts = {key: [c.of(columns, name) for c in cols] for key, cols in signals.items()}
    lengths = {len(x) for series in parts.values() for x in series}
    t, used = time.of(columns, max(lengths), name)
    if lengths != {len(t)}:
        raise ParameterError(f"{name}: columns have {sorted(lengths)} rows, the clock {len(t)}")
    require_steady(t[used], name)
    stacked = {key: np.stack(series, axis=1)[used] for key, series in parts.items()}
    return sampled_run(t[used], stacked, name, band, meta)
