"""`ves-gym dataset`: episodes as Minari data sets, made from recipes and replayed."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ves_gym._util.optional import require
from ves_gym._util.params import ParameterError
from ves_gym.cli.flags import Answer, Flag, say

SCHEMA = "ves-dataset-check/1"


def make(
    *,
    set: Sequence[str] = (),
    all: bool = False,
    record: bool = False,
    out: Path | None = None,
    progress: Any = None,
) -> Answer:
    """Make data sets from their recipes, write and replay them."""
    from ves_gym.baselines import dataset as d
    from ves_gym.baselines.minari_files import PACKAGES, replay, write_dataset

    if bool(set) == all:
        raise ParameterError(
            "dataset make needs the names of data sets, or --all for every one"
        )
    chosen = d.choose_recipes(list(set))
    shipped = d.recipes()
    if record and any(shipped.get(r.id) != r for r in chosen):
        raise ParameterError(f"--record is for the recipes in {d.RECIPES.name} of the package")
    require("a data set", *PACKAGES)
    rows, datasets = [], []
    for k, recipe in enumerate(chosen):
        progress(k / len(chosen), recipe.id)
        begin = time.perf_counter()
        dataset = d.make_dataset(recipe)
        path = write_dataset(dataset, out or Path("out/datasets"))
        expected = d.recorded(recipe) if shipped.get(recipe.id) == recipe else None
        expected = None if record else expected
        mark = dataset.fingerprint
        row: dict[str, Any] = {"id": recipe.id, "folder": str(path)}
        row |= {k: mark[k] for k in ("episodes", "steps", "solved")}
        row["recorded"] = expected is not None
        wrong = [] if expected is None else d.differences(mark, expected)
        rows.append({**row, **_replayed(replay(path), wrong, begin)})
        datasets.append(dataset)
    if record:
        d.record(datasets)
    return _report(rows)


def check(folder: Sequence[str]) -> Answer:
    """Replay data sets in the environment that they name."""
    from ves_gym.baselines.minari_files import replay, stored_differences

    rows = []
    for path in folder:
        begin = time.perf_counter()
        replayed, wrong = replay(path), stored_differences(path)
        row = {"id": path, "episodes": replayed.episodes, "steps": replayed.steps}
        rows.append({**row, **_replayed(replayed, wrong, begin)})
    return _report(rows)


def show() -> Answer:
    """Recipes of the package."""
    from ves_gym.baselines.dataset import recipes

    lines, rows = [], []
    for recipe in recipes().values():
        noise = f", noise {recipe.noise:g}" if recipe.noise else ""
        behaviours = ", ".join(recipe.behaviours)
        lines.append(f"{recipe.id}: {recipe.episodes} episodes of {behaviours}{noise}")
        rows.append({"id": recipe.id, "episodes": recipe.episodes, "env": recipe.env})
    return Answer(text="\n".join(lines), plain={"schema": "ves-dataset-list/1", "sets": rows})


def _replayed(replayed: Any, wrong: Sequence[str], begin: float) -> dict[str, Any]:
    """The outcome of a replay, beside what was wrong before it."""
    faults = list(wrong)
    if not replayed.ends:
        faults.append("replayed episodes end elsewhere")
    elif not replayed.sound:
        faults.append(
            f"replayed rewards differ by up to {replayed.rewards:.3g}, observations by"
            f" {replayed.observations:.3g}"
        )
    seconds = round(time.perf_counter() - begin, 2)
    return {"exact": replayed.exact, "wrong": faults, "seconds": seconds}


def _report(rows: list[dict[str, Any]]) -> Answer:
    lines = []
    for row in rows:
        words = [f"{row['episodes']} episodes, {row['steps']} steps"]
        if "solved" in row:
            words.append(f"{row['solved']} solved")
        if row.get("recorded"):
            words.append("as recorded")
        words.append("replayed bit for bit" if row["exact"] else "replayed to rounding")
        lines.append(f"{row['id']}: {'WRONG' if row['wrong'] else ', '.join(words)}")
        for fault in row["wrong"]:
            say(fault, row["id"])
    return Answer(
        text="\n".join(lines),
        plain={"schema": SCHEMA, "sets": rows},
        negative=any(row["wrong"] for row in rows),
    )


ACTIONS = {
    "make": (
        "make data sets from their recipes, write and replay them",
        (
            Flag("SET", many=True, optional=True,
                 help="an id (`ves-gym dataset list`), an environment for all of its sets, or a"
                 " .toml file of recipes"),
            Flag("--all", help="every recipe of the package"),
            Flag("--record", help="write fingerprints beside the package's recipes"),
        ),
        make,
    ),
    "check": (
        "replay data sets in the environment that they name",
        (Flag("FOLDER", help="of a data set", many=True),),
        check,
    ),
    "list": ("recipes of the package", (), show),
}  # fmt: skip
