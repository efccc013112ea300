"""From a mapping file to a machine of joints (MJCF, URDF) and its runs; docs/diagnosis.md has
examples.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, TypeVar

import mujoco
import numpy as np

from ves_gym._util.mujoco_loader import read_model
from ves_gym._util.params import (
    Array,
    ParameterError,
    from_plain,
    require_positive,
    unit,
)
from ves_gym._util.reading import named
from ves_gym._util.recordings import column_of
from ves_gym._util.signals import downsampled, on_uniform_clock
from ves_gym.diagnosis.data.measured_run import (
    BAND,
    SHORTEST,
    Run,
    require_steady,
    run_of_signals,
)
from ves_gym.diagnosis.machines.joint_changes import CarriedBody, RateError, Shaft
from ves_gym.diagnosis.machines.joint_library import MjcfJoint
from ves_gym.diagnosis.machines.mjcf import MjcfMachine
from ves_gym.diagnosis.machines.rigid_bodies import RigidBodies, UrdfBodies
from ves_gym.diagnosis.machines.tolerances import Tolerance
from ves_gym.system.effect import Effect

SCHEMA = "ves-machine/1"
T = TypeVar("T")
Loader = Callable[[str | os.PathLike[str]], Run]
_MOST_PER_BAND = 100.0  # samples per period of the band's top: more say nothing more
_PARTS = ("position", "velocity", "force")


@dataclass(frozen=True)
class Column:
    """gain x column + offset, in m, rad, their rates, N, N m or s."""

    column: str
    gain: float = 1.0
    offset: float = 0.0

    def of(self, columns: dict[str, Array], where: str) -> Array:
        """Return the quantity (T,), NaN where a sample is missing."""
        return self.gain * column_of(columns, self.column, where, missing=True) + self.offset


@dataclass(frozen=True)
class Clock:
    """Time of the samples: a column, or a step where the file has none; what part is used."""

    column: str | None = None
    gain: float = 1.0
    offset: float = 0.0
    step: float | None = unit("s", default=None)
    start: float | None = unit("s", default=None)  # rows from here
    stop: float | None = unit("s", default=None)  # to here are used

    def __post_init__(self) -> None:
        if (self.column is None) == (self.step is None):
            raise ParameterError("time needs a column or a step, one of them")
        if self.step is not None:
            require_positive(self, "step")

    def of(self, columns: dict[str, Array], rows: int, where: str) -> tuple[Array, slice]:
        """Return stamps (T,) of all rows and those that are used, of a file called `where`."""
        if self.column is None:
            t = float(self.step or 0.0) * np.arange(rows) + self.offset
        else:
            t = self.gain * column_of(columns, self.column, where) + self.offset
        used = slice(
            0 if self.start is None else int(np.searchsorted(t, self.start - 1e-9)),
            len(t) if self.stop is None else int(np.searchsorted(t, self.stop + 1e-9)),
        )
        if used.stop - used.start < 2:
            raise ParameterError(
                f"{where}: no rows between start and stop; the clock runs from {t[0]:g} s to"
                f" {t[-1]:g} s"
            )
        return np.asarray(t, float), used


@dataclass(frozen=True)
class JointColumns:
    """Columns in which a joint was measured; several parts add up."""

    name: str
    position: tuple[Column, ...]
    velocity: tuple[Column, ...] = ()
    force: tuple[Column, ...] = ()  # of motors and known from outside
    type: str = "hinge"
    radius: float = unit("m", default=1.0)
    rotor: float = unit("kg m^2", default=0.0)
    gain_unknown: bool = False

    @property
    def joint(self) -> MjcfJoint:
        """The joint."""
        return MjcfJoint(self.name, self.type, self.radius, self.rotor, self.gain_unknown)


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
    time: Clock
    joint: tuple[JointColumns, ...]
    model: str | None = None  # MJCF (.xml) or URDF (.urdf), found from the mapping file
    locked: tuple[str, ...] = ()  # joints of a URDF that stand still at zero
    band: float = unit("Hz", default=BAND)
    noise: NoiseLevel = field(default_factory=NoiseLevel)
    tolerance: Tolerance = field(default_factory=Tolerance)
    effect: tuple[Effect, ...] = ()  # of the machine, beside the model; a slide on its pinion
    rate: tuple[RateError, ...] = ()  # of the log
    payload: tuple[CarriedBody, ...] = ()  # on the last link, beside the model
    shaft: tuple[Shaft, ...] = ()  # that several joints turn
    known: dict[str, float] = field(default_factory=dict)  # tolerance -> standard deviation

    def __post_init__(self) -> None:
        if self.schema != SCHEMA:
            raise ParameterError(f"schema must be {SCHEMA!r}, got {self.schema!r}")
        require_positive(self, "band")
        for what in ("velocity", "force"):
            have = [bool(getattr(j, what)) for j in self.joint]
            if any(have) and not all(have):
                lacks = self.joint[have.index(False)].name
                raise ParameterError(f"joint {lacks} has no {what}, others have")

    def machine(self, model: mujoco.MjModel | RigidBodies | None) -> MjcfMachine:
        """The machine, if something of it can be compared."""
        rates, forces = (any(getattr(j, k) for j in self.joint) for k in ("velocity", "force"))
        if not rates and (model is None or not forces):
            raise ParameterError(
                f"{self.name}: nothing to compare: say columns of velocity, or of force and a"
                " model (model = robot.urdf)"
            )
        return MjcfMachine(
            self.name,
            [j.joint for j in self.joint],
            model,
            self.tolerance,
            (*self.effect, *self.rate, *self.payload, *self.shaft),
            couplings=self.couplings,
            known=self.known,
        )

    @property
    def couplings(self) -> tuple[tuple[float, ...], ...]:
        """Shafts behind columns of force that act on several joints: by virtual work such a
        shaft turns with the same gains."""
        gains: dict[str, dict[int, float]] = {}
        for i, joint in enumerate(self.joint):
            for part in joint.force:
                row = gains.setdefault(part.column, {})
                row[i] = row.get(i, 0.0) + part.gain
        out = []
        for row in gains.values():
            if len(row) > 1:
                most = max(row.values(), key=abs)
                out.append(tuple(row.get(i, 0.0) / most for i in range(len(self.joint))))
        return tuple(out)

    def run(self, columns: dict[str, Array], name: str) -> Run:
        """Return a run from the columns of a file.

        Raises:
            ParameterError: as `read_signals`; too slow or short for the band.
        """
        has = {"q": "position", "v": "velocity", "tau": "force"}
        channels = {
            key: [getattr(joint, what) for joint in self.joint]
            for key, what in has.items()
            if getattr(self.joint[0], what)
        }
        t, signals, notes = read_signals(channels, self.time, columns, name)
        meta = {"noise_std": self.noise.by_signal, "notes": notes, "columns": _named(channels)}
        return sampled_run(t, signals, name, self.band, meta)


def _named(channels: Mapping[str, Sequence[Sequence[Column]]]) -> dict[str, str]:
    """Return the file's columns of every signal and of its channels, "q_1" the first."""
    out: dict[str, str] = {}
    for key, listed in channels.items():
        names = [" + ".join(c.column for c in parts) for parts in listed]
        out |= {key: ", ".join(names), **{f"{key}_{i}": k for i, k in enumerate(names, 1)}}
    return out


