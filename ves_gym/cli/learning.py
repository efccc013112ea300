"""`ves-gym train`, `evaluate`, `policy`, `dataset`: policies and episodes."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import ves_gym.api as vg
from ves_gym._util.optional import require
from ves_gym._util.own import own_object
from ves_gym._util.params import ParameterError, read_table, to_plain, write_text
from ves_gym.baselines.config import choose_config
from ves_gym.baselines.controllers import Controller
from ves_gym.baselines.evaluate import with_deviations
from ves_gym.baselines.registry import CONTROLLERS
from ves_gym.cli.flags import (
    WORKERS,
    Answer,
    Context,
    Flag,
    Place,
    integer,
    integers,
    names,
    read,
    say,
    text,
)
from ves_gym.cli.machine import EFFECT, arm_flags, arm_option
from ves_gym.system.effect import Effect

# ------------------------------------------------------------------ learned and compared


def train(
    at: Context,
    config: str,
    *,
    algo: str | None = None,
    seeds: tuple[int, ...] | None = None,
    arm: str | Mapping[str, Any] | None = None,
    effect: tuple[Effect, ...] = (),
    **how: Any,
) -> Answer:
    """Train, write policies and learning curves; a line per seed."""
    chosen = choose_config(config, algo)
    result = vg.train(
        chosen,
        seeds=[k + at.seed for k in seeds or chosen.seeds],
        settings=with_deviations(chosen.env, chosen.settings, effect, arm),
        folder=at.out,
        progress=at.progress,
        **how,
    )
    return Answer(text=result, plain=result.to_dict())


def evaluate(
    at: Context,
    id: str,
    *,
    controller: Sequence[str | Controller] = (),
    policy: Sequence[str | Path] = (),
    nominal: bool = False,
    arm: str | Mapping[str, Any] | None = None,
    effect: tuple[Effect, ...] = (),
    **how: Any,
) -> Answer:
    """Evaluate; the table, and who beats whom."""
    how |= with_deviations(id, {"randomize": {}} if nominal else {}, effect, arm)
    rivals = [*controller, *policy]
    comparison = vg.evaluate(id, rivals, seed=at.seed, progress=at.progress, **how)
    return Answer(text=comparison, plain=comparison.to_dict())


# ------------------------------------------------------------------------------ policies


def _destinations(at: Context, policy: tuple[str, ...], suffix: str) -> list[tuple[str, Path]]:
    """Policies, of those released all by default, and a file about each: PumaDamp-ppo.md."""
    from ves_gym.baselines.policy import RELEASED

    files = RELEASED.glob("*/*.json")
    released = sorted(k.relative_to(RELEASED).with_suffix("").as_posix() for k in files)
    return [(k, at.folder("out/policies") / _file(k, suffix)) for k in policy or released]


def _file(name: str, suffix: str) -> str:
    return str(Path(name).with_suffix("")).strip("./").replace("/", "-") + suffix


def export(at: Context, policy: tuple[str, ...] = (), *, onnx: bool = False) -> Answer:
    """Write policies as ONNX, actions compared."""
    from ves_gym.baselines.onnx_file import write_onnx
    from ves_gym.baselines.policy import load_policy

    if not onnx:
        raise ParameterError("policy export needs --onnx, the one format that it writes")
    lines, rows = [], []
    for name, path in _destinations(at, policy, ".onnx"):
        gap = write_onnx(load_policy(name), path)
        lines.append(f"{path}: actions within {gap:.1g} of {name}")
        rows.append({"policy": name, "path": str(path), "difference": gap})
    plain = {"schema": "ves-policy-command/1", "onnx": rows}
    return Answer(text="\n".join(lines), plain=plain)


def card(
    at: Context,
    policy: tuple[str, ...] = (),
    *,
    figures: Path | None = None,
    episodes: int = 100,
) -> Answer:
    """Write the model cards of policies (Markdown)."""
    from ves_gym.report.policy_card import evaluation_for_card, policy_card

    rows = []
    for name, path in _destinations(at, policy, ".md"):
        if figures is None:
            evaluation = evaluation_for_card(name, episodes, at.seed)
        else:
            is_folder = figures.is_dir()
            evaluation = read_table(figures / _file(name, ".json") if is_folder else figures)
        write_text(path, policy_card(name, evaluation))
        rows.append({"policy": name, "path": str(path)})
    plain = {"schema": "ves-policy-command/1", "cards": rows}
    return Answer(plain=plain, files=[row["path"] for row in rows])


# ----------------------------------------------------------------------------- data sets


def make(
    at: Context, set: Sequence[str] = (), *, all: bool = False, episodes: int | None = None
) -> Answer:
    """Make data sets from their recipes, write and replay them."""
    from ves_gym.baselines import dataset as d
    from ves_gym.baselines.minari_files import PACKAGES, replay, write_dataset

    if bool(set) == all:
        raise ParameterError(
            "dataset make needs the names of data sets, or --all for every one"
        )
    chosen = d.choose_recipes(list(set))
    if episodes is not None:
        chosen = [replace(recipe, episodes=episodes) for recipe in chosen]
    require("a data set", *PACKAGES)
    rows, folder = [], at.folder("out/datasets")
    for k, recipe in enumerate(chosen):
        at.progress(k / len(chosen), recipe.id)
        begin = time.perf_counter()
        dataset = d.make_dataset(recipe)
        path = write_dataset(dataset, folder)
        row = {
            "id": recipe.id,
            "folder": str(path),
            "episodes": len(dataset.episodes),
            "steps": sum(len(e.rewards) for e in dataset.episodes),
            "solved": sum(e.success for e in dataset.episodes),
        }
        rows.append({**row, **_replayed(replay(path), begin)})
    return _report(rows)


def check(at: Context, folder: Sequence[str]) -> Answer:
    """Replay data sets in the environment that they name."""
    from ves_gym.baselines.minari_files import replay

    rows = []
    for path in folder:
        begin = time.perf_counter()
        replayed = replay(path)
        row = {"id": path, "episodes": replayed.episodes, "steps": replayed.steps}
        rows.append({**row, **_replayed(replayed, begin)})
    return _report(rows)


def show(at: Context) -> Answer:
    """Recipes of the package."""
    from ves_gym.baselines.dataset import recipes

    lines, rows = [], []
    for recipe in recipes().values():
        noise = f", noise {recipe.noise:g}" if recipe.noise else ""
        behaviours = ", ".join(recipe.behaviours)
        lines.append(f"{recipe.id}: {recipe.episodes} episodes of {behaviours}{noise}")
        rows.append({"id": recipe.id, "episodes": recipe.episodes, "env": recipe.env})
    return Answer(text="\n".join(lines), plain={"schema": "ves-dataset-list/1", "sets": rows})


def _replayed(replayed: Any, begin: float) -> dict[str, Any]:
    """The outcome of a replay."""
    faults = []
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
        words.append("replayed bit for bit" if row["exact"] else "replayed to rounding")
        lines.append(f"{row['id']}: {'WRONG' if row['wrong'] else ', '.join(words)}")
        for fault in row["wrong"]:
            say(fault, row["id"])
    return Answer(
        text="\n".join(lines),
        plain={"schema": "ves-dataset-check/1", "sets": rows},
        negative=any(row["wrong"] for row in rows),
    )


# -------------------------------------------------------------------------------- tables


def _arm(value: str, place: Place) -> str | dict[str, Any]:
    """An arm as settings have it: by name or file, or as data where options say more."""
    plain: dict[str, Any] = to_plain(arm_option(value, place)) if place.beside else {}
    return plain or value


def _controllers(value: str, place: Place) -> list[Any]:
    return [own_object(name, CONTROLLERS, "controllers") for name in names(value, place)]


ARM, *BESIDE = arm_flags("that of the environment")
ARMS = (replace(ARM, read=_arm), *BESIDE)
POLICY = Flag(
    "POLICY",
    many=True,
    optional=True,
    help="a .json file or a released one, such as PumaDamp/ppo; none: all released",
)
TABLE = {
    "train": (train, (
        Flag("CONFIG", help="a .toml file, or an environment: ves/PumaDamp-v0"),
        Flag("--algo", "A", text, "ppo or another label of a configuration"),
        Flag("--imitate", "C", text, "a controller whose actions are learned first"),
        Flag("--steps", "N", integer(), "instead of the configuration's"),
        Flag("--seeds", "0,1", integers, "default the configuration's; --seed adds to each"),
        replace(WORKERS, help="seeds at once"),
        Flag("--resume", help="go on from the checkpoints"),
        Flag("--tensorboard", "DIR", text, "write the curves there during training"),
        *ARMS,
        EFFECT,
    )),
    "evaluate": (evaluate, (
        Flag("ID", help="an environment, such as ves/PumaDamp-v0"),
        Flag("--controller", "A,B", _controllers,
             f"of {', '.join(CONTROLLERS)}, or one's own as module:Class; default zero,random"
             " and the released policies"),
        Flag("--policy", "FILE", read(lambda k: k if k == "released" else Path(k)),
             "a policy's .json, a folder that `ves-gym train` made (its seeds as one), the name"
             " of a released policy (`ves-gym list policies`), or `released` for all of them;"
             " repeatable", many=True),
        Flag("--episodes", "N", integer(), "default 100"),
        Flag("--n-envs", "N", integer(1), "environments in lockstep; changes no result"),
        Flag("--nominal", help="without randomisation"),
        *ARMS,
        EFFECT,
    )),
    "policy export": (export, (POLICY, Flag("--onnx", help="the format (the only one)"))),
    "policy card": (card, (
        POLICY,
        Flag("--figures", "PATH", read(Path),
             "evaluation of the policy as JSON (`ves-gym evaluate --json`), or a folder with"
             " one per policy, such as docs/training; default: evaluate it now"),
        Flag("--episodes", "N", integer(1), "of that evaluation (100)"),
    )),
    "dataset make": (make, (
        Flag("SET", many=True, optional=True,
             help="an id (`ves-gym dataset list`), an environment for all of its sets, or a"
             " .toml file of recipes"),
        Flag("--all", help="every recipe of the package"),
        Flag("--episodes", "N", integer(1), "of each set, in place of the recipe's"),
    )),
    "dataset check": (check, (Flag("FOLDER", help="of a data set", many=True),)),
    "dataset list": (show, ()),
}  # fmt: skip
