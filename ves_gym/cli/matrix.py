"""`ves-gym matrix`: methods x machines x tasks x seeds, one page with intervals."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

from ves_gym._util.optional import installed
from ves_gym._util.params import write_text
from ves_gym.cli.files import FORMAT
from ves_gym.cli.flags import Answer, Flag, path, whole
from ves_gym.cli.sweep import WORKERS, say_failures

SCHEMA = "ves-matrix/1"
FLAGS = (
    Flag("FILE", read=path, help="a .toml file (docs/sweeps.md)"),
    Flag("--episodes", "N", whole(), "instead of the file's"),
    Flag("--seeds", "N", whole(), "only the first N of the file's"),
    Flag("--steps", "N", whole(), "of every training, instead of its own"),
    Flag("--partial",
         help="run nothing: page and picture of the cells that have all their results"),
    FORMAT,
    WORKERS,
)  # fmt: skip


def run(
    file: Path,
    *,
    episodes: int | None = None,
    seeds: int | None = None,
    steps: int | None = None,
    partial: bool = False,
    format: str = "png",
    out: Path | None = None,
    progress: Any = None,
    **how: Any,
) -> Answer:
    """Do what has no result yet; write page, picture and figures of what is complete."""
    from ves_gym.experiments.matrix import entries, read_matrix, run_matrix, shortened
    from ves_gym.experiments.sweep import Report
    from ves_gym.report.matrix_page import crossover_figure, matrix_page

    stated = read_matrix(file)
    matrix = dataclasses.replace(
        stated,
        episodes=stated.episodes if episodes is None else episodes,
        seeds=stated.seeds[:seeds],
        tasks=stated.tasks if steps is None else shortened(stated, steps),
    )
    folder = out or Path("out/matrix", file.stem)
    report = Report(folder) if partial else run_matrix(matrix, folder, progress=progress, **how)
    say_failures(report)
    files, results = [], []
    if report.complete:
        results = entries(matrix, folder)
        title = "Methods on machines that are not as described"
        files.append(folder / "matrix.md")
        write_text(files[0], matrix_page(matrix, results, title))
        if installed("matplotlib"):
            from ves_gym.report.figures import write_figure

            files.append(folder / f"crossover.{format}")
            write_figure(crossover_figure(matrix, results), files[-1])
    plain = {"schema": SCHEMA, **report.to_dict(), "entries": [_plain(k) for k in results]}
    said = "" if partial else report.summary
    return Answer(text=said, plain=plain, files=files, negative=not report.complete)


def _plain(entry: object) -> dict[str, object]:
    """Figures as plain data; what is infinite becomes null."""
    out: dict[str, object] = {}
    for field in dataclasses.fields(entry):  # type: ignore[arg-type]
        value = getattr(entry, field.name)
        if isinstance(value, tuple):
            value = [x if abs(x) < float("inf") else None for x in value]
        out[field.name] = value
    return out
