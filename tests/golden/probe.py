"""What a probe is, and what many of them ask."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

import ves_gym as vg
from tests.golden.compare import RELATIVE

ENERGIES = ("E_mean", "E_res", "E_peak", "E_strain_peak", "E_int", "W_port", "t_5")


@dataclass(frozen=True)
class Probe:
    """One small question to the front door."""

    measure: Callable[[], Mapping[str, Any]]
    slow: bool = False  # more than a few seconds with a warm cache
    relative: float = RELATIVE
    loose: Mapping[str, float] = field(default_factory=dict)  # of some entries, otherwise


def pattern(step: int, width: int, scale: float = 1.0) -> np.ndarray:
    """Return numbers (width,) of a fixed sequence, exact in binary: no sine of any library."""
    index = 7 * (step // 6) + 3 * np.arange(width)
    return scale * (index % 11 - 5) / 8


def motion(arm: vg.Arm, duration: float = 0.5, size: float = 0.2) -> vg.Motion:
    """Return a calm motion of every joint, from the middle of its range.

    Args:
        arm: whose joints move.
        duration: [s].
        size: of the way, and its middle lies beside the straight line [rad].
    """
    start = np.array([(k.q_min + k.q_max) / 2 for k in arm.links])
    way = size * np.resize([0.75, 0.5, -1.0, 0.5, -0.75], arm.n)
    beside = start + 0.5 * way + 0.2 * size * np.resize([1.0, -1.0], arm.n)
    control = [start] * 3 + [beside] + [start + way] * 3
    return vg.Motion(duration=duration, control=tuple(map(tuple, np.array(control).tolist())))


SHOWN = (
    "q",
    "v",
    "y",
    "yd",
    "tau",
    "w",
    "u",
    "motor",
    "jet",
    "propellant",
    "p",
    "pd",
    "contact",
)


def told(
    log: vg.RunLog, rows: int = 2, tail: float = 0.2, names: Sequence[str] = SHOWN
) -> dict[str, Any]:
    """Return energies and a few rows of what a log holds, the last one included.

    Args:
        log: of a run.
        rows: how many, evenly.
        tail: after the motion, for `E_mean` [s]; a stopped run has no energies.
        names: of the series.
    """
    chosen = np.linspace(0, len(log) - 1, rows + 1).round().astype(int)[1:]
    out: dict[str, Any] = {"length": len(log)}
    if log.t[-1] >= log.meta["duration"] + tail - 1e-9:
        energy = vg.energy(log, tail=tail)
        out["energy"] = {k: float(getattr(energy, k)) for k in ENERGIES}
    for name in names:
        series = getattr(log, name)
        if series is not None:
            out[name] = series[chosen]
    return out
