"""`ves-gym matrix`: methods x machines x tasks x seeds, one page with intervals."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

from ves_gym._util.params import write_text
from ves_gym.cli.files import FORMAT
from ves_gym.cli.flags import Answer, Flag, integer, path
from ves_gym.cli.sweep import WORKERS, say_failures

SCHEMA = "ves-matrix/1"
FLAGS = (
    Flag("FILE", read=path, help="a .toml file (docs/sweeps.md)"),
    Flag("--episodes", "N", integer(), "instead of the file's"),
    Flag("--seeds", "N", integer(), "only the first N of the file's"),
    Flag("--steps", "N", integer(), "of every training, instead of its own"),
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
    results = entries(matrix, folder) if report.complete else []
    files = []
    if report.complete:
        title = "Methods on machines that are not as described"
        files.append(folder / "matrix.md")
        write_text(files[0], matrix_page(matrix, results, title))
    plain = {"schema": SCHEMA, **report.to_dict(), "entries": [_plain(k) for k in results]}
    return Answer(
        text="" if partial else report.summary,
        plain=plain,
        files=files,
        figures=(lambda: {folder / "crossover": crossover_figure(matrix, results)})
        if files
        else None,
        negative=not report.complete,
    )


def _plain(entry: Any) -> dict[str, Any]:
    """Figures as plain data; what is infinite becomes null."""
    return {
        name: [x if math.isfinite(x) else None for x in value]
        if isinstance(value, tuple)
        else value
        for name, value in vars(entry).items()
    }
