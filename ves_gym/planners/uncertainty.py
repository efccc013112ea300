"""What is uncertain of a machine, from a file: a user's ranges, or what a diagnosis says.

`ves-gym diagnose` writes an estimate and a 90 % interval for every number that it names. The
machine with the estimates is what a robust plan is made for, the ends of the intervals are its
scenarios. Effects on arm and base count; others (friction, sensors, platform) do not change
the base's response to a motion that the joints follow, and stay as they are.
"""

from __future__ import annotations

import dataclasses
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ves_gym._util.params import ParameterError, read_result, read_table
from ves_gym.planners.robust import Ranges
from ves_gym.system.candidate import Candidate, Scope
from ves_gym.system.effect import EFFECTS, ArmEffect, BaseEffect
from ves_gym.system.system import System

DIAGNOSIS = "ves-diagnose/1"


@dataclass(frozen=True)
class Uncertainty:
    """Ranges of effects about a machine; without one, about that of the query."""

    ranges: Ranges
    around: System | None = None  # before the effects of the ranges
    estimate: System | None = None  # with their estimates in arm and vehicle

    @property
    def lines(self) -> list[str]:
        """Every range as text."""
        return [
            f"{effect}.{name}: {np.asarray(low).tolist()} to {np.asarray(high).tolist()}"
            for effect, fields in self.ranges.items()
            for name, (low, high) in fields.items()
            if np.any(np.asarray(low) != np.asarray(high))
        ]


def read_uncertainty(path: str | os.PathLike[str]) -> Uncertainty:
    """Read ranges from TOML, as `randomize` takes them, or from a diagnosis's JSON.

    Args:
        path: a table [effect] parameter = [low, high], or `diagnosis.json` of
            `ves-gym diagnose`.

    Raises:
        ParameterError: no such file, or nothing of arm or base in it is uncertain.
    """
    if Path(path).suffix.lower() == ".toml":
        ranges = read_table(path)
        if not ranges:
            raise ParameterError(f"{path}: expected ranges of effects, got none")
        return Uncertainty(ranges)
    plain = read_result(path, DIAGNOSIS)
    if "system" not in plain:
        raise ParameterError(f"{path}: expected the diagnosis of a System, got one of MJCF")
    better = System.from_dict(plain["system"], f"{path}: system").ideal()
    ranges = {}
    for entry in plain["effects"]:
        cls = EFFECTS.get(entry["kind"])
        if cls is None or not issubclass(cls, (ArmEffect, BaseEffect)):
            continue
        for name, ends in _ends(better, entry).items():
            fields = ranges.setdefault(entry["kind"], {})
            fields[name] = ends if name not in fields else _joined(fields[name], ends)
    if not ranges:
        named = ", ".join(entry["name"] for entry in plain["effects"]) or "none"
        raise ParameterError(
            f"{path}: expected an effect on arm or base with an interval, got {named}"
            f" ({plain['verdict']})"
        )
    others = tuple(e for e in better.effects if e.kind not in ranges)
    return Uncertainty(ranges, better.replace(effects=others), better.actual)


def _ends(system: System, entry: dict[str, Any]) -> dict[str, tuple[Any, Any]]:
    """Fields of a diagnosed effect that are not as by default: (low, high) of each."""
    candidate = _candidate(system, entry)
    values = np.array([entry["value"][name] for name in candidate.names])
    estimate = candidate.effect(values)
    lowest, highest = (
        {f.name: np.asarray(getattr(estimate, f.name), float) for f in _fields(estimate)}
        for _ in range(2)
    )
    for k, name in enumerate(candidate.names):
        interval = entry["interval"][name]
        for end in () if interval is None else interval:
            moved = values.copy()
            moved[k] = end
            effect = candidate.effect(moved)
            for field in lowest:
                at = np.asarray(getattr(effect, field), float)
                lowest[field] = np.minimum(lowest[field], at)
                highest[field] = np.maximum(highest[field], at)
    return {name: (lowest[name].tolist(), highest[name].tolist()) for name in lowest}


def _candidate(system: System, entry: dict[str, Any]) -> Candidate:
    scope = Scope(system.arm.n, system)
    for candidate in EFFECTS[entry["kind"]].candidates(scope):
        if candidate.slot == entry["slot"]:
            return candidate
    raise ParameterError(f"the diagnosis names {entry['name']}, which this machine lacks")


def _fields(effect: Any) -> list[dataclasses.Field[Any]]:
    """Numbers of an effect that differ from its defaults."""
    return [f for f in dataclasses.fields(effect) if getattr(effect, f.name) != f.default]


def _joined(first: tuple[Any, Any], second: tuple[Any, Any]) -> tuple[Any, Any]:
    """Ends of an effect that was named in two places, zero where it was not."""
    low, high = (np.add(a, b).tolist() for a, b in zip(first, second, strict=True))
    return low, high
