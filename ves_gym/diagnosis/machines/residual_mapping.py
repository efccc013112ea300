"""Mapping files of machines by a residual function: which machine, and where its signals are.

A file names a machine that is registered; it holds numbers and names, and no code.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ves_gym._util.params import (
    Array,
    ParameterError,
    from_plain,
    require_positive,
    unit,
)
from ves_gym.diagnosis.data.measured_run import BAND, Run
from ves_gym.diagnosis.machines.mjcf_mapping import (
    Clock,
    Column,
    read_as,
    read_signals,
    sampled_run,
)
from ves_gym.diagnosis.machines.residual import MACHINES, ResidualMachine, samples

SCHEMA = "ves-residual/1"


@dataclass(frozen=True)
class ResidualFile:
    """A machine and where its signals are."""

    schema: str
    machine: str  # as it is registered
    name: str
    signals: dict[str, tuple[Column, ...]]
    description: dict[str, Any] = field(default_factory=dict)  # keys of the machine's own
    time: Clock | None = None  # none: samples without a clock, such as poses at rest
    band: float = unit("Hz", default=BAND)
    noise: dict[str, tuple[float, ...]] = field(default_factory=dict)  # std of each column
    rest: tuple[float, float] | None = unit("s", default=None)  # nothing moves: noise is seen
    parameters: dict[str, Any] = field(default_factory=dict)  # other than the description's
    tolerance: dict[str, float] = field(default_factory=dict)  # parameter -> std
    unexplained: float = 0.0

    def __post_init__(self) -> None:
        if self.machine not in MACHINES:
            filed = ", ".join(sorted(MACHINES)) or "those of a file that is imported (--import)"
            raise ParameterError(f"machine must be one of {filed}, got {self.machine!r}")
        require_positive(self, "band")

    def found(self, folder: Path) -> ResidualMachine:
        """Return the machine; files that it names are found from `folder`."""
        described = from_plain(MACHINES[self.machine], self.description, "description")
        machine: ResidualMachine = described.machine(folder).at(self.parameters)
        return replace(
            machine, name=self.name, tolerance=self.tolerance, unexplained=self.unexplained
        )

    def run(self, columns: dict[str, Array], name: str) -> Run:
        """Return a run from the columns of a file; as `MachineFile.run`."""
        channels = {key: [(c,) for c in listed] for key, listed in self.signals.items()}
        t, signals, notes = read_signals(channels, self.time, columns, name)
        if self.time is None:
            return samples(name, signals, self.noise)
        noise = {**self._at_rest(t, signals, name), **self.noise}
        meta = {"noise_std": noise, "notes": notes}
        return sampled_run(t, signals, name, self.band, meta)

    def _at_rest(self, t: Array, signals: dict[str, Array], name: str) -> dict[str, Any]:
        """Standard deviations of all signals while nothing moves."""
        if self.rest is None:
            return {}
        still = (t >= self.rest[0]) & (t <= self.rest[1])
        if np.count_nonzero(still) < 2:
            raise ParameterError(f"{name}: no samples at rest, between {self.rest} s")
        return {key: x[still].std(axis=0, ddof=1).tolist() for key, x in signals.items()}


def residual_machine_of(
    table: dict[str, Any], path: Path
) -> tuple[ResidualFile, ResidualMachine]:
    """Return the content of a mapping file that is, or would be, at `path`, and its machine."""

    def read() -> tuple[ResidualFile, ResidualMachine]:
        file: ResidualFile = from_plain(ResidualFile, table, str(path))
        return file, file.found(path.parent)

    return read_as(read, path)
