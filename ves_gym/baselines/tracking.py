"""Learning curves in TensorBoard while a run learns.

They are what `curve.jsonl` holds, row by row. `validation/` are the episodes that a policy is
judged by, `train/` the exploring ones since the row before, `learner/` figures of the last
update, `time/` seconds. Other programs read TensorBoard's files: `wandb sync DIR` takes them
to Weights & Biases.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ves_gym._util.optional import require
from ves_gym._util.params import ParameterError

Row = Mapping[str, Any]  # of a learning curve


def require_tensorboard(folder: str | os.PathLike[str]) -> None:
    """Do nothing if curves can be written to a folder.

    Raises:
        MissingPackageError: TensorBoard is not installed.
        ParameterError: the folder is a file.
    """
    require("a curve in TensorBoard", "tensorboard")
    if Path(folder).is_file():
        raise ParameterError(f"tensorboard must be a folder, got the file {folder}")


def scalars(row: Row) -> dict[str, float]:
    """Return the numbers of a row of a learning curve by tag, empty ones left out."""
    tagged = {f"learner/{name}": value for name, value in row["train"].items()}
    for name, value in row.items():
        if name.startswith("train_"):
            tagged[f"train/{name.removeprefix('train_')}"] = value
        elif name.startswith("seconds"):
            tagged[f"time/{name}"] = value
        elif name not in ("steps", "train"):
            tagged[f"validation/{name}"] = value
    return {tag: float(value) for tag, value in tagged.items() if value is not None}


@contextmanager
def event_writer(folder: Path, rows: Sequence[Row]) -> Iterator[Callable[[Row], None]]:
    """Open a folder for the curve of one run, and close it after it.

    Args:
        folder: for TensorBoard's files.
        rows: of a run that goes on; a new one has none.
    """
    from tensorboard.summary import Writer

    resumed = any(folder.glob("events.*"))  # then the rows before the checkpoint are there
    writer = Writer(str(folder))

    def add(row: Row) -> None:
        for tag, value in scalars(row).items():
            writer.add_scalar(tag, value, row["steps"])
        writer.flush()

    try:
        for row in () if resumed else rows:
            add(row)
        yield add
    finally:
        writer.close()
