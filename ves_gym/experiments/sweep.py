"""`sweep`: every unit of a spec is done once; `merge`: one table.

Finished units are those with a sound result file. A sweep that was stopped goes on with the
others; result folders of several machines are one by copying their files together.
"""

from __future__ import annotations

import json
import os
import shutil
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pebble import ProcessExpired

from ves_gym._util.optional import require
from ves_gym._util.params import ParameterError, canonical_json, write_bytes, write_text
from ves_gym._util.process_pool import Workers
from ves_gym.experiments.spec import Spec, read_spec, units_of
from ves_gym.experiments.units import Unit, read_result, run_unit

_LOOK = 0.05  # s between looks at what has ended
_ORDER = ("kind", "where", "who", "seed", "unit")  # of the rows of a merged table

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Report:
    """Outcome of a sweep."""

    folder: Path
    done: list[str] = field(default_factory=list)  # ids of units done now
    skipped: list[str] = field(default_factory=list)  # done before
    failed: dict[str, str] = field(default_factory=dict)  # id -> why

    @property
    def complete(self) -> bool:
        """True if every unit has a result."""
        return not self.failed

    @property
    def summary(self) -> str:
        """Counts of units, in words."""
        done, before, failed = map(len, (self.done, self.skipped, self.failed))
        return f"{done} units done, {before} were done before, {failed} failed: {self.folder}"

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return {**vars(self), "folder": str(self.folder)}


def sweep(
    spec: Spec | str | os.PathLike[str],
    folder: str | os.PathLike[str],
    *,
    workers: int | Executor | None = None,
    resume: bool = True,
    part: tuple[int, int] = (1, 1),
    progress: Progress = lambda stage, done: None,
) -> Report:
    """Do the units of a spec that have no result yet.

    A unit that fails, takes too long or kills its worker is reported; the next sweep tries it
    again.

    Args:
        spec: or the file that holds it, where paths in it start from.
        folder: of the results.
        workers: processes of this machine, default one per processor; or any executor, whose
            `submit(function, *args)` gives something with `done()` and `result()`.
        resume: skip finished units; otherwise they are done again.
        part: (k, n) does every n-th unit from the k-th, for n machines.
        progress: called with what is done and the fraction of it.
    """
    base = Path()
    if not isinstance(spec, Spec):
        base = Path(spec).parent
        spec = read_spec(spec)
    k, n = part
    if not 1 <= k <= n:
        raise ParameterError(f"part must be k of n with 1 <= k <= n, got {k} of {n}")
    units = units_of(spec, base)[k - 1 :: n]
    how: dict[str, Any] = {"workers": workers, "resume": resume, "progress": progress}
    return do_units(units, folder, seconds=spec.seconds, **how)


def do_units(
    units: Iterable[Unit],
    folder: str | os.PathLike[str],
    *,
    workers: int | Executor | None = None,
    resume: bool = True,
    seconds: float | None = None,
    progress: Progress = lambda stage, done: None,
    stage: str = "sweep",
) -> Report:
    """Do those of some units that have no result yet, see `sweep`; `seconds` one may take."""
    report, units = Report(Path(folder)), list(units)
    report.skipped.extend(u.id for u in units if resume and _finished(report.folder, u))
    skipped = set(report.skipped)
    todo = [u for u in units if u.id not in skipped]
    if any(u.identity["kind"] == "train" for u in todo):
        require("training", "safetensors")
    if not todo:
        progress(stage, 1.0)
        return report
    report.folder.mkdir(parents=True, exist_ok=True)
    with opened(workers, seconds, len(todo)) as pool:
        place = str(report.folder.resolve())
        running = [(pool.submit(run_unit, unit, place), unit) for unit in todo]
        while running:  # asked one by one: jobs of submitit are no standard futures
            pending = []
            for job, unit in running:
                if job.done():
                    _enter(job, unit, report)
                    ended = len(skipped) + len(report.done) + len(report.failed)
                    progress(stage, ended / len(units))
                else:
                    pending.append((job, unit))
            running = pending
            time.sleep(_LOOK if running else 0.0)
    return report


