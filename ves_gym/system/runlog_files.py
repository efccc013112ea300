"""Files of a run log: strict reading and all-or-nothing writing of its columns.

A fault names row and column (rows count from 1, without the CSV header); `reading.named` puts
the file before it. Nothing is guessed or repaired.
"""

from __future__ import annotations

import csv
import json
import os
import re
import reprlib
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from ves_gym._util.optional import lacking
from ves_gym._util.params import Array, write_bytes
from ves_gym._util.suggest import why_unread

META_KEY = "ves_gym"  # of the Parquet schema's metadata
DIGEST_KEY = "ves_gym_digest"  # beside it, in files that `save` wrote
BASE = 6  # x, y, z, phi_x, phi_y, phi_z and their wrench

# one column per joint, base coordinate, internal coordinate, wheel; one alone; payload
JOINT, POSE, MODE, WHEEL, ONE, BODY = "n", str(BASE), "m", "w", "1", "7"
# quantity -> (its columns, required), in the order of the columns on disk
QUANTITIES = {
    "q_cmd": (JOINT, True),
    "v_cmd": (JOINT, True),
    "q": (JOINT, True),
    "v": (JOINT, False),
    "tau": (JOINT, False),
    "tau_ff": (JOINT, False),
    "y": (POSE, True),
    "y_cmd": (POSE, False),
    "yd": (POSE, False),
    "w": (POSE, False),
    "wg": (POSE, False),
    "u": (MODE, False),
    "ud": (MODE, False),
    "motor": (WHEEL, False),
    "jet": (POSE, False),
    "propellant": (ONE, False),
    "p": (BODY, False),
    "pd": (POSE, False),
    "contact": (POSE, False),
    "contact_energy": (ONE, False),
}
AXES = ("x", "y", "z", "phi_x", "phi_y", "phi_z")  # of a pose and of its wrench
DIMENSIONS = {JOINT: "joint", POSE: "axis", MODE: "mode", WHEEL: "wheel", BODY: "payload"}
_MOST = {POSE: BASE, ONE: 1, BODY: 7}  # columns of an axis that has a fixed number of them
KNOWN = ", ".join(["t", *(f"{k}_1..{axis}" for k, (axis, _) in QUANTITIES.items())])

_COLUMN = re.compile(rf"({'|'.join(QUANTITIES)})_([1-9][0-9]{{0,5}})")
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
_NUMBER_BYTES = b"0123456789+-.eE,\n"  # a CSV body without fault has no others
# Parquet types whose every value is a float64; wider ones would be rounded
_EXACT = {"double", "float", "int8", "int16", "int32", "uint8", "uint16", "uint32"}


class RunLogError(ValueError):
    """A run log breaks the format; one line names file, row and column."""


def short(value: object) -> str:
    """A value in a message, cut where it is long."""
    return reprlib.repr(value)


def suffix_of(path: Path) -> str:
    if path.suffix not in (".parquet", ".csv"):
        raise RunLogError(f"{path}: expected a name ending in .parquet or .csv")
    return path.suffix


def load_pyarrow(path: Path) -> tuple[ModuleType, ModuleType]:
    if sentence := lacking("Parquet", "pyarrow"):
        raise RunLogError(f"{path}: {sentence}; or save as .csv")
    import pyarrow
    import pyarrow.parquet

    return pyarrow, pyarrow.parquet


def read_bytes(path: Path) -> bytes:
    try:
        data = path.read_bytes()
    except OSError as error:
        why = why_unread(path, error)
        raise RunLogError(f"expected a readable file, got {why}") from None
    if not data:
        raise RunLogError("expected part of a run log, got an empty file")
    return data


def write_pair(first: Path, first_text: str, second: Path, second_text: str) -> None:
    """Write both files or neither; both are complete on disk before either is renamed.

    Args:
        first, second: paths.
        first_text, second_text: contents.
    """
    first.parent.mkdir(parents=True, exist_ok=True)
    try:
        with tempfile.TemporaryDirectory(dir=first.parent, prefix=f".{first.stem}.") as staging:
            staged = [Path(staging) / path.name for path in (first, second)]
            write_bytes(staged[0], first_text.encode("ascii"))
            write_bytes(staged[1], second_text.encode("ascii"))
            before = first.read_bytes() if first.exists() else None
            os.replace(staged[0], first)
            try:
                os.replace(staged[1], second)
            except BaseException:
                if before is None:
                    first.unlink()
                else:
                    write_bytes(first, before)
                raise
    except OSError as error:  # under the name that the caller knows
        raise OSError(error.errno, error.strerror, str(first)) from None


def read_parquet(path: Path) -> tuple[dict[str, Array], Any, str | None]:
    pa, pq = load_pyarrow(path)
    data = read_bytes(path)
    try:
        file = pq.ParquetFile(pa.BufferReader(data), page_checksum_verification=True)
        schema, keys = file.schema_arrow, file.metadata.metadata or {}
        sizes = _check_names(schema.names)
        table = file.read()
    except RunLogError:
        raise
    except Exception as error:  # a damaged footer makes the decoder raise nearly anything
        text = " ".join(str(error).split())
        raise RunLogError(f"expected a Parquet file, got {len(data)} bytes: {text}") from None
    for field in schema:
        if str(field.type) not in _EXACT:
            raise RunLogError(f"column {field.name}: expected type double, got {field.type}")
    if META_KEY.encode() not in keys:
        raise RunLogError(f"expected metadata under the schema key {META_KEY!r}, got none")
    columns = {name: table[name].to_numpy() for name in schema.names}  # null becomes NaN
    digest = (
        keys[DIGEST_KEY.encode()].decode("latin-1") if DIGEST_KEY.encode() in keys else None
    )
    return _arrays(columns, sizes), read_json(keys[META_KEY.encode()]), digest


