"""`ves-gym sweep`, `matrix`, `search`, `merge`: many units of work, and what came of them."""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from pathlib import Path
from typing import Any

from ves_gym._util.optional import require
from ves_gym._util.params import write_text
from ves_gym.cli.flags import WORKERS, Answer, Context, Flag, integer, path, read, say
from ves_gym.experiments import sweep as sweeps
from ves_gym.experiments.sweep import Report

_FAILURES = 10  # that are printed


def _part(value: str) -> tuple[int, int]:
    k, n = (int(word) for word in value.split("/"))
    return k, n


def sweep(at: Context, spec: Path, *, again: bool = False, **how: Any) -> Answer:
    """Do every unit of a spec once, merge; negative if a unit failed."""
    folder = at.folder(Path("out/sweep", spec.stem))
    report = sweeps.sweep(spec, folder, resume=not again, progress=at.progress, **how)
    rows = sweeps.merge([folder]) if report.done or report.skipped else []
    if rows:
        sweeps.write_rows(folder / "rows.jsonl", rows)
    _say_failures(report)
    plain = {"schema": "ves-sweep/1", **report.to_dict(), "rows": len(rows)}
    return Answer(text=report.summary, plain=plain, negative=not report.complete)


def _say_failures(report: Report) -> None:
    for why in list(report.failed.values())[:_FAILURES]:
        say(why, "failed")


def matrix(
    at: Context,
    file: Path,
    *,
    episodes: int | None = None,
    seeds: int | None = None,
    **how: Any,
) -> Answer:
    """Do what has no result yet; write the page once all of it is there."""
    from ves_gym.experiments.matrix import cells, entries, read_matrix, run_matrix
    from ves_gym.report.matrix_page import matrix_page

    stated = read_matrix(file)
    matrix = dataclasses.replace(
        stated,
        episodes=stated.episodes if episodes is None else episodes,
        seeds=stated.seeds[:seeds],
    )
    folder, chosen = at.folder(Path("out/matrix", file.stem)), cells(matrix, file.parent)
    report = run_matrix(matrix, chosen, folder, progress=at.progress, **how)
    _say_failures(report)
    results = entries(chosen, folder) if report.complete else []
    files = [folder / "matrix.md"] if report.complete else []
    for page in files:
        title = "Methods on machines that are not as described"
        write_text(page, matrix_page(matrix, results, title))
    plain = {
        "schema": "ves-matrix/1",
        **report.to_dict(),
        "entries": [_plain(entry) for entry in results],
    }
    return Answer(text=report.summary, plain=plain, files=files, negative=not report.complete)


def _plain(entry: Any) -> dict[str, Any]:
    """Figures as plain data; what is infinite becomes null."""
    return {
        name: [x if math.isfinite(x) else None for x in value]
        if isinstance(value, tuple)
        else value
        for name, value in vars(entry).items()
    }


def search(at: Context, spec: Path, **how: Any) -> Answer:
    """Search; negative if every trial failed."""
    from ves_gym.experiments.search import search

    folder = at.folder(Path("out/search", spec.stem))
    result = search(spec, folder, seed=at.seed, progress=at.progress, **how)
    for trial in result.trials:
        if trial["state"] == "fail":
            say(f"trial {trial['number']}: {trial['why']}", "failed")
    plain = {"folder": str(folder), **result.to_dict()}
    return Answer(text=result, plain=plain, negative=result.best is None)


def merge(at: Context, folder: tuple[str, ...], *, parquet: bool = False) -> Answer:
    """Merge and write the rows, sorted: the same results give the same file."""
    if parquet:
        require("Parquet", "pyarrow")
    rows = sweeps.merge(folder)
    path = at.folder("out/merge") / ("rows.parquet" if parquet else "rows.jsonl")
    sweeps.write_rows(path, rows)
    units = {row["unit"] for row in rows}
    kinds = dict(Counter(row["kind"] for row in rows))
    plain = {"schema": "ves-merge/1", "path": str(path), "units": len(units), "rows": kinds}
    return Answer(text=f"{len(rows)} rows of {len(units)} units", plain=plain, files=[path])


TABLE = {
    "sweep": (sweep, (
        Flag("SPEC", read=path, help="a .toml file (docs/sweeps.md)"),
        WORKERS,
        Flag("--again", help="do finished units again (default: skip them)"),
        Flag("--part", "K/N", read(_part, "K/N, like 1/4"), "every N-th unit from the K-th"),
    )),
    "matrix": (matrix, (
        Flag("FILE", read=path, help="a .toml file (docs/sweeps.md)"),
        Flag("--episodes", "N", integer(), "instead of the file's"),
        Flag("--seeds", "N", integer(), "only the first N of the file's"),
        WORKERS,
    )),
    "search": (search, (
        Flag("SPEC", read=path, help="a .toml file with a table [search] (docs/sweeps.md)"),
        WORKERS,
    )),
    "merge": (merge, (
        Flag("FOLDER", help="that `ves-gym sweep` made", many=True),
        Flag("--parquet", help="write rows.parquet instead of rows.jsonl"),
    )),
}  # fmt: skip
