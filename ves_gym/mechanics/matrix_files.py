"""Matrices of a structure from files: NumPy, Matrix Market, Ansys, CalculiX, NASTRAN.

Every reader is text or plain numbers: nothing in a file is executed (no pickles). Binary OP4
is read by `pyyeti`, Ansys' .full by `ansys-mapdl-reader`. A NASTRAN punch file keeps its DMIG
entries, in fields of 8, of 16 or with commas, and every other entry is passed over. What is no
square matrix of real numbers, such as load vectors and tables of nodes, is left and named.
"""

from __future__ import annotations

import gzip
import io
import math
import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from ves_gym._util.optional import require
from ves_gym._util.params import ParameterError
from ves_gym._util.reading import named, read_apart

_PARTS = ("data", "indices", "indptr")  # of a sparse matrix by columns
Label = tuple[int, int]  # node and component 1 to 6 (0: a scalar point)


@dataclass(frozen=True)
class NamedMatrix:
    """A matrix as a file gives it."""

    name: str
    values: Any  # (n, n) sparse
    labels: tuple[Label, ...] | None = None  # (n,) of the freedoms, where the file says
    left: tuple[str, ...] = ()  # what else the file holds, and why it is none


def read_matrices(path: str | os.PathLike[str]) -> dict[str, NamedMatrix]:
    """Read every matrix of a file, by name; a file of one matrix names it after itself."""
    path = Path(path)
    suffix = ".mtx" if path.name.endswith(".mtx.gz") else path.suffix.lower()
    if suffix not in _READERS:
        names = ", ".join([*_READERS, ".mtx.gz"])
        raise ParameterError(f"{path}: expected one of {names}, got {suffix!r}")
    with named(path):
        arrays = read_apart("ves_gym.mechanics.matrix_files:arrays_of", path)
    out = {}
    for k, name in enumerate(arrays["names"].tolist()):
        data, rows, ends = (arrays[f"{part}{k}"] for part in _PARTS)
        size = (len(ends) - 1,) * 2
        labels = tuple(map(tuple, arrays[f"labels{k}"].tolist())) or None
        matrix = scipy.sparse.csc_array((data, rows, ends), size)
        out[name] = NamedMatrix(name, matrix, labels, tuple(arrays["left"].tolist()))
    return out


def arrays_of(path: Path) -> dict[str, Any]:
    """Every matrix of a file as plain arrays, for `read_apart`."""
    suffix = ".mtx" if path.name.endswith(".mtx.gz") else path.suffix.lower()
    try:
        matrices = _READERS[suffix](path)
    except (ParameterError, MemoryError):
        raise
    except Exception as error:  # a damaged file makes a decoder raise nearly anything
        raise ParameterError(f"cannot be read as {suffix}: {error}") from None
    faults = {matrix.name: _fault(matrix.values) for matrix in matrices}
    refused = [f"{name} {fault}" for name, fault in faults.items() if fault]
    matrices = [matrix for matrix in matrices if not faults[matrix.name]]
    if not matrices:
        raise ParameterError(", ".join(refused) or "expected at least one matrix, got none")
    out: dict[str, Any] = {"names": np.array([matrix.name for matrix in matrices])}
    out["left"] = np.array(refused, str)
    for k, matrix in enumerate(matrices):
        sparse = scipy.sparse.csc_array(matrix.values)
        parts = (getattr(sparse, part) for part in _PARTS)
        out |= {f"{part}{k}": array for part, array in zip(_PARTS, parts, strict=True)}
        out[f"labels{k}"] = np.array(matrix.labels or np.zeros((0, 2)), int)
    return out


def _fault(values: Any) -> str:
    """Why values are no matrix of a structure; words of a reader say so themselves."""
    if isinstance(values, str):
        return values
    if values.ndim != 2 or values.shape[0] != values.shape[1]:
        return f"must be square, got {values.shape}"
    if values.dtype.kind not in "fiu":
        return f"must be real, got {values.dtype}"
    return "" if np.isfinite(values.data).all() else "must be finite"


