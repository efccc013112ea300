"""A better description on disk: read back, compared, and played again."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ves_gym._util.params import ParameterError
from ves_gym.diagnosis.data.measured_run import Run
from ves_gym.diagnosis.machines.base import Machine, testable

SAME = 1e-9  # of a channel's size: two descriptions are one


@dataclass(frozen=True)
class DescriptionFiles:
    """Files of a better description."""

    files: tuple[Path, ...]
    digest: str  # SHA-256 of what they describe
    plain: dict[str, Any]  # for the JSON result
    diff: str  # from the description to it, for people
    difference: float  # of the residuals after reading back, in parts of their channel
    notes: tuple[str, ...] = ()
    free: dict[str, Any] | None = None  # free runs, where the machine can be simulated


def difference(
    machine: Machine, model: Any, other: Machine, other_model: Any, runs: Sequence[Run]
) -> float:
    """Return the largest difference of any port's residual under two models of two machines.

    It is in parts of the largest number of its channel's kind that the ports see.
    """
    worst = 0.0
    ports = [p.name for p in testable(machine, runs)]
    for run in runs:
        a = machine.residuals(run, [model], ports)
        b = other.residuals(run, [other_model], ports)
        for name in ports:
            size = machine.floor(run, name) * 1e3  # the floor is a thousandth of what is seen
            worst = max(worst, float(np.max(np.abs(a[name] - b[name]) / size)))
    return worst


def require_same(deviation: float, where: Path) -> None:
    """Refuse a file whose residuals deviate from those found, see `difference`.

    Raises:
        ParameterError: the deviation is above `SAME`.
    """
    if not deviation <= SAME:
        raise ParameterError(
            f"{where}: read back, it differs from what was found by {deviation:.2g} of a"
            f" channel (at most {SAME:g}); nothing is written"
        )


def unified_diff(old: str, new: str, names: tuple[str, str]) -> str:
    """Return a unified diff of two texts with these names."""
    lines = difflib.unified_diff(old.splitlines(), new.splitlines(), *names, n=2, lineterm="")
    return "\n".join(lines)
