"""`Tracking`: learning curves in TensorBoard and Weights & Biases while a run learns.

Both show what `curve.jsonl` holds, row by row. `validation/` are the episodes that a policy is
judged by, `train/` the exploring ones since the row before, `learner/` figures of the last
update, `time/` seconds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ves_gym._util.optional import require
from ves_gym._util.params import ParameterError
from ves_gym.baselines.config import TrainConfig

Row = Mapping[str, Any]  # of a learning curve
Tracker = Callable[[Row], None]  # shows the newest row


@dataclass(frozen=True, kw_only=True)
class Tracking:
    """Programs that show the curves of a training beside its own files; by default none."""

    tensorboard: str = ""  # folder; the curve of a seed goes to NAME/seed-N in it
    wandb: str = ""  # project; a run per seed, in the group NAME

    def require(self) -> None:
        """Do nothing if a training can be shown so.

        Raises:
            MissingPackageError: the program is not installed.
            ParameterError: the folder is a file.
        """
        if self.tensorboard:
            require("a curve in TensorBoard", "tensorboard")
            if Path(self.tensorboard).is_file():
                raise ParameterError(
                    f"tensorboard must be a folder, got the file {self.tensorboard}"
                )
        if self.wandb:
            require("a curve in W&B", "wandb")

    @contextmanager
    def open(
        self, config: TrainConfig, seed: int, folder: Path, rows: Sequence[Row]
    ) -> Iterator[list[Tracker]]:
        """Open the trackers of one run, and close them after it.

        Args:
            config: of the training.
            seed: of the run.
            folder: of the run, where W&B keeps its copy.
            rows: of a run that goes on; a new one has none.
        """
        with ExitStack() as stack:
            trackers: list[Tracker] = []
            if self.tensorboard:
                events = Path(self.tensorboard) / config.name / f"seed-{seed}"
                trackers.append(stack.enter_context(_tensorboard(events, rows)))
            if self.wandb:
                run = _wandb(self.wandb, config, seed, folder, rows)
                trackers.append(stack.enter_context(run))
            yield trackers


NOWHERE = Tracking()


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
def _tensorboard(folder: Path, rows: Sequence[Row]) -> Iterator[Tracker]:
    from tensorboard.summary import Writer

    shown = any(folder.glob("events.*"))  # then the rows before the checkpoint are there
    writer = Writer(str(folder))

    def add(row: Row) -> None:
        for tag, value in scalars(row).items():
            writer.add_scalar(tag, value, row["steps"])
        writer.flush()

    try:
        for row in () if shown else rows:
            add(row)
        yield add
    finally:
        writer.close()


@contextmanager
def _wandb(
    project: str, config: TrainConfig, seed: int, folder: Path, rows: Sequence[Row]
) -> Iterator[Tracker]:
    import wandb

    try:
        run = wandb.init(
            project=project,
            group=config.name,
            name=f"{config.name} seed {seed}",
            dir=str(folder),
            config={**config.to_dict(), "seeds": [seed]},
            reinit="finish_previous",
        )
    except wandb.Error as error:
        raise ParameterError(
            f"wandb does not start: {str(error).splitlines()[0]}; run `wandb login`, or set"
            " WANDB_MODE=offline"
        ) from error

    def add(row: Row) -> None:
        run.log(scalars(row), step=row["steps"])

    failed = True
    try:
        for row in rows:  # each start is a run of its own there, with the whole curve
            add(row)
        yield add
        failed = False
    finally:
        run.finish(exit_code=int(failed))