def _stem(path: Path) -> str:
    return path.name.partition(".")[0]


def _numpy(path: Path) -> list[NamedMatrix]:
    loaded = np.load(path, allow_pickle=False)
    if isinstance(loaded, np.ndarray):
        return [NamedMatrix(_stem(path), _sparse(loaded))]
    with loaded:
        if "format" in loaded:  # of scipy.sparse.save_npz
            return [NamedMatrix(_stem(path), _sparse(scipy.sparse.load_npz(path)))]
        return [NamedMatrix(name, _sparse(loaded[name])) for name in loaded.files]


def _matrix_market(path: Path) -> list[NamedMatrix]:
    read = gzip.decompress if path.name.endswith(".gz") else bytes
    data = read(path.read_bytes())
    head, _, body = data.partition(b"\n")
    words = head.decode("latin-1").lower().split()
    if not head.startswith(b"%"):
        return [_abaqus(path, data.decode("ascii"))]
    if "pattern" in words:
        raise ParameterError("must hold numbers, got a pattern")
    if "symmetric" not in words or "coordinate" not in words:
        return [NamedMatrix(_stem(path), _sparse(scipy.io.mmread(io.BytesIO(data))))]
    # as it is written: a reader would take entries of both triangles twice
    plain = re.sub(rb"(?i)symmetric", b"general", head) + b"\n" + body
    half = scipy.sparse.csc_array(scipy.io.mmread(io.BytesIO(plain)))
    if scipy.sparse.tril(half, -1).nnz and scipy.sparse.triu(half, 1).nnz:
        raise ParameterError(
            "says that it is symmetric and has entries on both sides of the diagonal: give one"
            " triangle, or say general"
        )
    parts = half.tocoo()
    return [
        NamedMatrix(_stem(path), _filled(parts.row, parts.col, parts.data, max(half.shape)))
    ]


def _abaqus(path: Path, text: str) -> NamedMatrix:
    """*MATRIX OUTPUT, FORMAT=MATRIX INPUT: node, freedom, node, freedom, value."""
    table = np.loadtxt(text.splitlines(), delimiter=",", ndmin=2, comments="*")
    if table.shape[1] != 5:
        raise ParameterError(
            "expected Matrix Market (%%MatrixMarket), or Abaqus' node, freedom, node, freedom,"
            f" value, got {table.shape[1]} numbers a line"
        )
    ends = [list(map(tuple, table[:, k : k + 2].astype(int).tolist())) for k in (0, 2)]
    labels = sorted({*ends[0], *ends[1]})
    index = {label: i for i, label in enumerate(labels)}
    rows, columns = (np.array([index[label] for label in end]) for end in ends)
    matrix = _filled(rows, columns, table[:, 4], len(labels))
    return NamedMatrix(_stem(path), matrix, tuple(labels))


def _sparse(values: Any) -> Any:
    if getattr(values, "ndim", 0) != 2:
        return f"is no matrix: an array of shape {values.shape}"
    return scipy.sparse.csc_array(values)


def _calculix(path: Path) -> list[NamedMatrix]:
    """*FREQUENCY, SOLVER=MATRIXSTORAGE: lines (row, column, value), NAME.dof beside it."""
    table = np.loadtxt(path, ndmin=2)
    rows, columns = (table[:, k].astype(int) - 1 for k in (0, 1))
    labels = None
    names = path.with_suffix(".dof")
    size = int(max(rows.max(), columns.max())) + 1
    if names.exists():
        words = names.read_text("utf-8").split()
        named = tuple((int(a), int(b)) for a, b in (k.split(".") for k in words))
        size = len(named)
        # knots of expanded beams and shells have names twice: their freedoms go by place
        labels = named if len(set(named)) == size else None
    # either triangle alone, or both
    return [NamedMatrix(path.suffix[1:], _filled(rows, columns, table[:, 2], size), labels)]


