"""Columns of measured data in the files people have: text, MATLAB, HDF5, Parquet, ROS, folders.

Nothing is lost unreported: what was understood of a file beside its plain columns is in
`FileColumns.notes`.
"""

from __future__ import annotations

import csv
import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ves_gym._util import ros_logs
from ves_gym._util.optional import require
from ves_gym._util.params import Array, ParameterError
from ves_gym._util.reading import named, read_apart, read_bytes

TEXT = (".csv", ".txt", ".tsv", ".dat", ".log")
ARRAYS = (".mat", ".h5", ".hdf5", ".parquet")
_MARKS = (";", "\t", ",", "|", " ")  # between cells; where two do, the first
_SAMPLE = 50  # rows that tell how a table is written
_EMPTY = ("", "nan", "na", "n/a", "null", "none", "-", "--")  # a cell without a number
_COMMENT = ("#", "%", "//")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?|[+-]?inf(inity)?", re.IGNORECASE)


@dataclass(frozen=True)
class FileColumns:
    """Columns of a file, and how it was understood."""

    columns: dict[str, Array]  # (T,) by name; NaN where a cell has no number
    units: dict[str, str] = field(default_factory=dict)  # by name, where a row of the file says
    notes: tuple[str, ...] = ()  # what is not plain: names that stand twice, missing numbers


def read_columns(path: str | os.PathLike[str], clock: str = "") -> dict[str, Array]:
    """Return the columns (T,) by name of a file or folder, see `read_recording`."""
    return read_recording(path, clock).columns


def read_recording(path: str | os.PathLike[str], clock: str = "") -> FileColumns:
    """Read all columns of a table in text, a .mat, HDF5, Parquet or ROS file, or of a folder.

    Tables may have any delimiter, decimal commas, comments and a row of units; without a line
    of names, columns are called column_1, column_2 and so on. Matrices of a .mat file are a
    column per signal (q_1, q_2), fields of a structure go by "structure.field", single numbers
    are columns of length 1. Columns of a folder of .csv have the name "file:name", too, and
    only that where several files give one name to different columns. Of a log of ROS joints are
    "joint_position" and so on, wrenches and poses "topic:name", all on one clock: where several
    topics have joints, that of `clock`, "TOPIC:t".
    """
    path = Path(path)
    suffix = path.suffix.lower()
    with named(path):
        if ros_logs.is_ros_log(path):
            return _ros_log(path, clock)
        if suffix in ARRAYS:
            return _as_columns(read_apart("ves_gym._util.recordings:arrays_of", path))
        if suffix in TEXT:
            return _table(read_bytes(path))
    if path.is_dir():
        return _folder(path)
    names = ", ".join((*TEXT, *ARRAYS, *ros_logs.SUFFIXES))
    raise ParameterError(f"{path}: expected one of {names}, or a folder of .csv or a rosbag2")


def _ros_log(path: Path, clock: str) -> FileColumns:
    arrays = read_apart("ves_gym._util.ros_logs:arrays_of", path)
    columns, notes = ros_logs.columns_of(arrays, clock)
    return FileColumns(columns, {}, (*notes, *_missing(columns)))


def column_of(
    columns: Mapping[str, Array], name: str, where: str, missing: bool = False
) -> Array:
    """Return a column (T,), finite; NaN where `missing` lets it."""
    if name not in columns:
        raise ParameterError(f"{where}: no column {name!r}; it has {', '.join(columns)}")
    column = columns[name]
    bad = np.flatnonzero(np.isinf(column) if missing else ~np.isfinite(column))
    if len(bad):
        raise ParameterError(f"{where}: column {name!r} is not finite in row {bad[0] + 1}")
    return column


# -------------------------------------------------------------------------- text tables


