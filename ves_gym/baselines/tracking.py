"""`Tracking`: learning curves in TensorBoard and Weights & Biases while a run learns.

Both show what `curve.jsonl` holds, row by row. `validation/` are the episodes that a policy is
judged by, `train/` the exploring ones since the row before, `learner/` figures of the last
update, `time/` seconds.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from ves_gym._util.optional import require
from ves_gym._util.params import ParameterError
from ves_gym.baselines.config import TrainConfig


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
    def open(self, config: TrainConfig, seed: int, folder: Path) -> Iterator[list[Tracker]]:
        """Open the trackers of one run, and close them after it.

        Args:
            config: of the training.
            seed: of the run.
            folder: of the run, where W&B keeps its copy.
        """
        with ExitStack() as stack:
            trackers: list[Tracker] = []
            if self.tensorboard:
                events = Path(self.tensorboard) / config.name / f"seed-{seed}"
                trackers.append(stack.enter_context(_tensorboard(events)))
            if self.wandb:
                trackers.append(stack.enter_context(_wandb(self.wandb, config, seed, folder)))
            yield trackers


NOWHERE = Tracking()


class Tracker(Protocol):
    """A program that shows one run."""

    def start(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Take the rows of a run that goes on; a new one has none."""

    def add(self, row: Mapping[str, Any]) -> None:
        """Take the newest row of the curve."""


def scalars(row: Mapping[str, Any]) -> dict[str, float]:
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


class _TensorBoard:
    def __init__(self, writer: Any, shown: bool) -> None:
        self.writer, self.shown = writer, shown

    def start(self, rows: Sequence[Mapping[str, Any]]) -> None:
        if not self.shown:  # else the rows before the checkpoint are in the folder
            for row in rows:
                self.add(row)

    def add(self, row: Mapping[str, Any]) -> None:
        for tag, value in scalars(row).items():
            self.writer.add_scalar(tag, value, row["steps"])
        self.writer.flush()


@contextmanager
def _tensorboard(folder: Path) -> Iterator[_TensorBoard]:
    from tensorboard.summary import Writer

    shown = any(folder.glob("events.*"))
    writer = Writer(str(folder))
    try:
        yield _TensorBoard(writer, shown)
    finally:
        writer.close()


class _Wandb:
    def __init__(self, run: Any) -> None:
        self.run = run

    def start(self, rows: Sequence[Mapping[str, Any]]) -> None:
        for row in rows:  # each start is a run of its own there, with the whole curve
            self.add(row)

    def add(self, row: Mapping[str, Any]) -> None:
        self.run.log(scalars(row), step=row["steps"])


@contextmanager
def _wandb(project: str, config: TrainConfig, seed: int, folder: Path) -> Iterator[_Wandb]:
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
    failed = True
    try:
        yield _Wandb(run)
        failed = False
    finally:
        run.finish(exit_code=int(failed))