def _filled(rows: Any, columns: Any, values: Any, size: int) -> Any:
    """A symmetric matrix, each entry given on both sides of the diagonal or on one."""
    half = scipy.sparse.coo_array((values, (rows, columns)), shape=(size, size)).tocsc()
    present = half.astype(bool)
    return scipy.sparse.csc_array(half + half.T - half.T.multiply(present))


# -------------------------------------------------------------------------------- Ansys

_COMPONENTS = ("UX", "UY", "UZ", "ROTX", "ROTY", "ROTZ")


def _harwell_boeing(path: Path) -> list[NamedMatrix]:
    """HBMAT's text; SciPy reads such files without symmetry and right-hand sides alone."""
    lines = path.read_text("latin-1").splitlines()
    head, sizes = lines[:4], [int(lines[1][k : k + 14] or 0) for k in range(0, 70, 14)]
    count = sum(sizes[1:4])  # lines of pointers, indices and values
    head[1] = "".join(f"{k:14d}" for k in (count, *sizes[1:4], 0))
    symmetric, head[2] = head[2][1:2].upper() == "S", f"{head[2][:1]}U{head[2][2:]}"
    formats = [head[3][a:b] for a, b in ((0, 16), (16, 32), (32, 52))]
    head[3] = "".join(re.sub(r"\d+P,?", "", k).ljust(16) for k in formats)
    start = 4 + (sizes[4] > 0)
    text = "\n".join([*head, *lines[start : start + count], ""]).replace("D", "E")
    matrix = scipy.io.hb_read(io.StringIO(text)).tocoo()
    if symmetric:
        matrix = _filled(matrix.row, matrix.col, matrix.data, max(matrix.shape))
    labels = None
    if (names := path.with_suffix(".mapping")).exists():
        rows = [line.split() for line in names.read_text("latin-1").splitlines()]
        table = [k for k in rows if len(k) == 3 and k[2] in _COMPONENTS]
        labels = tuple((int(node), _COMPONENTS.index(c) + 1) for _, node, c in table)
        if len(labels) != matrix.shape[0]:
            raise ParameterError(
                f"{names.name} names {len(labels)} of {matrix.shape[0]} freedoms"
            )
    return [NamedMatrix(_stem(path), scipy.sparse.csc_array(matrix), labels)]


def _full(path: Path) -> list[NamedMatrix]:
    """Mass and stiffness of a .full file, without the freedoms that are held."""
    require("Ansys' .full", "ansys.mapdl.reader")
    from ansys.mapdl import reader

    file = reader.read_binary(os.fspath(path))
    table, *halves = file.load_km(as_sparse=True)
    constrained = set(map(tuple, file.const.tolist()))  # their rows are left, empty
    free = [k for k, label in enumerate(map(tuple, table.tolist())) if label not in constrained]
    labels = tuple((node, axis + 1) for node, axis in table[free].tolist())
    parts = [half.tocsc()[free][:, free].tocoo() for half in halves]
    return [
        NamedMatrix(name, _filled(x.row, x.col, x.data, len(free)), labels)
        for name, x in zip("KM", parts, strict=True)
    ]


# ------------------------------------------------------------------------- NASTRAN DMIG


_WIDE = 56  # columns of a line with a term in fields of 16


