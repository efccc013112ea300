"""What was found of a machine by a residual function, in its mapping file: `[parameters]`."""

from __future__ import annotations

import os
import tempfile
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ves_gym._util.params import ParameterError, content_hash, read_table, write_text
from ves_gym.diagnosis.data.measured_run import Run
from ves_gym.diagnosis.machines.residual import ResidualMachine
from ves_gym.diagnosis.machines.residual_mapping import residual_machine_of
from ves_gym.diagnosis.output.common import (
    DescriptionFiles,
    difference,
    rename_files,
    require_same,
    unified_diff,
)

MAPPING = "machine.toml"


def write_parameters(
    mapping: Path,
    machine: ResidualMachine,
    effects: Sequence[Any],
    folder: Path,
    runs: Sequence[Run],
) -> DescriptionFiles:
    """Write the mapping file with the parameters found, read it back and play every port.

    Raises:
        ParameterError: the folder holds the file that is read; what is read back differs.
    """
    import tomli_w

    target = folder / MAPPING
    if target.resolve() == mapping.resolve():
        raise ParameterError(f"--out {folder} would overwrite {mapping}: take another folder")
    table, better = read_table(mapping), machine.better(effects)
    new = {**table}
    if better:
        new["parameters"] = {**table.get("parameters", {}), **better}
    if "model" in table.get("description", {}):  # it stays where it is
        there = (mapping.parent / table["description"]["model"]).resolve()
        near = Path(os.path.relpath(there, folder.resolve())).as_posix()
        new["description"] = {**table["description"], "model": near}
    text = tomli_w.dumps(new)
    reloaded = residual_machine_of(tomllib.loads(text), target)[1]
    deviation = difference(machine, machine.model(effects), reloaded, reloaded.nominal, runs)
    require_same(deviation, target)
    with tempfile.TemporaryDirectory(dir=folder, prefix=".new-") as inner:
        write_text(Path(inner) / MAPPING, text)
        rename_files([(Path(inner) / MAPPING, target)])
    return DescriptionFiles(
        files=(target,),
        digest=content_hash(new),
        plain={"machine_file": new},
        diff=unified_diff(tomli_w.dumps(table), text, (mapping.name, MAPPING)),
        difference=deviation,
        notes=tuple(f"{key} = {value}: in {MAPPING}" for key, value in better.items()),
    )