def _table(data: bytes) -> FileColumns:
    text, notes = _decoded(data)
    lines = [(k, line) for k, line in enumerate(text.splitlines(), 1) if line.strip()]
    body = [(k, line) for k, line in lines if not line.lstrip().startswith(_COMMENT)]
    mark = _mark([line for _, line in body[:_SAMPLE]])
    sample = [_cells(line, mark) for _, line in body[:_SAMPLE]]
    heads = _heads(sample)
    rows = body[heads:]
    if not rows:
        raise ParameterError("expected a line of names and rows of numbers")
    titles = [_trimmed(row) for row in sample[:heads]]
    if not titles:  # names may stand in the last comment before the numbers
        before = [line.lstrip().lstrip("#%/ ") for k, line in lines if k < rows[0][0]]
        titles = [_cells(line, mark) for line in before[-1:]]
    width = Counter(len(_trimmed(row)) for row in sample[heads:]).most_common(1)[0][0]
    fitting = [row for row in titles if len(row) == width]
    if heads and not fitting:
        raise ParameterError(
            f"row {body[0][0]}: the line of names has {len(titles[0])} cells, the rows of"
            f" numbers have {width}"
        )
    names = [f"column_{k}" for k in range(1, width + 1)]
    if fitting:  # a title may stand above the names, cells of nothing beside it
        first = fitting.index(max(fitting, key=lambda row: sum(map(bool, row))))
        others = [" ".join(row) for row in titles if row not in fitting[first:]]
        notes += [f"left out above the names: {text.strip()}" for text in others if heads]
        fitting = fitting[first:]
        names = [name or place for name, place in zip(fitting[0], names, strict=True)]
    else:
        notes.append(f"no line of names: columns are called column_1 to column_{width}")
    comma = mark != "," and any(re.search(r"\d,\d", c) for row in sample[heads:] for c in row)
    notes += _torn(text, lines, rows, mark)
    values, mask = _numbers(rows, mark, comma, names)
    lost = [name for name, numeric in zip(names, mask, strict=True) if not numeric]
    notes += [f"columns of words left out: {', '.join(lost)}"] if lost else []
    units = dict(zip(names, fitting[1], strict=True)) if len(fitting) > 1 else {}
    named = [name for name, numeric in zip(names, mask, strict=True) if numeric]
    columns = _distinct(named, values, notes)
    return FileColumns(columns, units, (*notes, *_missing(columns)))


def _torn(
    text: str,
    lines: Sequence[tuple[int, str]],
    rows: Sequence[tuple[int, str]],
    mark: str,
) -> list[str]:
    """Return notes on comments between the numbers, and on a last one cut short."""
    numbered = {k for k, _ in rows}
    between = [k for k, _ in lines if k > rows[0][0] and k not in numbered]
    count = len(between)
    out = [f"{count} comments among the numbers left out, row {between[0]}"] if count else []
    last, *others = (_cells(line, mark)[-1] for _, line in rows[-1:-_SAMPLE:-1])
    if text[-1:] not in "\r\n" and others and len(last) < min(map(len, others)):
        out.append(f"row {rows[-1][0]}, the last, may be cut off in its last number {last!r}")
    return out


def _decoded(data: bytes) -> tuple[str, list[str]]:
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16", errors="replace"), []
    try:
        return data.decode("utf-8-sig"), []
    except UnicodeDecodeError:
        if b"\0" in data:
            raise ParameterError("cannot be read: it is no text") from None
        return data.decode("latin-1"), ["not UTF-8: read as Latin-1"]


def _cells(line: str, mark: str) -> list[str]:
    if '"' in line and mark != " ":
        try:
            parts = next(csv.reader([line], delimiter=mark, skipinitialspace=True))
        except csv.Error as error:
            raise ParameterError(f"cannot be read: {error}") from None
    else:
        parts = line.split() if mark == " " else line.split(mark)
    return [part.strip().strip('"') for part in parts]


def _trimmed(row: list[str]) -> list[str]:
    """Cells without the empty one that a mark at the end of a line makes."""
    return row[:-1] if len(row) > 1 and not row[-1] else row


def _is_number(cell: str, mark: str) -> bool:
    return bool(_NUMBER.fullmatch(cell if mark == "," else cell.replace(",", ".", 1)))


