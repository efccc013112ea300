"""Any machine that a mapping file describes: `schema` says of which sort it is."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from ves_gym._util.params import ParameterError, read_table
from ves_gym._util.recordings import read_columns
from ves_gym.diagnosis.data.measured_run import Run
from ves_gym.diagnosis.machines.mjcf_mapping import SCHEMA, Loader, machine_of
from ves_gym.diagnosis.machines.residual_mapping import SCHEMA as RESIDUAL
from ves_gym.diagnosis.machines.residual_mapping import residual_machine_of


def read_machine(path: str | os.PathLike[str], band: float | None = None) -> tuple[Any, Loader]:
    """Return machine and loader of its data, up to `band` Hz, from a mapping file.

    Raises:
        ParameterError: naming file and key.
    """
    path = Path(path)
    table = read_table(path)
    schema = table.get("schema")
    readers: dict[Any, Any] = {SCHEMA: machine_of, RESIDUAL: residual_machine_of}
    if band is not None:
        table = {**table, "band": band}
    if schema not in readers:
        raise ParameterError(
            f"{path}: schema must be one of {', '.join(readers)}, got {schema!r}"
        )
    file, machine = readers[schema](table, path)

    clock = getattr(getattr(file, "time", None), "column", None) or ""

    def load(data: str | os.PathLike[str]) -> Run:
        return file.run(read_columns(data, clock), Path(data).name)

    return machine, load
