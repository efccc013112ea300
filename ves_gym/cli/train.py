"""`ves-gym train`: policies from a configuration, one per seed."""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from ves_gym._util.optional import require
from ves_gym._util.params import ParameterError
from ves_gym.baselines.config import LEARNERS, TrainConfig, choose_config
from ves_gym.baselines.training_result import TrainingResult
from ves_gym.cli.common import (
    add_arm_argument,
    add_effect_argument,
    out_dir,
    with_effects,
    write_json,
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "config", metavar="CONFIG", help="a .toml file, or an environment: ves/PumaDamp-v0"
    )
    parser.add_argument(
        "--algo", metavar="A", help="ppo, sac, sac-her or another label of a configuration"
    )
    parser.add_argument(
        "--learner",
        choices=LEARNERS,
        help="native: PPO in NumPy, faster; default the configuration's",
    )
    parser.add_argument(
        "--imitate", metavar="C", help="a controller whose actions are learned first (native)"
    )
    parser.add_argument("--steps", type=int, metavar="N", help="instead of the configuration's")
    parser.add_argument(
        "--seeds", metavar="0,1", help="default the configuration's; --seed is added to each"
    )
    parser.add_argument("--workers", type=int, default=1, metavar="N", help="seeds at once")
    parser.add_argument("--resume", action="store_true", help="go on from the checkpoints")
    parser.add_argument(
        "--tensorboard", metavar="DIR", default="", help="show the curves as they grow there"
    )
    parser.add_argument(
        "--wandb", metavar="PROJECT", default="", help="likewise on Weights & Biases"
    )
    add_arm_argument(parser, "that of the environment")
    add_effect_argument(parser)


def run(args: argparse.Namespace) -> int:
    """Train, write policies and learning curves, print a line per seed."""
    config = _config(args)
    if args.workers < 1:
        raise ParameterError(f"--workers must be >= 1, got {args.workers}")
    seeds = [s + args.seed for s in config.seeds]
    from ves_gym.baselines.tracking import Tracking
    from ves_gym.baselines.train import PACKAGES, train_seeds

    require("training", *PACKAGES[config.learner])
    tracking = Tracking(tensorboard=args.tensorboard, wandb=args.wandb)
    tracking.require()
    with _bars() as on_progress:
        folder = out_dir(args, f"out/train/{config.name}")
        curves = train_seeds(
            config,
            seeds,
            folder,
            workers=args.workers,
            resume=args.resume,
            progress=on_progress,
            tracking=tracking,
        )
    result = TrainingResult(config, folder, curves).to_dict()
    _print(config, result["runs"])
    write_json(args.json, result)
    return 0


def _config(args: argparse.Namespace) -> TrainConfig:
    config = choose_config(args.config, args.algo)
    changes: dict[str, Any] = {}
    if args.effect or args.arm is not None:
        changes["settings"] = with_effects(config.env, config.settings, args.effect, args.arm)
    if args.imitate is not None:
        changes["imitate"], changes["learner"] = args.imitate, "native"
    if args.learner is not None:
        changes["learner"] = args.learner
    if args.steps is not None:
        changes["total_timesteps"] = args.steps
    if args.seeds is not None:
        try:
            changes["seeds"] = tuple(int(part) for part in args.seeds.split(","))
        except ValueError:
            raise ParameterError(
                f"--seeds must be whole numbers like 0,1,2, got {args.seeds!r}"
            ) from None
    return dataclasses.replace(config, **changes)


def _print(config: TrainConfig, runs: list[dict[str, Any]]) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console(width=None if sys.stdout.isatty() else 110, markup=False)
    table = Table(title=f"{config.env}, {config.label}: best policy of each seed")
    for name in (
        "seed",
        "steps",
        "s",
        "steps/s",
        "env",
        "return",
        "success",
        "E_mean/0",
        "E_int/0",
    ):
        table.add_column(name, justify="right", no_wrap=True)
    for r in runs:
        best = r["best"]
        table.add_row(
            str(r["seed"]),
            f"{r['steps']:,}",
            f"{r['seconds']:.0f}",
            f"{r['steps_per_second']:,}",
            f"{r['share_stepping']:.0%}",
            f"{best['return']:.3f} ({best['return_low']:.2f} to {best['return_high']:.2f})",
            f"{best['success']:.0%}",
            _number(best["E_mean_ratio"]),
            _number(best["E_int_ratio"]),
        )
    console.print(table)
    console.print(
        "Mean return with its 95 % interval on the validation episodes; env: share of the time"
        " in\nenv.step; E/0: median of the energy over that of the zero action.",
        style="dim",
    )
    for r in runs:
        print(r["policy"])


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


@contextmanager
def _bars() -> Iterator[Callable[[int, float, str], None]]:
    """A progress bar per seed on a terminal; silent in a pipe."""
    if not sys.stderr.isatty():
        yield lambda seed, done, note: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}"),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bars:
        tasks: dict[int, Any] = {}

        def on_progress(seed: int, done: float, note: str) -> None:
            if seed not in tasks:
                tasks[seed] = bars.add_task(f"seed {seed}", total=1.0, note="")
            bars.update(tasks[seed], completed=done, note=note)

        yield on_progress