@contextmanager
def opened(workers: int | Executor | None, seconds: float | None, most: int) -> Iterator[Any]:
    """Open `most` processes of this machine or fewer, or use the executor that is given."""
    if workers is None or isinstance(workers, int):
        count = os.cpu_count() or 1 if workers is None else workers
        with Workers(min(count, most), seconds=seconds) as pool:
            yield pool
    elif seconds is not None:
        raise ParameterError(
            f"seconds = {seconds:g} is kept by processes of this machine: leave it out, and"
            " give the executor a limit of its own"
        )
    else:
        yield workers


def _enter(job: Any, unit: Unit, report: Report) -> None:
    """Store what a unit came back with, or why it did not."""
    try:
        files = job.result()
    except ProcessExpired as error:
        why = f"its process died (exit code {error.exitcode})"
    except TimeoutError:
        why = "took too long and was killed"
    except Exception as error:
        why = f"{type(error).__name__}: {error}"
    else:
        for name, data in files.items():
            write_bytes(report.folder / name, data)
        shutil.rmtree(report.folder / "work" / unit.id, ignore_errors=True)
        report.done.append(unit.id)
        return
    report.failed[unit.id] = f"{unit.label}: {why}"


def _finished(folder: Path, unit: Unit) -> bool:
    """Return True if a unit has a sound result; a damaged one is not, and a warning says so."""
    path = folder / "results" / f"{unit.id}.json"
    if not path.exists():
        return False
    try:
        read_result(path)
    except ParameterError as error:
        warnings.warn(f"{error}; the unit is done again", stacklevel=3)
        return False
    return True


# ------------------------------------------------------------------------------ merging


def merge(folders: Iterable[str | os.PathLike[str]]) -> list[dict[str, Any]]:
    """Every row of the results in some folders, sorted; the same files give the same rows.

    A row begins with kind, where, who, seed and unit. A damaged file is left out with a
    warning, the others stay readable.

    Raises:
        ParameterError: no results, or two of one unit that differ.
    """
    results: dict[str, dict[str, Any]] = {}
    origin: dict[str, Path] = {}
    for folder in folders:
        paths = sorted((Path(folder) / "results").glob("*.json"))
        if not paths:
            raise ParameterError(f"{folder}: expected the folder of a sweep with results in it")
        for path in paths:
            try:
                result = read_result(path)
            except ParameterError as error:
                warnings.warn(f"{error}; left out", stacklevel=2)
                continue
            id = result["id"]
            if results.setdefault(id, result) != result:
                raise ParameterError(
                    f"{origin[id]} and {path}: two results of one unit that differ"
                )
            origin.setdefault(id, path)
    rows = []
    for id, result in results.items():
        unit = result["unit"]
        head = {k: unit[k] for k in _ORDER[:-1]} | {"unit": id}
        rows += [{**head, "row": k, **_beside(row)} for k, row in enumerate(result["rows"])]
    return sorted(rows, key=lambda row: (*(row[k] for k in _ORDER), row["row"]))


def _beside(row: dict[str, Any]) -> dict[str, Any]:
    """A row's entries; those named like a unit's keep their name with `row_` before it."""
    taken = {*_ORDER, "row"}
    return {f"row_{k}" if k in taken else k: v for k, v in row.items()}


def write_rows(path: str | os.PathLike[str], rows: Sequence[dict[str, Any]]) -> None:
    """Write merged rows as .jsonl or .parquet (nested entries as JSON text), atomically."""
    path = Path(path)
    if path.suffix == ".jsonl":
        write_text(path, "".join(canonical_json(row) + "\n" for row in rows))
        return
    if path.suffix != ".parquet":
        raise ParameterError(f"{path}: expected a .jsonl or .parquet name, got {path.suffix!r}")
    require("Parquet", "pyarrow")
    import pyarrow
    import pyarrow.parquet

    names = list(dict.fromkeys(name for row in rows for name in row))
    table = pyarrow.table({name: [_flat(row.get(name)) for row in rows] for name in names})
    sink = pyarrow.BufferOutputStream()
    pyarrow.parquet.write_table(table, sink)
    write_bytes(path, sink.getvalue().to_pybytes())


def _flat(value: Any) -> Any:
    return json.dumps(value, sort_keys=True) if isinstance(value, dict | list) else value