def _dmig(path: Path) -> list[NamedMatrix]:
    forms: dict[str, int] = {}
    terms: dict[str, list[tuple[Label, Label, float]]] = {}
    refused: dict[str, str] = {}  # load vectors and others beside the matrices, and why
    for records in _entries(path):
        name = records[0][1][0].upper()
        for at, (place, fields) in enumerate(records):
            try:
                if at == 0 and name not in forms:  # its header: 0, form, type
                    if int(fields[1]) != 0:
                        raise ValueError(f"DMIG {name} must begin with its header entry")
                    forms[name], terms[name] = int(fields[2]), []
                    if int(fields[3]) not in (1, 2):
                        refused[name] = f"must be real (type 1 or 2), got {fields[3]}"
                    elif forms[name] not in (1, 6):
                        refused[name] = f"must be square (form 1 or 6), got {fields[2]}"
                    break
                if name in refused:
                    break
                if at == 0:
                    column = (int(fields[1]), int(fields[2] or 0))
                for k in range(0 if at else 4, len(fields), 4):
                    if fields[k]:
                        row = (int(fields[k]), int(fields[k + 1] or 0))
                        if not math.isfinite(value := _number(fields[k + 2])):
                            raise ValueError(f"{value:g} is not finite")
                        terms[name].append((row, column, value))
            except ValueError as error:
                got = " ".join(filter(None, fields))
                raise ParameterError(
                    f"line {place}: expected node, component and a finite number of DMIG"
                    f" {name}, got {got!r} ({error})"
                ) from None
    if not forms:
        raise ParameterError(
            "bulk data without DMIG matrices: expected mass and stiffness as DMIG, which"
            " NASTRAN punches (KAAX, MAAX) with EXTSEOUT(STIFFNESS,MASS,DMIGPCH,EXTID=1) in"
            " the case control, or PARAM,EXTOUT,DMIGPCH in the bulk data"
        )
    labels = sorted({k for entry in terms.values() for i, j, _ in entry for k in (i, j)})
    index = {label: i for i, label in enumerate(labels)}
    out = [NamedMatrix(name, why) for name, why in refused.items()]
    for name, entries in terms.items():
        if name in refused:
            continue
        rows = np.array([index[i] for i, _, _ in entries], int)
        columns = np.array([index[j] for _, j, _ in entries], int)
        values = np.array([v for *_, v in entries])
        size = len(labels)
        if forms[name] == 6:
            full = _filled(rows, columns, values, size)
        else:
            full = scipy.sparse.coo_array((values, (rows, columns)), (size, size)).tocsc()
        out.append(NamedMatrix(name, full, tuple(labels)))
    return out


def _entries(path: Path) -> list[list[tuple[int, list[str]]]]:
    """Each DMIG entry: the number and the fields of its first line, keyword left out, and of
    its continuations; 8 or 4 fields a line."""
    entries: list[list[tuple[int, list[str]]]] = []
    open_entry, content = False, path.read_text("ascii", errors="replace")
    for k, raw in enumerate(content.splitlines(), start=1):
        text = raw.split("$")[0].rstrip()
        if not text:
            continue
        head = text[:8].split(",")[0].strip().upper()
        begins = head in ("DMIG", "DMIG*")
        if begins:
            entries.append([])
        open_entry = begins or (open_entry and (head == "" or head[0] in "+*"))
        if open_entry:
            wide = head.endswith("*") or head.startswith("*")
            entries[-1].append((k, _fields(text, wide)))
    ended = open_entry and text and not content.endswith(("\n", "\r"))
    if ended and wide and "," not in text and len(raw) < _WIDE:
        raise ParameterError(
            f"line {k}: expected node, component and number in {_WIDE} columns, got"
            f" {text.strip()!r}, with which the file ends: is it cut off?"
        )
    return entries


def _fields(text: str, wide: bool) -> list[str]:
    count = 4 if wide else 8
    if "," in text:
        fields = text.split(",")[1 : 1 + count]
    else:
        width = 16 if wide else 8
        text = text.expandtabs(8)
        fields = [text[8 + width * k : 8 + width * (k + 1)] for k in range(count)]
    return [k.strip() for k in fields] + [""] * (count - len(fields))


def _number(text: str) -> float:
    """A NASTRAN real: 1.5, 1.5E+3, 1.5D+3 or 1.5+3."""
    text = text.upper().replace("D", "E")
    return float(re.sub(r"(?<=[\d.])([+-])", r"E\1", text))