def read_signals(
    channels: Mapping[str, Sequence[Sequence[Column]]],
    clock: Clock | None,
    columns: dict[str, Array],
    name: str,
) -> tuple[Array, dict[str, Array], list[str]]:
    """Return stamps (T,), signals (T, c) and notes; rows that lack a number are left out.

    Args:
        channels: columns that add up to each channel of a signal.
        clock: None: samples without one, whose stamps are their numbers.
        columns: of the file, by name.
        name: of the file, in messages.

    Raises:
        ParameterError: columns missing, infinite or of different lengths, a clock that runs
            backwards or has gaps.
    """
    signals: dict[str, Array] = {}
    rows = [len(x) for x in columns.values()]
    for key, listed in channels.items():
        parts = [[c.of(columns, name) for c in channel] for channel in listed]
        rows = [len(x) for channel in parts for x in channel]
        if len(set(rows)) > 1:
            raise ParameterError(f"{name}: columns of {key} have {sorted(set(rows))} rows")
        signals[key] = np.stack([np.sum(channel, axis=0) for channel in parts], axis=1)
    t, used = np.arange(rows[0], dtype=float), slice(None)
    if clock is not None:
        t, used = clock.of(columns, rows[0], name)
    for key, x in signals.items():
        if len(x) != len(t):
            raise ParameterError(f"{name}: {key} has {len(x)} rows, the clock {len(t)}")
    whole = np.all([np.isfinite(x[used]).all(axis=1) for x in signals.values()], axis=0)
    lacking = int(np.sum(~whole))
    text = f"{name}: {lacking} of {len(whole)} rows lack a number and are left out"
    t = t[used][whole]
    if len(t) < 2:
        raise ParameterError(f"{name}: no row has a number in every column that is used")
    require_steady(t, name)
    return t, {k: x[used][whole] for k, x in signals.items()}, [text] * bool(lacking)


