"""`train`: training runs, how they survive being killed, and `TrainingResult`.

A run's folder holds `curve.jsonl` (one line per evaluation), the best and the last policy in
the safe format, and `checkpoint.safetensors`: everything the run needs to go on, taken where
no rollout is half collected. After SIGKILL at any moment a resumed run ends with the same
weights, to the last bit, as one that was left alone (same machine, same versions, CPU).
"""

from __future__ import annotations

import json
import multiprocessing
import os
import queue
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing.managers import SyncManager
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from pebble import ProcessExpired

from ves_gym._util.optional import require
from ves_gym._util.params import ParameterError, content_hash, write_text
from ves_gym._util.process_pool import Workers, end_with_parent
from ves_gym._util.statistics import STATISTICS, bootstrap, rate
from ves_gym._util.tables import table
from ves_gym._util.threads import on_one_thread
from ves_gym._util.views import Viewable
from ves_gym.baselines.action_repeat import Endings
from ves_gym.baselines.checkpoint import load_state, save_state
from ves_gym.baselines.config import TrainConfig
from ves_gym.baselines.controllers import Zero
from ves_gym.baselines.evaluate import Evaluation, evaluate, make_vector, ratio_or_none
from ves_gym.baselines.learner import Learner
from ves_gym.baselines.policy import Policy, load_policy, save_policy, versions

CHECKPOINT, CURVE, BEST = "checkpoint.safetensors", "curve.jsonl", "best.json"
SCHEMA, RESULT = "ves-checkpoint/3", "ves-train/1"
TRAINING = 1_000_000  # seed of the training episodes, plus the run's own
VALIDATION = 2_000_000  # first seed of the episodes that a run is judged by as it learns

_REMEMBERED = ("rows", "best", "returns", "solved")  # of a run, by a checkpoint

Progress = Callable[[float, str], None]
Row = dict[str, Any]  # of a learning curve
Folder = str | os.PathLike[str]


@on_one_thread()  # layers this small are slower on more, and sums depend on their number
def train(
    config: TrainConfig,
    seed: int,
    folder: Path,
    *,
    resume: bool = False,
    progress: Progress = lambda done, note: None,
    tensorboard: Folder | None = None,
) -> list[Row]:
    """Train one policy, see `train_seeds`; the rows of its learning curve.

    Raises:
        ParameterError: a run is already there without `resume`, or it is another
            configuration's; hyper-parameters that the algorithm does not know.
        MissingPackageError: a package is not installed.
    """
    folder = Path(folder)
    _require_ready([folder], resume, tensorboard)
    run = _Run(config, seed, folder, progress)  # refuses what it cannot train
    folder.mkdir(parents=True, exist_ok=True)
    for stale in folder.glob(".*"):  # left by a write that was killed
        stale.unlink()
    events: Any = nullcontext(lambda row: None)
    if tensorboard is not None:
        events = _event_writer(Path(tensorboard, config.name, f"seed-{seed}"), run.rows)
    with events as run.on_row:
        return run.learn()


def _require_ready(folders: Sequence[Path], resume: bool, tensorboard: Folder | None) -> None:
    """Refuse what would fail only after hours of training."""
    require("training", "safetensors")
    if tensorboard is not None:
        require("a curve in TensorBoard", "tensorboard")
        if Path(tensorboard).is_file():
            raise ParameterError(f"tensorboard must be a folder, got the file {tensorboard}")
    for folder in folders:
        if (folder / CHECKPOINT).exists() and not resume:
            raise ParameterError(
                f"{folder} holds a run already: --resume (resume=True), or choose another"
            )


