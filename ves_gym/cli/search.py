"""`ves-gym search`: the settings of a sweep that do best, found with Optuna."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ves_gym.cli.flags import Answer, Flag, path, say
from ves_gym.cli.sweep import WORKERS

FLAGS = (
    Flag("SPEC", read=path, help="a .toml file with a table [search] (docs/sweeps.md)"),
    WORKERS,
)


def run(
    spec: Path, *, out: Path | None = None, seed: int = 0, progress: Any = None, **how: Any
) -> Answer:
    """Search; negative if every trial failed."""
    from ves_gym.experiments.search import search

    folder = out or Path("out/search", spec.stem)
    result = search(spec, folder, seed=seed, progress=progress, **how)
    for trial in result.trials:
        if trial["state"] == "fail":
            say(f"trial {trial['number']}: {trial['why']}", "failed")
    plain = {"folder": str(folder), **result.to_dict()}
    return Answer(text=result, plain=plain, negative=result.best is None)
