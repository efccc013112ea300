"""What a diagnosis leaves behind: a better description, read back and played again."""

from __future__ import annotations

import difflib
import os
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
class Written:
    """Files of a better description."""

    files: tuple[Path, ...]
    digest: str  # SHA-256 of what they describe
    plain: dict[str, Any]  # for the JSON result
    diff: str  # from the description to it, for people
    difference: float  # of the residuals after reading back, in parts of their channel
    notes: tuple[str, ...] = ()
    free: dict[str, Any] | None = None  # free runs, where the machine can be simulated


def difference(
    one: Machine, model: Any, other: Machine, again: Any, runs: Sequence[Run]
) -> float:
    """Largest difference of any port's residual under two models, in parts of the largest
    number of its channel's kind that the ports see."""
    worst = 0.0
    ports = [p.name for p in testable(one, runs)]
    for run in runs:
        a, b = one.residuals(run, [model], ports), other.residuals(run, [again], ports)
        for name in ports:
            size = one.floor(run, name) * 1e3  # the floor is a thousandth of what is seen
            worst = max(worst, float(np.max(np.abs(a[name] - b[name]) / size)))
    return worst


def require_same(found: float, where: Path) -> None:
    """Refuse a file that does not say what was found.

    Raises:
        ParameterError: the difference is above `SAME`.
    """
    if not found <= SAME:
        raise ParameterError(
            f"{where}: read back, it differs from what was found by {found:.2g} of a channel"
            f" (at most {SAME:g}); nothing is written"
        )


def diff_of(old: str, new: str, names: tuple[str, str]) -> str:
    """A unified diff."""
    lines = difflib.unified_diff(old.splitlines(), new.splitlines(), *names, n=2, lineterm="")
    return "\n".join(lines)


def moved(pairs: Sequence[tuple[Path, Path]]) -> None:
    """Give files their names, the last one last."""
    for here, there in pairs:
        os.replace(here, there)