def sampled_run(
    t: Array, signals: dict[str, Array], name: str, band: float, meta: dict[str, Any]
) -> Run:
    """Return a run, down-sampled first to at most `_MOST_PER_BAND` times the band."""
    seconds = float(t[-1] - t[0])
    rate = (len(t) - 1) / seconds
    factor = int(rate // (_MOST_PER_BAND * band))
    if factor > 1 and seconds > SHORTEST / band:  # else refused, as it was sampled
        widths = np.cumsum([x.shape[1] for x in signals.values()])[:-1]
        dt, even = on_uniform_clock(t, np.concatenate(list(signals.values()), axis=1))
        slow = downsampled(even, factor)
        t = t[0] + factor * dt * np.arange(len(slow))
        signals = dict(zip(signals, np.split(slow, widths, axis=1), strict=True))
        text = (
            f"{name}: down-sampled from {rate:.4g} Hz to {rate / factor:.4g} Hz, everything"
            f" above {0.4 * rate / factor:.3g} Hz filtered out before"
        )
        meta = {**meta, "notes": [*meta.get("notes", ()), text]}
    return run_of_signals(t, signals, name, band, meta)


def read_as(read: Callable[[], T], path: Path) -> T:
    """Return what is read, with the file's name in front of what is wrong with it."""
    try:
        return read()
    except ParameterError as error:
        text = str(error)
        raise ParameterError(
            text if text.startswith(str(path)) else f"{path}: {text}"
        ) from None


def machine_of(table: dict[str, Any], path: Path) -> tuple[MachineFile, MjcfMachine]:
    """Return the content of a mapping file that is, or would be, at `path`, and its machine."""

    def read() -> tuple[MachineFile, MjcfMachine]:
        file: MachineFile = from_plain(MachineFile, _listed(table), str(path))
        return file, file.machine(_model_of(file, path.parent))

    return read_as(read, path)


def _listed(table: dict[str, Any]) -> dict[str, Any]:
    """Return a mapping in which quantities of one column are lists of one."""
    joints = table.get("joint")
    if not isinstance(joints, list):
        return table

    def listed(joint: Any) -> Any:
        if not isinstance(joint, dict):
            return joint
        this_joint = {k: [joint[k]] for k in _PARTS if isinstance(joint.get(k), dict)}
        return {**joint, **this_joint}

    return {**table, "joint": [listed(joint) for joint in joints]}


def _model_of(file: MachineFile, folder: Path) -> mujoco.MjModel | RigidBodies | None:
    if file.model is None:
        return None
    path = folder / file.model
    if path.suffix == ".urdf":
        return UrdfBodies(path, [(j.name, j.type) for j in file.joint], file.locked)
    if file.locked:
        raise ParameterError("locked joints are of a URDF; leave them out of an MJCF file")
    with named(f"model {path}"):
        return read_model(path)