# -------------------------------------------------------------------------------- OP4


def _op4(path: Path) -> list[NamedMatrix]:
    data = path.read_bytes()
    if b"\0" in data[:64]:
        require("binary OP4", "pyyeti")
        from pyyeti.nastran import op4

        names, matrices, *_ = op4.load(os.fspath(path), into="list", sparse=True)
        converted = map(scipy.sparse.csc_array, matrices)
        return [NamedMatrix(k.upper(), x) for k, x in zip(names, converted, strict=True)]
    lines = data.decode("ascii", errors="replace").splitlines()
    out, at = [], 0
    while at < len(lines) and lines[at].strip():
        matrix, at = _op4_matrix(lines, at)
        out.append(matrix)
    return out


def _op4_matrix(lines: list[str], at: int) -> tuple[NamedMatrix, int]:
    """One matrix and the line after it."""
    head = lines[at]
    columns, rows, _, kind = (int(head[8 * k : 8 * k + 8]) for k in range(4))
    name, layout = head[32:40].strip(), head[40:].strip()
    if kind not in (1, 2):
        raise ValueError(f"OP4 {name} must be real (type 1 or 2), got {kind}")
    match = re.search(r"(\d+)[EDGF](\d+)\.", layout.upper().removeprefix("1P").strip(", "))
    width = int(match.group(2)) if match else 16
    big = rows < 0  # strings of a sparse matrix are headed by two numbers instead of one
    entries: list[tuple[int, int, float]] = []
    at += 1
    while True:
        # the third number counts words, which programs do differently: the lines tell
        column, start, _ = (int(lines[at][8 * k : 8 * k + 8]) for k in range(3))
        at += 1
        if column > columns:  # the end: one number more
            return _op4_whole(name, entries, (abs(rows), columns)), at + _run(lines, at)
        while start > 0 or len(lines[at].split()) <= 2:
            if start <= 0:
                start, at = _op4_string(lines[at], big), at + 1
            count = _run(lines, at)
            if not count:
                raise ValueError(f"line {at + 1}: expected numbers of column {column}")
            values = _op4_values(lines[at : at + count], width)
            entries += [(start - 1 + k, column - 1, v) for k, v in enumerate(values)]
            start, at = 0, at + count


def _op4_whole(
    name: str, entries: list[tuple[int, int, float]], size: tuple[int, int]
) -> NamedMatrix:
    i, j, v = (np.array(k) for k in zip(*entries, strict=True)) if entries else ([], [], [])
    return NamedMatrix(name, scipy.sparse.coo_array((v, (i, j)), size).tocsc())


def _op4_string(record: str, big: bool) -> int:
    """First row of a string of a sparse column."""
    return int(record[8:16]) if big else int(record) % 65536  # row + 65536 (length + 1)


def _run(lines: list[str], at: int) -> int:
    """Number of lines from here on that hold reals; whole numbers have no point."""
    end = at
    while end < len(lines) and "." in lines[end] and "," not in lines[end]:
        end += 1
    return end - at


def _op4_values(lines: list[str], width: int) -> list[float]:
    """Numbers of a fixed width."""
    texts = (text.rstrip() for text in lines)
    return [_number(t[k : k + width].strip()) for t in texts for k in range(0, len(t), width)]


_READERS: dict[str, Callable[[Path], list[NamedMatrix]]] = {
    **dict.fromkeys((".npy", ".npz"), _numpy),
    ".mtx": _matrix_market,
    **dict.fromkeys((".sti", ".mas"), _calculix),
    **dict.fromkeys((".pch", ".dmig", ".bdf"), _dmig),
    ".op4": _op4,
    **dict.fromkeys((".hb", ".rsa", ".rua", ".matrix"), _harwell_boeing),
    ".full": _full,
}
