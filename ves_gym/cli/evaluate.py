"""`ves-gym evaluate`: controllers and policies side by side on the same episodes."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from ves_gym.baselines.comparison import Lineup, compare_controllers, line_up
from ves_gym.baselines.registry import CONTROLLERS, get_controller
from ves_gym.cli.common import (
    add_arm_argument,
    add_effect_argument,
    progress,
    with_effects,
    write_json,
)


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
    add_arm_argument(parser, "that of the environment")
    add_effect_argument(parser)


def run(args: argparse.Namespace) -> int:
    """Evaluate, print the table and who beats whom, write JSON."""
    id = args.id if "/" in args.id else f"ves/{args.id}"
    lineup = _lineup(args, id)
    nominal: dict[str, Any] = {"randomize": {}} if args.nominal else {}
    settings = with_effects(id, nominal, args.effect, args.arm)
    with progress() as on_progress:
        comparison = compare_controllers(
            id,
            lineup,
            episodes=args.episodes,
            seed=args.seed,
            n_envs=args.n_envs,
            progress=on_progress,
            **settings,
        )
    result = comparison.to_dict()
    _print(result, args)
    write_json(args.json, result)
    return 0


def _lineup(args: argparse.Namespace, id: str) -> Lineup:
    """Label and controllers (one, or a policy per training seed) of each column."""
    names = args.controller.split(",") if args.controller else []
    controllers = [get_controller(name.strip(), args.seed) for name in names]
    policies = [text if text == "released" else Path(text) for text in args.policy]
    return line_up(id, [*controllers, *policies], args.seed)


def _print(result: dict[str, Any], args: argparse.Namespace) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console(width=None if sys.stdout.isatty() else 132, markup=False)
    first = result["controllers"][0]["name"]
    table = Table(title=f"{result['id']}, {args.episodes} episodes from seed {args.seed}")
    table.add_column("controller", no_wrap=True)
    for name in ("return", "success", "failed", "E_mean [J]", "ratio", "E_peak", "E_int"):
        table.add_column(name, justify="right", no_wrap=True)
    for entry in result["controllers"]:
        s, ratios = entry["summary"], result["ratios"][entry["name"]]
        table.add_row(
            entry["name"],
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
    for entry in result["controllers"]:
        worse = [b for a, b in result["beats"] if a == entry["name"]]
        if worse:
            print(f"{entry['name']} beats {', '.join(worse)} (return, intervals apart)")


def _estimate(e: dict[str, Any] | None, form: str) -> str:
    if e is None or e["value"] is None:
        return "-"
    low, high = ("inf" if e[k] is None else format(e[k], form) for k in ("low", "high"))
    return f"{e['value']:{form}} ({low} to {high})"


def _value(e: dict[str, Any] | None, form: str) -> str:
    return "-" if e is None or e["value"] is None else format(e["value"], form)
