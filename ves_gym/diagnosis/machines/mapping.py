"""Any machine that a mapping file describes: `schema` says of which sort it is."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from ves_gym._util.params import ParameterError, read_table
from ves_gym._util.recordings import read_columns
from ves_gym.diagnosis.data.measured_run import Run
from ves_gym.diagnosis.machines.mjcf_mapping import SCHEMA, Loader, machine_of
from ves_gym.diagnosis.machines.plant_mapping import SCHEMAS, plant_of


def read_machine(path: str | os.PathLike[str], band: float | None = None) -> tuple[Any, Loader]:
    """Return machine and loader of its data files from a mapping file (.toml, .json).

    Args:
        path: of the mapping file.
        band: Hz, in place of the file's.

    Raises:
        ParameterError: naming file and key.
    """
    path = Path(path)
    table = read_table(path)
    schema = table.get("schema")
    if band is not None and schema != "ves-static/1":
        table = {**table, "band": band}
    if schema not in (SCHEMA, *SCHEMAS):
        raise ParameterError(
            f"{path}: schema must be one of {', '.join((SCHEMA, *SCHEMAS))}, got {schema!r}"
        )
    file, machine = machine_of(table, path) if schema == SCHEMA else plant_of(table, path)

    def load(data: str | os.PathLike[str]) -> Run:
        return file.run(read_columns(data), Path(data).name)

    return machine, load
