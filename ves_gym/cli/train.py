"""`ves-gym train`: policies from a configuration, one per seed."""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ves_gym._util.optional import require
from ves_gym._util.params import ParameterError
from ves_gym.baselines.config import TrainConfig, find_configs, read_config
from ves_gym.cli.common import add_effect_argument, out_dir, with_effects, write_json

SCHEMA = "ves-train/1"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "config", metavar="CONFIG", help="a .toml file, or an environment: ves/PumaDamp-v0"
    )
    parser.add_argument(
        "--algo", metavar="A", help="ppo, sac or sac-her; default the first known"
    )
    parser.add_argument("--steps", type=int, metavar="N", help="instead of the configuration's")
    parser.add_argument(
        "--seeds", metavar="0,1", help="default the configuration's; --seed is added to each"
    )
    parser.add_argument("--workers", type=int, default=1, metavar="N", help="seeds at once")
    parser.add_argument("--resume", action="store_true", help="go on from the checkpoints")
    add_effect_argument(parser)


def run(args: argparse.Namespace) -> int:
    """Train, write policies and learning curves, print a line per seed."""
    config = _config(args)
    if args.workers < 1:
        raise ParameterError(f"--workers must be >= 1, got {args.workers}")
    seeds = [s + args.seed for s in config.seeds]
    from ves_gym.baselines.train import PACKAGES, train_seeds

    require("training", *PACKAGES)
    with _bars() as tell:
        folder = out_dir(args, f"out/train/{config.name}")
        curves = train_seeds(
            config,
            seeds,
            folder,
            workers=args.workers,
            resume=args.resume,
            progress=tell,
        )
    runs = [_run(seed, rows, folder) for seed, rows in curves.items()]
    _print(config, runs)
    write_json(args.json, {"schema": SCHEMA, "config": config.to_dict(), "runs": runs})
    return 0


def _config(args: argparse.Namespace) -> TrainConfig:
    if Path(args.config).suffix in (".toml", ".json"):
        config = read_config(args.config)
        if args.algo not in (None, config.algorithm, config.label):
            raise ParameterError(f"{args.config} is for {config.label}, got --algo {args.algo}")
    else:
        name = args.config if "/" in args.config else f"ves/{args.config}"
        found = find_configs(name, args.algo)
        if not found:
            raise ParameterError(
                f"no configuration for {name}"
                + (f" and {args.algo}" if args.algo else "")
                + ": give a .toml file"
            )
        config = found[0]
    changes: dict[str, Any] = {}
    if args.effect:
        changes["settings"] = with_effects(config.env, config.settings, args.effect)
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


def _run(seed: int, rows: list[dict[str, Any]], folder: Path) -> dict[str, Any]:
    last = rows[-1]
    return {
        "seed": seed,
        "policy": str(folder / f"seed-{seed}" / "best.json"),
        "steps": last["steps"],
        "seconds": last["seconds"],
        "steps_per_second": round(last["steps"] / last["seconds"]),
        "share_stepping": round(last["seconds_stepping"] / last["seconds"], 3),
        "best": max(rows, key=lambda row: row["return"]),
        "last": last,
    }


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

        def tell(seed: int, done: float, note: str) -> None:
            if seed not in tasks:
                tasks[seed] = bars.add_task(f"seed {seed}", total=1.0, note="")
            bars.update(tasks[seed], completed=done, note=note)

        yield tell
