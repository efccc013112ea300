"""Columns of measured data in the files people have: MATLAB, CSV, a folder of CSV."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym._util.reading import named, read_apart, read_bytes


def read_columns(path: str | os.PathLike[str]) -> dict[str, Array]:
    """Return all columns (T,) by name of a .mat or .csv file, or of all .csv files of a folder.

    Columns of a folder have the name "file:name", too, and only that where several files give
    one name to different columns. Single numbers of a .mat file are columns of length 1.

    Raises:
        ParameterError: not there, of another format, or not numbers.
    """
    path = Path(path)
    if path.is_dir():
        return _folder(path)
    if path.suffix == ".mat":
        with named(path):
            return read_apart("ves_gym._util.recordings:matlab_columns", path)
    if path.suffix == ".csv":
        return _csv(path)
    raise ParameterError(f"{path}: expected .mat, .csv or a folder of .csv files")


def matlab_columns(path: Path) -> dict[str, Array]:
    """Numbers of a .mat file by name, for `read_apart`."""
    from scipy.io import loadmat

    columns = {
        name: np.ravel(np.asarray(value, float))
        for name, value in loadmat(path).items()
        if name and not name.startswith("__") and np.asarray(value).dtype.kind in "fiu"
    }
    if not columns:
        raise ValueError("it holds no variable of numbers")
    return columns


def _csv(path: Path) -> dict[str, Array]:
    with named(path):
        data = read_bytes(path)
    try:
        text = data.decode()
        rows = list(csv.reader(io.StringIO(text, newline="")))
    except (UnicodeDecodeError, csv.Error) as error:
        raise ParameterError(f"{path}: cannot be read: {error}") from None
    if len(rows) < 2:
        raise ParameterError(f"{path}: expected a line of names and rows of numbers")
    names = [name.strip() for name in rows[0]]
    values = np.empty((len(rows) - 1, len(names)))
    for k, row in enumerate(rows[1:]):
        try:
            values[k] = [float(x) for x in row]
        except ValueError:
            raise ParameterError(
                f"{path}: row {k + 2}: expected {len(names)} numbers, got {row}"
            ) from None
    return dict(zip(names, values.T, strict=True))


def _folder(path: Path) -> dict[str, Array]:
    """Columns under their names, and under "file:name"; a name that means two things under the
    latter alone. Files that hold no table of numbers are left out if others do."""
    files = sorted(path.glob("*.csv"))
    if not files:
        raise ParameterError(f"{path}: no .csv file in this folder")
    out: dict[str, Array] = {}
    ambiguous: set[str] = set()
    refused: ParameterError | None = None
    for file in files:
        try:
            table = _csv(file)
        except ParameterError as error:
            refused = refused or error
            continue
        for name, column in table.items():
            if name in out and not np.array_equal(out[name], column):
                ambiguous.add(name)
            out.setdefault(name, column)
            out[f"{file.stem}:{name}"] = column
    if refused is not None and not out:
        raise refused
    return {name: column for name, column in out.items() if name not in ambiguous}


def column_of(columns: Mapping[str, Array], name: str, where: str) -> Array:
    """Return a column (T,), finite.

    Raises:
        ParameterError: not there, or not finite.
    """
    if name not in columns:
        raise ParameterError(f"{where}: no column {name!r}; it has {', '.join(columns)}")
    column = columns[name]
    bad = np.flatnonzero(~np.isfinite(column))
    if len(bad):
        raise ParameterError(f"{where}: column {name!r} is not finite in row {bad[0] + 1}")
    return column
