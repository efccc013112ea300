"""`ves-gym evaluate`: controllers and policies side by side on the same episodes."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ves_gym._util.params import ParameterError
from ves_gym._util.suggest import did_you_mean
from ves_gym.baselines.controllers import Controller
from ves_gym.baselines.evaluate import Evaluation, evaluate, pool, report
from ves_gym.baselines.policy import load_policy, released
from ves_gym.baselines.registry import CONTROLLERS, get_controller
from ves_gym.cli.common import add_effect_argument, progress, with_effects, write_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("id", metavar="ID", help="an environment, such as ves/PumaDamp-v0")
    parser.add_argument(
        "--controller",
        metavar="A,B",
        help=f"of {', '.join(CONTROLLERS)}; default zero,random and the released policies",
    )
    parser.add_argument(
        "--policy",
        metavar="FILE",
        action="append",
        default=[],
        help="a policy's .json, a folder that `ves-gym train` made (its seeds as one), the name"
        " of a released policy (`ves-gym list policies`), or `released` for all of them;"
        " repeatable",
    )
    parser.add_argument("--episodes", type=int, default=100, metavar="N", help="default 100")
    parser.add_argument("--n-envs", type=int, metavar="N", help="at once; changes no result")
    parser.add_argument("--nominal", action="store_true", help="without randomisation")
    add_effect_argument(parser)


def run(args: argparse.Namespace) -> int:
    """Evaluate, print the table and who beats whom, write JSON."""
    id = args.id if "/" in args.id else f"ves/{args.id}"
    chosen = _chosen(args, id)
    settings = with_effects(id, {"randomize": {}} if args.nominal else {}, args.effect)
    found: list[Evaluation] = []
    with progress() as tell:
        for name, group in chosen:
            some = [
                evaluate(
                    controller,
                    id,
                    episodes=args.episodes,
                    seed=args.seed,
                    n_envs=args.n_envs,
                    progress=lambda done, k=k, name=name, group=group: tell(  # type: ignore[misc]
                        name, (k + done) / len(group)
                    ),
                    **settings,
                )
                for k, controller in enumerate(group)
            ]
            found.append(pool(some, name))
    result = report(found)
    _print(result, args)
    write_json(args.json, result)
    return 0


def _chosen(args: argparse.Namespace, id: str) -> list[tuple[str, Sequence[Controller]]]:
    """Label and controllers (one, or a policy per training seed) of each column."""
    out: list[tuple[str, Sequence[Controller]]]
    names, texts = args.controller.split(",") if args.controller else [], list(args.policy)
    if not names and not texts:
        names, texts = ["zero", "random"], list(released(id))
    if "released" in texts:
        at = texts.index("released")
        texts[at : at + 1] = released(id) or ["released"]  # the latter is refused
    out = [(n, [get_controller(n.strip(), args.seed)]) for n in names]
    for text in texts:
        files = policy_files(text, id)
        policies = [load_policy(file) for file in files]
        label = str(policies[0].about.get("algorithm", policies[0].name))
        label += f" x {len(files)}" if len(files) > 1 else ""
        out.append((label if label not in [n for n, _ in out] else text, policies))
    labels = [name for name, _ in out]
    if len(set(labels)) < len(labels):
        raise ParameterError(f"controllers must differ, got {', '.join(labels)}")
    return out


def policy_files(text: str, id: str) -> list[Path]:
    """The .json files that a file, a folder of `train` or a released name stands for."""
    path = Path(text)
    if path.is_dir():
        files = sorted(path.glob("seed-*/best.json")) or sorted(path.glob("best.json"))
        if not files:
            raise ParameterError(
                f"{path}: no seed-*/best.json in it; give a run of ves-gym train"
            )
        return files
    if not path.suffix and not path.exists():
        known = released(id)
        if text not in known:
            raise ParameterError(
                f"policy {text!r} is no file, and none released for {id}: known are"
                f" {', '.join(known) or 'none'}{did_you_mean(text, known)}"
            )
        return [known[text]]
    return [path]


def _print(result: dict[str, Any], args: argparse.Namespace) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console(width=None if sys.stdout.isatty() else 132, markup=False)
    first = result["controllers"][0]["name"]
    table = Table(title=f"{result['id']}, {args.episodes} episodes from seed {args.seed}")
    table.add_column("controller", no_wrap=True)
    for name in ("return", "success", "failed", "E_mean [J]", "ratio", "E_peak", "E_int"):
        table.add_column(name, justify="right", no_wrap=True)
    for one in result["controllers"]:
        s, ratios = one["summary"], result["ratios"][one["name"]]
        table.add_row(
            one["name"],
            _estimate(s["return"]["iqm"], ".3f"),
            _estimate(s["success"], ".0%"),
            str(s["failed"]),
            _value(s["E_mean"]["median"], ".3g"),
            _estimate(ratios["E_mean"], ".3f"),
            _value(ratios["E_peak"], ".3f"),
            _value(ratios["E_int"], ".3f"),
        )
    console.print(table)
    console.print(
        "return: interquartile mean; E_mean: median; ratio, E_peak, E_int: median of E_mean,"
        f" E_peak, E_int over\nthat of {first} in the same episode. In brackets: 95 %"
        " intervals.",
        style="dim",
    )
    for one in result["controllers"]:
        worse = [b for a, b in result["beats"] if a == one["name"]]
        if worse:
            print(f"{one['name']} beats {', '.join(worse)} (return, intervals apart)")


def _estimate(e: dict[str, Any] | None, form: str) -> str:
    if e is None or e["value"] is None:
        return "-"
    low, high = ("inf" if e[k] is None else format(e[k], form) for k in ("low", "high"))
    return f"{e['value']:{form}} ({low} to {high})"


def _value(e: dict[str, Any] | None, form: str) -> str:
    return "-" if e is None or e["value"] is None else format(e["value"], form)
