"""`ves-gym dataset`: episodes as Minari data sets, made from recipes and replayed."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

from ves_gym._util.optional import require
from ves_gym._util.params import ParameterError
from ves_gym.cli.common import progress, write_json

SCHEMA = "ves-dataset-check/1"
_NEGATIVE = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    actions = parser.add_subparsers(dest="action_name", metavar="ACTION", required=True)
    make = actions.add_parser(
        "make", help="make data sets from their recipes, write and replay them"
    )
    make.add_argument(
        "sets",
        metavar="SET",
        nargs="*",
        help="an id (`ves-gym dataset list`), an environment for all of its sets, or a .toml"
        " file of recipes",
    )
    make.add_argument("--all", action="store_true", help="every recipe of the package")
    make.add_argument(
        "--record", action="store_true", help="write fingerprints beside the package's recipes"
    )
    make.set_defaults(action=_make)
    check = actions.add_parser(
        "check", help="replay data sets in the environment that they name"
    )
    check.add_argument("folders", metavar="FOLDER", nargs="+", help="of a data set")
    check.set_defaults(action=_check)
    show = actions.add_parser("list", help="recipes of the package")
    show.set_defaults(action=_list)
    for action in actions.choices.values():  # what every command takes, after the action too
        for option, name in (("--json", "FILE"), ("--out", "DIR")):
            action.add_argument(
                option, metavar=name, default=argparse.SUPPRESS, help=argparse.SUPPRESS
            )


def run(args: argparse.Namespace) -> int:
    """Carry out the action; exit status 1 where a data set is not what it should be."""
    status: int = args.action(args)
    return status


def _make(args: argparse.Namespace) -> int:
    from ves_gym.baselines.dataset import (
        RECIPES,
        choose_recipes,
        differences,
        make_dataset,
        recipes,
        record,
        recorded,
    )
    from ves_gym.baselines.minari_files import PACKAGES, replay, write_dataset

    if bool(args.sets) == args.all:
        raise ParameterError(
            "dataset make needs the names of data sets, or --all for every one"
        )
    chosen = choose_recipes(args.sets)
    shipped = recipes()
    if args.record and any(shipped.get(r.id) != r for r in chosen):
        raise ParameterError(f"--record is for the recipes in {RECIPES.name} of the package")
    require("a data set", *PACKAGES)
    root = Path(args.out or "out/datasets")
    rows: list[dict[str, Any]] = []
    made = []
    with progress() as on_progress:
        for k, recipe in enumerate(chosen):
            on_progress(recipe.id, k / len(chosen))
            begin = time.perf_counter()
            dataset = make_dataset(recipe)
            path = write_dataset(dataset, root)
            again = replay(path)
            known = shipped.get(recipe.id) == recipe and not args.record
            expected = recorded(recipe) if known else None
            wrong = [] if expected is None else differences(dataset.fingerprint, expected)
            if not again.sound:
                wrong.append(_apart(again))
            same = expected is not None and expected["bits"] == dataset.fingerprint["bits"]
            rows.append(
                {
                    "id": recipe.id,
                    "folder": str(path),
                    **{k: dataset.fingerprint[k] for k in ("episodes", "steps", "solved")},
                    "recorded": expected is not None,
                    "bits": same,
                    "exact": again.exact,
                    "wrong": wrong,
                    "seconds": round(time.perf_counter() - begin, 2),
                }
            )
            made.append(dataset)
    if args.record:
        record(made)
    return _report(args, rows)


def _check(args: argparse.Namespace) -> int:
    from ves_gym.baselines.minari_files import replay, stored_differences

    rows = []
    for folder in args.folders:
        begin = time.perf_counter()
        again, wrong = replay(folder), stored_differences(folder)
        if not again.sound:
            wrong.append(_apart(again))
        rows.append(
            {
                "id": str(folder),
                "episodes": again.episodes,
                "steps": again.steps,
                "exact": again.exact,
                "wrong": wrong,
                "seconds": round(time.perf_counter() - begin, 2),
            }
        )
    return _report(args, rows)


def _apart(again: Any) -> str:
    if not again.ends:
        return "replayed episodes end elsewhere"
    return (
        f"replayed rewards differ by up to {again.rewards:.3g}, observations by"
        f" {again.observations:.3g}"
    )


def _report(args: argparse.Namespace, rows: list[dict[str, Any]]) -> int:
    for row in rows:
        words = [f"{row['episodes']} episodes, {row['steps']} steps"]
        if "solved" in row:
            words.append(f"{row['solved']} solved")
        if row.get("recorded"):
            words.append("bits as recorded" if row["bits"] else "as recorded, to rounding")
        words.append("replayed bit for bit" if row["exact"] else "replayed to rounding")
        print(f"{row['id']}: {'WRONG' if row['wrong'] else ', '.join(words)}")
        for text in row["wrong"]:
            print(f"{row['id']}: {text}", file=sys.stderr)
    write_json(args.json, {"schema": SCHEMA, "sets": rows})
    return _NEGATIVE if any(row["wrong"] for row in rows) else 0


def _list(args: argparse.Namespace) -> int:
    from ves_gym.baselines.dataset import recipes

    rows = []
    for recipe in recipes().values():
        noise = f", noise {recipe.noise:g}" if recipe.noise else ""
        print(
            f"{recipe.id}: {recipe.episodes} episodes of {', '.join(recipe.behaviours)}{noise}"
        )
        rows.append({"id": recipe.id, "episodes": recipe.episodes, "env": recipe.env})
    write_json(args.json, {"schema": "ves-dataset-list/1", "sets": rows})
    return 0
