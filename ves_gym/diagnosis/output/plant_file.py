"""Effects of a small machine into its mapping file, as `[[effect]]`."""

from __future__ import annotations

import os
import tempfile
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ves_gym._util.params import ParameterError, content_hash, read_table, to_plain, write_text
from ves_gym.diagnosis.data.measured_run import Run
from ves_gym.diagnosis.machines.plant import PlantMachine
from ves_gym.diagnosis.machines.plant_mapping import plant_of
from ves_gym.diagnosis.output.common import (
    DescriptionFiles,
    difference,
    rename_files,
    require_same,
    unified_diff,
)

MAPPING = "machine.toml"


def write_plant(
    mapping: Path,
    machine: PlantMachine,
    effects: Sequence[Any],
    folder: Path,
    runs: Sequence[Run],
) -> DescriptionFiles:
    """Write the mapping file with effects, read it back and play every port again.

    Raises:
        ParameterError: the folder holds the file that is read; what is read back differs.
    """
    import tomli_w

    target = folder / MAPPING
    if target.resolve() == mapping.resolve():
        raise ParameterError(f"--out {folder} would overwrite {mapping}: take another folder")
    table = read_table(mapping)
    new = {**table}
    if effects:
        new["effect"] = [*table.get("effect", ()), *map(to_plain, effects)]
    if "model" in table:  # it stays where it is
        there = (mapping.parent / table["model"]).resolve()
        new["model"] = Path(os.path.relpath(there, folder.resolve())).as_posix()
    text = tomli_w.dumps(new)
    reloaded = plant_of(tomllib.loads(text), target)[1]
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
        notes=tuple(f"{e.kind}: in {MAPPING}" for e in effects),
    )
