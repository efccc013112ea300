"""The record of one run, shared by simulation, real test beds, metrics and diagnosis.

On disk: `NAME.parquet` (metadata as JSON under the schema key `ves_gym`), or `NAME.csv`
with `NAME.json` beside it. Reading is strict: a fault names file, row and column, and
nothing is guessed or repaired. Rows count from 1, without the CSV header.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ves_gym._util.optional import require
from ves_gym._util.params import Array, canonical_json, write_bytes
from ves_gym._util.reading import named
from ves_gym._util.views import Viewable
from ves_gym.system.runlog_files import (
    AXES,
    BASE,
    BODY,
    DIGEST_KEY,
    DIMENSIONS,
    JOINT,
    META_KEY,
    MODE,
    ONE,
    POSE,
    QUANTITIES,
    WHEEL,
    RunLogError,
    load_pyarrow,
    read_bytes,
    read_csv,
    read_json,
    read_parquet,
    short,
    suffix_of,
    write_pair,
)

if TYPE_CHECKING:
    import pandas
    import xarray

FORMAT = "ves-run/1"
OPTIONAL = tuple(k for k, (_, required) in QUANTITIES.items() if not required)

# metadata table -> {vector: one number per joint (else one per base coordinate)}
_VECTORS = {
    "controller": {"kp": True, "kd": True},
    "initial": {"q": True, "v": True, "y": False, "yd": False},
}


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class RunLog(Viewable):
    """One run of n joints on a base, N samples; float64, SI, arrays are read-only copies.

    Logs compare by `digest`. The metadata needs `{"format": "ves-run/1"}`; `system`,
    `controller`, `initial`, `noise_std` (tables) and `note` (text) are checked where
    present, and so is `duration`, that of the commanded motion [s]; further entries pass.

    Raises:
        RunLogError: shapes disagree, a value is not a finite number, t does not increase
            strictly, fewer than 2 samples, or metadata that JSON cannot hold.
    """

    t: Array  # (N,) s, strictly increasing
    q_cmd: Array  # (N, n) rad, commanded
    v_cmd: Array  # (N, n) rad/s, commanded
    q: Array  # (N, n) rad, measured
    y: Array  # (N, 6) m, rad: base or platform pose, measured
    meta: Mapping[str, Any]  # plain JSON data; a copy
    v: Array | None = None  # (N, n) rad/s, measured
    tau: Array | None = None  # (N, n) N m, motor torque
    # (N, n) N m, in it, sent ahead by a controller that foresees how the base will move
    tau_ff: Array | None = None
    y_cmd: Array | None = None  # (N, 6) m, rad
    yd: Array | None = None  # (N, 6) m/s, rad/s: d/dt of y, where it is measured
    w: Array | None = None  # (N, 6) N, N m: force sensor; on Earth it contains the weight
    wg: Array | None = None  # (N, 6) N, N m: w with the gravity estimate subtracted
    # (N, m) wheels, appendages, internal modes of the base: a simulation's, never measured
    u: Array | None = None
    ud: Array | None = None  # (N, m) d/dt of u
    motor: Array | None = None  # (N, w) N m, of a satellite's wheels, held to the next sample
    jet: Array | None = None  # (N, 6) N, N m, wrench of its jets, platform axes, held likewise
    propellant: Array | None = None  # (N, 1) kg, used since the start
    p: Array | None = None  # (N, 7) payload: place of its origin [m], unit quaternion
    pd: Array | None = None  # (N, 6) velocity of its centre of mass, spin in its own axes
    contact: Array | None = None  # (N, 6) N, N m: on the tool, about it, inertial axes
    contact_energy: Array | None = None  # (N, 1) J, stored in the contacts' springs

    def __post_init__(self) -> None:
        store = object.__setattr__  # the dataclass is frozen
        t = _numbers(self.t, "t")
        if t.ndim != 1 or len(t) < 2:
            raise RunLogError(f"t: expected shape (N,) with N >= 2 samples, got {t.shape}")
        q = _numbers(self.q, "q")
        if q.ndim != 2 or q.shape[1] < 1:
            raise RunLogError(f"q: expected shape (N, n) with n >= 1 joints, got {q.shape}")
        _check_time(t)
        store(self, "t", t)
        modes = next((np.shape(k)[-1:] for k in (self.u, self.ud) if k is not None), ())
        wheels = np.shape(self.motor)[-1:] if self.motor is not None else ()
        sizes = {
            JOINT: q.shape[1],
            POSE: BASE,
            MODE: modes[0] if modes else 1,
            WHEEL: wheels[0] if wheels else 1,
            ONE: 1,
            BODY: 7,
        }
        for name, (axis, required) in QUANTITIES.items():
            value = getattr(self, name)
            if value is None and not required:
                continue
            array = _numbers(value, name)
            shape = (len(t), sizes[axis])
            if array.shape != shape:
                raise RunLogError(f"{name}: expected shape {shape}, got {array.shape}")
            _check_finite(array, [f"{name}_{i + 1}" for i in range(shape[1])])
            store(self, name, array)
        store(self, "meta", _checked_meta(self.meta, q.shape[1]))

    def __len__(self) -> int:
        """Number of samples N."""
        return len(self.t)

    def __repr__(self) -> str:
        return f"<RunLog: {self.summary()}>"

    @property
    def n_joints(self) -> int:
        """Number of joints n."""
        return int(self.q.shape[1])

    @property
    def duration(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.t[-1]) - float(self.t[0])

    @property
    def digest(self) -> str:
        """SHA-256 (hex) of columns and metadata; the same for either file format."""
        sha = hashlib.sha256(canonical_json(self.meta).encode())
        for name, column in self.columns().items():
            sha.update(f"\n{name} {len(column)}\n".encode())
            sha.update(column.astype("<f8").tobytes())
        return sha.hexdigest()

    def columns(self) -> dict[str, Array]:
        """Name -> (N,) column, in the order they have on disk."""
        out = {"t": self.t}
        for name in QUANTITIES:
            array = getattr(self, name)
            if array is not None:
                out |= {f"{name}_{i + 1}": array[:, i] for i in range(array.shape[1])}
        return out

    def to_dataframe(self) -> pandas.DataFrame:
        """Return the columns as a pandas table over `t` [s]; the metadata is in `attrs`.

        Raises:
            MissingPackageError: pandas is not installed.
        """
        require("RunLog.to_dataframe", "pandas")
        import pandas

        columns = self.columns()
        index = pandas.Index(columns.pop("t"), name="t")
        out = pandas.DataFrame(columns, index=index)
        out.attrs = {"meta": dict(self.meta)}
        return out

    def to_xarray(self) -> xarray.Dataset:
        """Return the quantities (t, joint), (t, axis) and so on as an xarray data set.

        Joints count from 1; axes are x, y, z, phi_x, phi_y, phi_z. The metadata is JSON in
        the attribute `ves_gym`, as in Parquet files.

        Raises:
            MissingPackageError: xarray is not installed.
        """
        require("RunLog.to_xarray", "xarray")
        import xarray

        names = {k: axis for k, (axis, _) in QUANTITIES.items() if getattr(self, k) is not None}
        arrays = {
            k: (["t"], getattr(self, k)[:, 0])
            if axis == ONE
            else (["t", DIMENSIONS[axis]], getattr(self, k))
            for k, axis in names.items()
        }
        coordinates: dict[str, Any] = {"t": self.t, "joint": np.arange(1, self.n_joints + 1)}
        if POSE in names.values():
            coordinates["axis"] = list(AXES)
        return xarray.Dataset(arrays, coordinates, {META_KEY: canonical_json(self.meta)})

    def summary(self) -> str:
        """One line for people: size, clock, optional quantities, note."""
        has = [k for k in OPTIONAL if getattr(self, k) is not None]
        note = str(self.meta.get("note", ""))
        return (
            f"{len(self)} samples over {self.duration:g} s (mean step"
            f" {self.duration / (len(self) - 1):g} s), {self.n_joints} joints, with"
            f" {', '.join(has) or 'no optional columns'}" + (f"; {note}" if note else "")
        )

    def slice(self, t0: float, t1: float) -> RunLog:
        """The samples with t0 <= t <= t1 [s], on the same clock.

        Where the first sample goes, the metadata follows: `initial` becomes what the log
        holds at the new first sample, `duration` what is left of the motion.

        Raises:
            RunLogError: fewer than 2 samples lie in the window.
        """
        inside = np.flatnonzero((self.t >= t0) & (self.t <= t1))
        if len(inside) < 2:
            raise RunLogError(
                f"slice: expected at least 2 samples in [{t0}, {t1}] s, got {len(inside)}"
                f" of a log from {self.t[0]} to {self.t[-1]} s"
            )
        first, stop = int(inside[0]), int(inside[-1]) + 1
        cut = {k: a for k in QUANTITIES if (a := getattr(self, k)) is not None}
        meta = dict(self.meta)
        if first > 0:
            meta["initial"] = {
                k: cut[k][first].tolist() for k in ("q", "v", "y", "yd") if k in cut
            }
            if "duration" in meta:
                gone = float(self.t[first]) - float(self.t[0])
                meta["duration"] = max(0.0, meta["duration"] - gone)
        rows = {k: a[first:stop] for k, a in cut.items()}
        return replace(self, t=self.t[first:stop], meta=meta, **rows)

    # ----------------------------------------------------------------------- files

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write `.parquet`, or `.csv` with `.json` beside it: completely or not at all.

        Every float64 survives exactly. Missing folders are made.

        Raises:
            RunLogError: another suffix, or pyarrow is missing for `.parquet`.
            OSError: the files cannot be written; those that were there are unchanged.
        """
        path = Path(path)
        if suffix_of(path) == ".parquet":
            write_bytes(path, self._parquet(path))
            return
        columns = self.columns()
        lines = [",".join(columns)]
        table = np.column_stack(list(columns.values())).tolist()
        lines += [",".join(map(repr, row)) for row in table]  # repr: shortest exact text
        meta = json.dumps(self.meta, indent=1, allow_nan=False) + "\n"
        write_pair(path.with_suffix(".json"), meta, path, "\n".join(lines) + "\n")

    def _parquet(self, path: Path) -> bytes:
        pa, pq = load_pyarrow(path)
        table = pa.table(self.columns())
        # Pages carry checksums, but the footer (row counts, offsets) has only this digest.
        keys = {META_KEY: canonical_json(self.meta), DIGEST_KEY: self.digest}
        table = table.replace_schema_metadata(keys)
        sink = io.BytesIO()
        pq.write_table(table, sink, compression="zstd", write_page_checksum=True)
        return sink.getvalue()

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> RunLog:
        """Read what `save` or a test bed wrote; the columns may come in any order.

        Raises:
            RunLogError: anything at all is wrong with the file; the message begins with
                its name and, where they apply, gives row and column.
        """
        path = Path(path)
        if suffix_of(path) == ".parquet":
            with named(path, RunLogError):
                columns, meta, digest = read_parquet(path)
        else:
            digest = None
            with named(path, RunLogError):
                columns = read_csv(path)
            with named(path.with_suffix(".json"), RunLogError):
                meta = read_json(read_bytes(path.with_suffix(".json")))
        with named(path, RunLogError):
            log = cls(**columns, meta=meta)
            if digest is not None and log.digest != digest:
                raise RunLogError(
                    f"expected contents with the digest {digest} in the file, got {log.digest}"
                    f" (damaged, or edited without removing the key {DIGEST_KEY!r})"
                )
            return log