def read_csv(path: Path) -> dict[str, Array]:
    # Latin-1 decodes any byte, so that a stray one is found as a cell, by row and column.
    text = read_bytes(path).decode("latin-1").replace("\r\n", "\n")
    header, _, body = text.partition("\n")
    try:
        names = next(csv.reader([header], strict=True), [])
    except csv.Error as error:
        raise RunLogError(
            f"header: expected column names, got {short(header)}: {error}"
        ) from None
    sizes = _check_names(names)
    rows = body.split("\n")
    if last := rows.pop():  # a cut number still looks like one
        column = names[min(last.count(","), len(names) - 1)]
        raise RunLogError(
            f"row {len(rows) + 1}, column {column}: expected a line end after every row,"
            " got the end of the file (cut off?)"
        )
    if not rows:
        raise RunLogError("expected at least 2 rows below the header, got none")
    try:
        if "" in rows or body.encode("latin-1").translate(None, _NUMBER_BYTES):
            raise ValueError("blank rows or stray characters")  # loadtxt passes over some
        table = np.loadtxt(rows, delimiter=",", comments=None, ndmin=2)
        if table.shape != (len(rows), len(names)):
            raise ValueError(f"a table of shape {table.shape}")
    except ValueError as error:
        _locate(rows, names)
        raise RunLogError(f"expected a table of numbers, got {error}") from None
    return _arrays(dict(zip(names, table.T, strict=True)), sizes)


def _locate(rows: Sequence[str], names: Sequence[str]) -> None:
    """Raise for the first bad cell: slow, so only run once a fault is known."""
    for i, row in enumerate(rows, 1):
        cells = row.split(",")
        if len(cells) != len(names):
            k = min(len(cells), len(names) - 1)
            raise RunLogError(
                f"row {i}, column {names[k]}: expected {len(names)} cells, got {len(cells)}"
            )
        for name, cell in zip(names, cells, strict=True):
            if not _NUMBER.fullmatch(cell):
                raise RunLogError(
                    f"row {i}, column {name}: expected a finite number, got {short(cell)}"
                )


def read_json(data: bytes) -> Any:
    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        keys = [key for key, _ in pairs]
        if len(set(keys)) < len(keys):
            raise ValueError(f"a key more than once among {short(keys)}")
        return dict(pairs)

    def reject(constant: str) -> None:
        raise ValueError(f"{constant}, which is not JSON")

    try:
        return json.loads(data, object_pairs_hook=once, parse_constant=reject)
    except (ValueError, RecursionError) as error:  # also text that is not UTF-8
        raise RunLogError(f"metadata: expected JSON, got {error}") from None


def _check_names(names: Sequence[str]) -> dict[str, int]:
    """Columns per axis, once every name is known, single and part of a complete set."""
    if len(names) == 0:
        raise RunLogError(f"header: expected the columns {KNOWN}, got none")
    columns: dict[str, set[int]] = {"t": set()}
    for name in names:
        match = _COLUMN.fullmatch(name)
        if name != "t" and (
            match is None or int(match[2]) > _MOST.get(QUANTITIES[match[1]][0], int(match[2]))
        ):
            raise RunLogError(f"column {short(name)}: unknown; expected {KNOWN}")
        quantity, index = (match[1], int(match[2])) if match else ("t", 1)
        if index in columns.setdefault(quantity, set()):
            raise RunLogError(f"column {name}: expected once, got it more than once")
        columns[quantity].add(index)
    sizes = dict(_MOST)
    for axis in (JOINT, MODE, WHEEL):
        of_axis = [max(k) for q, k in columns.items() if q != "t" and QUANTITIES[q][0] == axis]
        sizes[axis] = max(of_axis, default=1)
    if not columns["t"]:
        raise RunLogError(f"column t: missing; got {', '.join(names[:8])} ...")
    for quantity, (axis, required) in QUANTITIES.items():
        if required or quantity in columns:
            size = sizes[axis]
            have = columns.get(quantity, set())
            lost = next((i for i in range(1, size + 1) if i not in have), None)
            if lost is not None:
                raise RunLogError(
                    f"column {quantity}_{lost}: missing; expected {quantity}_1..{size},"
                    f" got {len(have)} of them"
                )
    return sizes


def _arrays(columns: Mapping[str, Array], sizes: Mapping[str, int]) -> dict[str, Array]:
    """Columns by name -> the arrays of a RunLog."""
    out = {"t": columns["t"]}
    for quantity, (axis, _) in QUANTITIES.items():
        if f"{quantity}_1" in columns:
            size = sizes[axis]
            out[quantity] = np.column_stack(
                [columns[f"{quantity}_{i + 1}"] for i in range(size)]
            )
    return out