def _mark(lines: Sequence[str]) -> str:
    """Return the separator that makes most cells, and the largest share of them, numbers."""

    def score(mark: str) -> tuple[float, int]:
        cells = [cell for line in lines[1:] or lines for cell in _cells(line, mark) if cell]
        count = sum(_is_number(cell, mark) for cell in cells)
        return count / max(len(cells), 1), count

    return max(_MARKS, key=score)


def _heads(sample: Sequence[list[str]]) -> int:
    """Return the number of rows before those of numbers: names, possibly numbers in part, and
    rows without a number."""
    if not sample or all(_is_cell(cell) for cell in sample[0]):
        return 0
    heads = 1
    while heads < len(sample) and not any(map(_is_any_number, sample[heads])):
        heads += 1
    return heads


def _is_any_number(cell: str) -> bool:
    return _is_number(cell, ";")


def _is_cell(cell: str) -> bool:
    return _is_any_number(cell) or cell.lower() in _EMPTY


def _numbers(
    rows: Sequence[tuple[int, str]], mark: str, comma: bool, names: Sequence[str]
) -> tuple[Array, list[bool]]:
    """Numbers (T, c) of the columns that have any, and which columns these are."""
    lines = [line.replace(",", ".") for _, line in rows] if comma else [k for _, k in rows]
    every = [True] * len(names)
    try:
        plain = np.loadtxt(
            lines, delimiter=None if mark == " " else mark, comments=None, ndmin=2
        )
        if plain.shape[1] == len(names):
            return plain, every
    except ValueError:
        pass
    table = []
    for (k, _), line in zip(rows, lines, strict=True):
        cells = _cells(line, mark)
        cells = cells if len(cells) == len(names) else _trimmed(cells)
        if len(cells) != len(names):
            raise ParameterError(
                f"row {k}: expected {len(names)} numbers, got {len(cells)}: {line[:80]!r}"
            )
        table.append(cells)
    mask = [any(_is_cell(row[i]) for row in table[:_SAMPLE]) for i in range(len(names))]
    for i in (i for i, numeric in enumerate(mask) if not numeric):
        try:  # dates, like 2026-01-01T12:00:00.01
            dates = np.array([row[i].removesuffix("Z") for row in table], "datetime64[ns]")
        except ValueError:
            continue
        mask[i], seconds = True, (dates - dates[0]) / np.timedelta64(1, "s")
        for cells, second in zip(table, seconds, strict=True):
            cells[i] = f"{second:.9f}"
    columns = [i for i, numeric in enumerate(mask) if numeric]
    out = np.full((len(table), len(columns)), np.nan)
    for (k, _), cells, row in zip(rows, table, out, strict=True):
        for j, i in enumerate(columns):
            if cells[i].lower() in _EMPTY:
                continue
            if not _is_number(cells[i], ","):
                cell = cells[i][:40]
                raise ParameterError(f"row {k}: {names[i]} must be a number, got {cell!r}")
            row[j] = float(cells[i])
    return out, mask


def _distinct(names: Sequence[str], values: Array, notes: list[str]) -> dict[str, Array]:
    """Columns by name; of a name that stands again the later is called name@place."""
    out: dict[str, Array] = {}
    for k, (name, column) in enumerate(zip(names, values.T, strict=True), 1):
        if name not in out:
            out[name] = column
            continue
        if np.array_equal(out[name], column, equal_nan=True):
            notes.append(f"{name} stands again in column {k}, with the same numbers")
            continue
        out[f"{name}@{k}"] = column
        text = f"{name} stands again in column {k}, with other numbers: there it is {name}@{k}"
        notes.append(text)
    return out


def _missing(columns: Mapping[str, Array]) -> list[str]:
    counts = {name: int((~np.isfinite(column)).sum()) for name, column in columns.items()}
    return [f"{k}: no number in {n} of {len(columns[k])} rows" for k, n in counts.items() if n]