# ---------------------------------------------------------------------------- checks


def _numbers(value: object, name: str) -> Array:
    """A read-only float64 copy; text, truth values and ragged lists are errors."""
    try:
        raw = np.asarray(value)
    except ValueError:
        raise RunLogError(f"{name}: expected an array of numbers, got ragged rows") from None
    if raw.dtype.kind not in "fiu":
        raise RunLogError(
            f"{name}: expected an array of numbers, got {type(value).__name__} of {raw.dtype}"
        )
    array = np.array(raw, dtype=np.float64, order="C")
    array.setflags(write=False)
    return array


def _check_finite(array: Array, names: Sequence[str]) -> None:
    bad = np.argwhere(~np.isfinite(array))
    if len(bad):
        row, column = (int(k) for k in bad[0])
        raise RunLogError(
            f"row {row + 1}, column {names[column]}: expected a finite number,"
            f" got {array[row, column]}"
        )


def _check_time(t: Array) -> None:
    _check_finite(t[:, None], ["t"])
    late = np.flatnonzero(t[1:] <= t[:-1])
    if len(late):
        i = int(late[0])
        raise RunLogError(
            f"row {i + 2}, column t: expected more than {t[i]} s (row {i + 1}), got {t[i + 1]}"
        )


def _checked_meta(meta: object, n: int) -> dict[str, Any]:
    """Plain copy of the metadata of a log with n joints."""
    if not isinstance(meta, Mapping):
        raise RunLogError(f"metadata: expected a table, got {type(meta).__name__}")
    if meta.get("format") != FORMAT:
        got = short(meta["format"]) if "format" in meta else "none"
        raise RunLogError(f"metadata.format: expected {FORMAT!r}, got {got}")
    try:
        plain: dict[str, Any] = _json_data(meta, "metadata")
        canonical_json(plain)
    except RunLogError:
        raise
    except (RecursionError, ValueError) as error:  # circular, too deep, or endless integers
        raise RunLogError(f"metadata: expected what JSON can hold, got {error}") from None
    for key in ("system", "controller", "initial", "noise_std"):
        table = plain.get(key, {})
        if not isinstance(table, dict):
            raise RunLogError(f"metadata.{key}: expected a table, got {short(table)}")
        for name, per_joint in _VECTORS.get(key, {}).items():
            size = n if per_joint else BASE
            vector = table.get(name, [0.0] * size)
            if not isinstance(vector, list) or list(map(_is_number, vector)) != [True] * size:
                raise RunLogError(
                    f"metadata.{key}.{name}: expected {size} numbers, got {short(vector)}"
                )
    if not isinstance(plain.get("note", ""), str):
        raise RunLogError(f"metadata.note: expected text, got {short(plain['note'])}")
    duration = plain.get("duration", 0.0)
    if not _is_number(duration) or duration < 0:
        raise RunLogError(f"metadata.duration: expected seconds >= 0, got {short(duration)}")
    return plain


def _is_number(value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return False
    return abs(value) <= sys.float_info.max  # an integer may lie beyond every float


def _json_data(value: Any, where: str) -> Any:
    """Copy that JSON gives back unchanged (tuples become lists), or an error with its key."""
    if isinstance(value, Mapping):
        for key in value:
            if not isinstance(key, str):
                raise RunLogError(f"{where}: expected keys that are text, got {short(key)}")
        return {key: _json_data(item, f"{where}.{key}") for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_json_data(item, f"{where}[{i}]") for i, item in enumerate(value)]
    if isinstance(value, float) and not math.isfinite(value):
        raise RunLogError(f"{where}: expected a finite number, got {float(value)}")
    for kind in (bool, int, float, str):
        if isinstance(value, kind):
            return kind(value)  # NumPy's float64 and str_ are subclasses
    if value is None:
        return None
    raise RunLogError(
        f"{where}: expected JSON data (number, text, list, table), got {type(value).__name__}"
    )
