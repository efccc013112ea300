"""A better `System` file: written, read back, played again at every port and in free run."""

from __future__ import annotations

import dataclasses
import tomllib
from collections.abc import Sequence
from pathlib import Path

from ves_gym._util.params import to_plain, toml
from ves_gym.diagnosis.data.measured_run import Run
from ves_gym.diagnosis.machines.system import SystemMachine
from ves_gym.diagnosis.output.closed_loop_replay import compare_replays
from ves_gym.diagnosis.output.common import (
    DescriptionFiles,
    difference,
    require_same,
    unified_diff,
)
from ves_gym.system.system import System

NAME = "system.toml"


def write_system(
    described: System,
    better: System,
    folder: Path,
    runs: Sequence[Run],
    final: Sequence[Run],
    free: bool = True,
) -> DescriptionFiles:
    """Write a better system, and prove that the file says what was diagnosed.

    Every port plays all runs; the loop as a whole (`free`) `final`, or the first of `runs`.

    Raises:
        ParameterError: what is read back plays otherwise.
    """
    old, new = (toml(to_plain(s)) for s in (described, better))
    target = folder / NAME
    reloaded = System.from_dict(tomllib.loads(new), str(target))
    original, restored = SystemMachine(better), SystemMachine(reloaded)
    every = [*runs, *final]
    deviation = difference(original, original.nominal, restored, restored.nominal, every)
    require_same(deviation, target)
    played = compare_replays(described, better, reloaded, final or runs[:1]) if free else None
    if played is not None and played.gaps:
        require_same(played.difference, target)
    better.save(target)
    return DescriptionFiles(
        files=(target,),
        digest=better.hash,
        plain={"system": better.to_dict()},
        diff=unified_diff(old, new, ("described", NAME)),
        difference=deviation,
        free=None if played is None else dataclasses.asdict(played),
    )