class _Run:
    """A learner, its environment, and what is remembered of the run so far."""

    def __init__(
        self, config: TrainConfig, seed: int, folder: Path, progress: Progress
    ) -> None:
        self.config, self.seed, self.folder, self.progress = config, seed, folder, progress
        self.on_row: Callable[[Row], None] = lambda row: None
        env = make_vector(
            config.env, config.n_envs, AutoresetMode.SAME_STEP, threads=1, **config.settings
        )
        self.learner = Learner(config, seed, env, TRAINING, self._count)
        self.zero = self._evaluate(Zero())  # what every evaluation is compared with
        self.rows: list[Row] = []
        self.best: Policy | None = None
        self.returns: list[float] = []  # of the training episodes since the last row
        self.solved = 0
        self.earlier = 0.0  # s, before the run was last resumed
        self.stepping = 0.0  # s of them in the environment
        self.saved = -1  # steps at the last checkpoint
        self.identity = {  # what a checkpoint must agree with
            "schema": SCHEMA,
            "config": {**config.to_dict(), "seeds": [seed]},
            "task": content_hash(env.task),
        }
        self.references = {"task": env.task}
        self.versions = versions("safetensors")
        if (folder / CHECKPOINT).exists():
            self._restore(folder / CHECKPOINT)
        self.begin = time.perf_counter()

    def learn(self) -> list[Row]:
        """Train to the end."""
        self.learner.learn(self.config.total_timesteps, self.between_rollouts)
        self.between_rollouts(last=True)
        return self.rows

    def between_rollouts(self, last: bool = False) -> None:
        """Evaluate and save where it is time to; nothing is half collected here."""
        steps, total = self.learner.steps, self.config.total_timesteps
        every = self.config.eval_every or max(1, total // 20)
        done = self.rows[-1]["steps"] if self.rows else -1
        new = (last and steps > done) or steps // every > done // every
        if new:
            self._judge(steps)
        if steps > self.saved and (new or last):
            self._save(steps)
        note = f"{steps:,} steps"
        if self.rows:
            note += f", return {self.rows[-1]['return']:.3f}"
        self.progress(min(1.0, steps / total), note)

    def _count(self, ended: Endings) -> None:
        self.returns += ended.total.tolist()
        self.solved += int(ended.success.sum())

    def _evaluate(self, controller: Any) -> Evaluation:
        return evaluate(
            controller,
            self.config.env,
            episodes=self.config.eval_episodes,
            seed=VALIDATION,
            threads=1,
            **self.config.settings,
        )

    def _policy(self, steps: int) -> Policy:
        about: dict[str, Any] = {"env": self.config.env, "settings": self.config.settings}
        about |= {"algorithm": self.config.label, "seed": self.seed, "steps": steps}
        return self.learner.policy({**about, "versions": self.versions})

    def _judge(self, steps: int) -> None:
        """A row of the curve, and the policies' files."""
        policy = self._policy(steps)
        evaluation = self._evaluate(policy)
        mean = bootstrap(evaluation.values("return"), STATISTICS["mean"])
        seconds, stepping = self._time()
        row: Row = {"steps": steps, "return": mean.value}
        row |= {"return_low": mean.low, "return_high": mean.high}
        for name in ("success", "success_once"):
            row[name] = rate(np.concatenate(evaluation.values(name)) > 0).value
        for name in ("E_mean", "E_peak", "E_int"):
            row[name] = _finite(np.median(np.concatenate(evaluation.values(name))))
            over = ratio_or_none(evaluation, self.zero, name)
            row[f"{name}_ratio"] = None if over is None else _finite(over.value)
        row["train_episodes"] = len(self.returns)
        row["train_return"] = float(np.mean(self.returns)) if self.returns else None
        row["train_success"] = self.solved / len(self.returns) if self.returns else None
        row["train"] = {k: _finite(v) for k, v in self.learner.logged.items()}
        row["seconds"], row["seconds_stepping"] = round(seconds, 3), round(stepping, 3)
        self.returns, self.solved = [], 0
        if self.best is None or mean.value > max(r["return"] for r in self.rows):
            self.best = policy
        self.rows.append(row)
        self._write(policy)
        self.on_row(row)

    def _write(self, last: Policy) -> None:
        assert self.best is not None
        save_policy(self.best, self.folder / BEST)
        save_policy(last, self.folder / "last.json")
        lines = [json.dumps(row, allow_nan=False) + "\n" for row in self.rows]
        write_text(self.folder / CURVE, "".join(lines))

    def _time(self) -> tuple[float, float]:
        """Seconds of training so far, and those of them in the environment."""
        return (
            self.earlier + time.perf_counter() - self.begin,
            self.stepping + self.learner.decisions.stepping,
        )

    def _save(self, steps: int) -> None:
        seconds, stepping = self._time()
        self.saved = steps
        state = {
            **self.identity,
            "versions": self.versions,
            **{name: getattr(self, name) for name in _REMEMBERED},
            "seconds": seconds,
            "stepping": stepping,
            "learner": self.learner.state(),
            "environment": self.learner.decisions.env.snapshot(),
        }
        save_state(self.folder / CHECKPOINT, state, self.references)

    def _restore(self, path: Path) -> None:
        state: dict[str, Any] = load_state(path, self.references)
        for name, value in self.identity.items():
            if state.get(name) != value:
                raise ParameterError(
                    f"{path} is of another run: its {name} is {state.get(name)}, this one's"
                    f" {value}"
                )
        if state["versions"] != self.versions:
            warnings.warn(
                f"{path} was made by {state['versions']}, this is {self.versions}: the run goes"
                " on, but not as it would have",
                stacklevel=4,
            )
        for name in _REMEMBERED:
            setattr(self, name, state[name])
        self.earlier, self.stepping = state["seconds"], state["stepping"]
        self.learner.restore(state["learner"])
        self.saved = self.learner.steps
        self.learner.decisions.env.restore(state["environment"])
        if self.rows:  # the files may be of a later moment than the checkpoint
            self._write(self._policy(self.saved))


def _finite(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None


# ----------------------------------------------------------------------- TensorBoard


def scalars(row: Mapping[str, Any]) -> dict[str, float]:
    """Return the numbers of a row of a learning curve by tag, empty ones left out.

    `validation/` are the episodes that a policy is judged by, `train/` the exploring ones
    since the row before, `learner/` figures of the last update, `time/` seconds.
    """
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
def _event_writer(folder: Path, rows: Sequence[Row]) -> Iterator[Callable[[Row], None]]:
    """Open a folder for the curve of one run, with the rows so far of one that goes on."""
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


# --------------------------------------------------------------------- several seeds


def train_seeds(
    config: TrainConfig,
    folder: Path,
    *,
    workers: int = 1,
    resume: bool = False,
    progress: Callable[[int, float, str], None] = lambda seed, done, note: None,
    tensorboard: Folder | None = None,
) -> dict[int, list[Row]]:
    """Train a policy per seed of a configuration in folder/seed-N; the curves by seed.

    Args:
        config: of the runs.
        folder: of all of them.
        workers: processes; each trains one seed at a time.
        resume: go on from the checkpoints, where there are any.
        progress: called with the seed, the fraction done and a few words.
        tensorboard: a folder that gets the curves as they grow, in NAME/seed-N.

    Raises:
        ChildProcessError: the process of a run died.
        ParameterError, MissingPackageError: see `train`.
    """
    places = {seed: Path(folder) / f"seed-{seed}" for seed in config.seeds}
    _require_ready(list(places.values()), resume, tensorboard)
    common: dict[str, Any] = {"resume": True, "tensorboard": tensorboard}
    if min(workers, len(places)) == 1:
        return {
            seed: train(config, seed, place, progress=partial(progress, seed), **common)
            for seed, place in places.items()
        }
    manager = SyncManager(ctx=multiprocessing.get_context("spawn"))
    manager.start(end_with_parent)
    with manager, Workers(min(workers, len(places))) as pool:
        notes = manager.Queue()
        jobs = {
            seed: pool.submit(
                train, config, seed, place, progress=partial(_note, notes, seed), **common
            )
            for seed, place in places.items()
        }
        while not (notes.empty() and all(job.done() for job in jobs.values())):
            with suppress(queue.Empty):
                progress(*notes.get(timeout=0.5))
        try:
            return {seed: job.result() for seed, job in jobs.items()}
        except ProcessExpired as error:
            raise ChildProcessError(
                f"the process of a training run died (exit code {error.exitcode}); resume to"
                " go on from its checkpoint"
            ) from None


def _note(notes: Any, seed: int, done: float, note: str) -> None:
    notes.put((seed, done, note))


@dataclass(frozen=True, eq=False, repr=False)
class TrainingResult(Viewable):
    """One training run per seed; files are under `folder`/seed-N."""

    config: TrainConfig
    folder: Path
    curves: Mapping[int, list[Row]]  # seed -> rows of its learning curve

    @property
    def policies(self) -> dict[int, Policy]:
        """Best policy of each seed."""
        return {seed: load_policy(self._best(seed)) for seed in self.curves}

    @property
    def best(self) -> Policy:
        """Policy of the seed with the largest return on the validation episodes."""
        return load_policy(self._best(max(self.curves, key=lambda s: self._run(s)["return"])))

    def _best(self, seed: int) -> Path:
        return self.folder / f"seed-{seed}" / BEST

    def _run(self, seed: int) -> Row:
        """Row of the best policy of a seed."""
        return max(self.curves[seed], key=lambda row: row["return"])

    def __repr__(self) -> str:
        largest = max(self._run(seed)["return"] for seed in self.curves)
        return (
            f"<TrainingResult: {self.config.env}, {self.config.label},"
            f" {len(self.curves)} seed(s), best return {largest:.3f}; {self.folder}>"
        )

    def __str__(self) -> str:
        rows, runs = [], self.to_dict()["runs"]
        for r in runs:
            best = r["best"]
            mean, low, high = (best[f"return{k}"] for k in ("", "_low", "_high"))
            ratio = best["E_mean_ratio"]
            rows.append(
                (
                    r["seed"],
                    f"{r['steps']:,}",
                    f"{r['seconds']:.0f}",
                    f"{r['steps_per_second']:,}",
                    f"{mean:.3f} ({low:.2f} to {high:.2f})",
                    f"{best['success']:.0%}",
                    "-" if ratio is None else f"{ratio:.3f}",
                )
            )
        head = ("seed", "steps", "s", "steps/s", "return", "success", "E_mean/0")
        title = f"{self.config.env}, {self.config.label}: best policy of each seed"
        about = (
            "Mean return with its 95 % interval on the validation episodes; E_mean/0: median of"
            " the\nenergy over that of the zero action."
        )
        policies = (r["policy"] for r in runs)
        return "\n".join([table(head, rows, title=title, left=()), about, *policies])

    def to_dict(self) -> dict[str, Any]:
        """Return plain data, schema ves-train/1, as `ves-gym train --json` writes it."""
        runs = [
            {
                "seed": seed,
                "policy": str(self._best(seed)),
                "steps": rows[-1]["steps"],
                "seconds": rows[-1]["seconds"],
                "steps_per_second": round(rows[-1]["steps"] / rows[-1]["seconds"]),
                "best": self._run(seed),
                "last": rows[-1],
            }
            for seed, rows in self.curves.items()
        ]
        return {"schema": RESULT, "config": self.config.to_dict(), "runs": runs}
