"""Mapping files of better descriptions: `machine.toml`, where there is one with `model.xml`."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ves_gym._util.params import ParameterError, content_hash, read_table, toml, write_text
from ves_gym.diagnosis.data.measured_run import Run
from ves_gym.diagnosis.machines.residual import ResidualMachine
from ves_gym.diagnosis.machines.residual_mapping import residual_machine_of
from ves_gym.diagnosis.output.common import (
    DescriptionFiles,
    difference,
    require_same,
    unified_diff,
)

MAPPING, MODEL = "machine.toml", "model.xml"
Reader = Callable[[dict[str, Any], Path], tuple[Any, Any]]


def write_mapping(
    mapping: Path,
    new: dict[str, Any],
    read: Reader,
    machine: Any,
    effects: Sequence[Any],
    folder: Path,
    runs: Sequence[Run],
    notes: Sequence[str],
    model: tuple[Path, str, str] | None = None,
) -> DescriptionFiles:
    """Write a mapping file that reads back as the machine with effects at every port.

    Args:
        mapping: the file that was read.
        new: content of the one that is written.
        read: file and machine of a content that is, or would be, at a path.
        machine: as described.
        effects: that it lacks.
        folder: of what is written.
        runs: that the ports play.
        notes: what went where.
        model: the MJCF file that was read, its text, and the text that takes its place.

    Raises:
        ParameterError: the folder holds the files that are read; what is read back differs.
    """
    target, near = folder / MAPPING, folder / f".new-{MODEL}"
    for written, source in ((target, mapping), (folder / MODEL, model and model[0])):
        if source and written.resolve() == source.resolve():
            raise ParameterError(
                f"--out {folder} would overwrite {source}: take another folder"
            )
    text = toml(new)
    table = tomllib.loads(text)
    try:
        if model:
            write_text(near, model[2])
            table["model"] = near.name
        reread = read(table, target)[1]
        deviation = difference(machine, machine.model(effects), reread, reread.nominal, runs)
        require_same(deviation, target)
        if model:
            near.replace(folder / MODEL)
    finally:
        near.unlink(missing_ok=True)
    write_text(target, text)
    diff = [unified_diff(toml(read_table(mapping)), text, (mapping.name, MAPPING))]
    if model:
        diff.append(unified_diff(model[1], model[2], (model[0].name, MODEL)))
    return DescriptionFiles(
        files=(target, folder / MODEL) if model else (target,),
        digest=content_hash([new, model[2] if model else ""]),
        plain={"machine_file": new, "model": model[2] if model else ""},
        diff="\n".join(d for d in diff if d),
        difference=deviation,
        notes=tuple(notes),
    )


def write_parameters(
    mapping: Path,
    machine: ResidualMachine,
    effects: Sequence[Any],
    folder: Path,
    runs: Sequence[Run],
) -> DescriptionFiles:
    """Write the mapping file of a residual function with what was found in `[parameters]`."""
    table, better = read_table(mapping), machine.better(effects)
    new = {**table}
    if better:
        new["parameters"] = {**table.get("parameters", {}), **better}
    if "model" in table.get("description", {}):  # it stays where it is
        near = path_from(folder, mapping.parent / table["description"]["model"])
        new["description"] = {**table["description"], "model": near}
    notes = [f"{key} = {value}: in {MAPPING}" for key, value in better.items()]
    return write_mapping(
        mapping, new, residual_machine_of, machine, effects, folder, runs, notes
    )


def path_from(folder: Path, file: Path) -> str:
    """Return the way to a file from a folder, as files say it."""
    return Path(os.path.relpath(file.resolve(), folder.resolve())).as_posix()
