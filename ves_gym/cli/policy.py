"""`ves-gym policy`: policies for other engines (ONNX), and their model cards."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ves_gym._util.params import ParameterError, read_table, write_text
from ves_gym.cli.common import write_json

SCHEMA = "ves-policy-command/1"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    actions = parser.add_subparsers(dest="action_name", metavar="ACTION", required=True)
    export = actions.add_parser("export", help="write policies as ONNX, actions compared")
    export.add_argument("--onnx", action="store_true", help="the format (the only one)")
    export.set_defaults(action=_export)
    card = actions.add_parser("card", help="write the model cards of policies (Markdown)")
    card.add_argument(
        "--figures",
        metavar="PATH",
        help="evaluation of the policy as JSON (`ves-gym evaluate --json`), or a folder with"
        " one per policy, such as docs/training; default: evaluate it now",
    )
    card.add_argument(
        "--episodes", type=int, default=100, metavar="N", help="of that evaluation (100)"
    )
    card.set_defaults(action=_card)
    for action in (export, card):
        action.add_argument(
            "policies",
            metavar="POLICY",
            nargs="*",
            help="a .json file or a released one, such as PumaDamp/ppo; none: all released",
        )
        for option, name in (("--json", "FILE"), ("--out", "DIR")):
            action.add_argument(
                option, metavar=name, default=argparse.SUPPRESS, help=argparse.SUPPRESS
            )


def run(args: argparse.Namespace) -> int:
    """Carry out the action."""
    status: int = args.action(args)
    return status


def _names(args: argparse.Namespace) -> list[str]:
    from ves_gym.baselines.policy import RELEASED

    released = sorted(
        path.relative_to(RELEASED).with_suffix("").as_posix()
        for path in RELEASED.glob("*/*.json")
    )
    return args.policies or released


def _file(name: str, suffix: str) -> str:
    """Name of a file about a policy: PumaDamp-ppo.md."""
    return str(Path(name).with_suffix("")).strip("./").replace("/", "-") + suffix


def _export(args: argparse.Namespace) -> int:
    from ves_gym.baselines.onnx_file import write_onnx
    from ves_gym.baselines.policy import load_policy

    if not args.onnx:
        raise ParameterError("policy export needs --onnx, the one format that it writes")
    folder = Path(args.out or "out/policies")
    rows: list[dict[str, Any]] = []
    for name in _names(args):
        path = folder / _file(name, ".onnx")
        gap = write_onnx(load_policy(name), path)
        print(f"{path}: actions within {gap:.1g} of {name}")
        rows.append({"policy": name, "path": str(path), "difference": gap})
    write_json(args.json, {"schema": SCHEMA, "onnx": rows})
    return 0


def _card(args: argparse.Namespace) -> int:
    from ves_gym.report.policy_card import policy_card

    folder = Path(args.out or "out/policies")
    rows = []
    for name in _names(args):
        text = policy_card(name, _figures(args, name))
        path = folder / _file(name, ".md")
        write_text(path, text)
        print(path)
        rows.append({"policy": name, "path": str(path)})
    write_json(args.json, {"schema": SCHEMA, "cards": rows})
    return 0


def _figures(args: argparse.Namespace, name: str) -> dict[str, Any]:
    """An evaluation of a policy, read or made."""
    if args.figures is not None:
        path = Path(args.figures)
        return read_table(path / _file(name, ".json") if path.is_dir() else path)
    from ves_gym.baselines.controllers import Random, Zero
    from ves_gym.baselines.evaluate import evaluate, report
    from ves_gym.baselines.policy import load_policy

    policy = load_policy(name)
    env = policy.about.get("env")
    if not isinstance(env, str):
        raise ParameterError(f"{name}: names no environment; give its --figures")
    policy.name = str(policy.about.get("algorithm", policy.name))
    given = dict(policy.about.get("settings", {}))
    return report(
        [
            evaluate(c, env, episodes=args.episodes, seed=args.seed, **given)
            for c in (Zero(), Random(), policy)
        ]
    )