def _folder(path: Path) -> FileColumns:
    """Columns under their names, and under "file:name"; a name that means two things under the
    latter alone. Files that hold no table of numbers are left out if others do."""
    files = sorted(k for k in path.iterdir() if k.suffix.lower() == ".csv")
    if not files:
        raise ParameterError(f"{path}: no .csv file in this folder")
    out: dict[str, Array] = {}
    units: dict[str, str] = {}
    notes: list[str] = []
    ambiguous: set[str] = set()
    refused: ParameterError | None = None
    for file in files:
        try:
            with named(file):
                table = _table(read_bytes(file))
        except ParameterError as error:
            refused = refused or error
            notes.append(f"left out: {error}")
            continue
        for name, column in table.columns.items():
            if name in out and not np.array_equal(out[name], column, equal_nan=True):
                ambiguous.add(name)
            out.setdefault(name, column)
            out[f"{file.stem}:{name}"] = column
        units |= table.units | {f"{file.stem}:{k}": unit for k, unit in table.units.items()}
        notes += [f"{file.name}: {note}" for note in table.notes]
    if refused is not None and not out:
        raise refused
    columns = {name: column for name, column in out.items() if name not in ambiguous}
    return FileColumns(columns, units, tuple(notes))


# ------------------------------------------------------------------ arrays by their name


def arrays_of(path: Path) -> dict[str, Array]:
    """Arrays of numbers of a .mat, HDF5 or Parquet file by name, for `read_apart`."""
    suffix = path.suffix.lower()
    if suffix == ".parquet":
        return _parquet(path)
    datasets = _matlab(path) if suffix == ".mat" else _datasets(path)
    out = {
        name: np.asarray(value, float)
        for name, value in datasets
        if name and np.asarray(value).dtype.kind in "fiu"
    }
    if not out:
        raise ValueError("it holds no variable of numbers")
    return out


def _parquet(path: Path) -> dict[str, Array]:
    require("Parquet", "pyarrow")
    from pyarrow import parquet

    table = parquet.read_table(path)
    return {
        name: column.to_numpy().astype(float)
        for name, column in zip(table.column_names, table.columns, strict=True)
        if str(column.type).startswith(("double", "float", "int", "uint"))
    }


def _matlab(path: Path) -> Iterable[tuple[str, Any]]:
    from scipy.io import loadmat

    try:
        loaded = loadmat(path, simplify_cells=True)
    except NotImplementedError:  # version 7.3 is HDF5
        return _datasets(path)
    return _leaves({k: v for k, v in loaded.items() if not k.startswith("__")})


def _leaves(table: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """Values of structures within structures, by "structure.field"."""
    for name, value in table.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{before}{name}.")
        else:
            yield before + name, value


def _datasets(path: Path) -> list[tuple[str, Any]]:
    require("HDF5, and so a .mat file of version 7.3,", "h5py")
    import h5py

    out: list[tuple[str, Any]] = []

    def visit(name: str, item: Any) -> None:
        kind = item.attrs.get("MATLAB_class", "")
        words = kind in ("char", b"char") or name.startswith("#")
        if isinstance(item, h5py.Dataset) and not words:
            # MATLAB writes by columns
            out.append((name.replace("/", "."), np.asarray(item).T))

    with h5py.File(path) as file:
        file.visititems(visit)
    return out


def _as_columns(arrays: Mapping[str, Array]) -> FileColumns:
    """Columns of arrays: a matrix is a column per signal, its rows or its columns samples."""
    lengths = Counter(n for x in arrays.values() for n in set(x.shape) if n > 1)
    samples = max(lengths, key=lambda n: (lengths[n], n), default=1)
    columns: dict[str, Array] = {}
    notes = []
    for name, x in arrays.items():
        if x.size == max(x.shape, default=1):
            columns[name] = x.ravel()
        elif x.ndim == 2 and samples in x.shape:
            signals = x if x.shape[0] == samples else x.T
            columns |= {f"{name}_{k}": column for k, column in enumerate(signals.T, 1)}
            notes.append(f"{name} is a matrix {x.shape}: its signals are {name}_1, ...")
        else:
            notes.append(
                f"left out: {name} of shape {x.shape}, the data have {samples} samples"
            )
    return FileColumns(columns, {}, (*notes, *_missing(columns)))
