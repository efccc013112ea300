"""`ves-gym leaderboard`: entries that anybody can repeat, their verification, and the board."""

from __future__ import annotations

import argparse
import importlib
import statistics
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ves_gym._util.one_line import on_one_line
from ves_gym._util.params import Array, ParameterError
from ves_gym.cli.common import progress, write_json

_NEGATIVE = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.description = (
        "Entries that anybody can repeat, their verification, and the board. Problems, scores"
        " and rules: docs/leaderboard.md. To enter: run, then verify what it wrote."
    )
    actions = parser.add_subparsers(dest="action_name", metavar="ACTION", required=True)
    _add_run(actions)
    _add_verify(actions)
    _add_render(actions)
    for action in actions.choices.values():  # what every command takes, after the action too
        for option, name in (("--json", "FILE"), ("--out", "DIR")):
            action.add_argument(
                option, metavar=name, default=argparse.SUPPRESS, help=argparse.SUPPRESS
            )


def run(args: argparse.Namespace) -> int:
    """Carry out the action."""
    status: int = args.action(args)
    return status


def _add_run(actions: Any) -> None:
    parser = actions.add_parser(
        "run",
        help="answer a problem and write the entry",
        description="Answers a problem and writes the entry, a folder (in --out). A first try"
        " of a tenth of the questions: ves-gym leaderboard run paths bent-2s-quick direct",
    )
    parser.add_argument("track", help="paths, tasks or damping")
    parser.add_argument("problem", help="of the track, such as bent-2s (docs/leaderboard.md)")
    parser.add_argument(
        "method",
        nargs="+",
        help="a built-in planner, controller or tuner; policies: .json files, a folder of"
        " ves-gym train, or the name of a released one; or one's own, as module:Name",
    )
    parser.add_argument(
        "--seeds", metavar="A,B", default="0", help="of the method: 0,1,... (0)"
    )
    parser.add_argument("--name", help="on the board; default the method's")
    parser.add_argument("--author", default="anonymous", help="on the board")
    parser.add_argument(
        "--training", metavar="KEY=VALUE", action="append", default=[],
        help="what the method took to make, told on the board; repeatable",
    )  # fmt: skip
    _add_shared(parser)
    parser.set_defaults(action=_run)


def _add_verify(actions: Any) -> None:
    parser = actions.add_parser(
        "verify",
        help="check an entry; exit status 1: refused",
        description="Believes nothing of an entry that can be computed, and runs nothing that"
        " is in it: a built-in method or a policy answers again, what was recorded of another"
        " is simulated again.",
    )
    parser.add_argument("entry", help="folder that run wrote, or a file of the board")
    parser.add_argument("--board", metavar="ENTRIES", help="folder of the board to add it to")
    _add_shared(parser)
    parser.set_defaults(action=_verify)


def _add_render(actions: Any) -> None:
    parser = actions.add_parser("render", help="one HTML page from the entries")
    parser.add_argument("board", metavar="ENTRIES", help="folder with a file per entry")
    parser.set_defaults(action=_render)


def _add_shared(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--salt", metavar="FILE", help="the maintainer's, of official seeds")
    parser.add_argument(
        "--workers", type=int, default=1, metavar="N", help="processes that plan (1)"
    )


# ------------------------------------------------------------------------------ actions


def _run(args: argparse.Namespace) -> int:
    from ves_gym.leaderboard.problems import get_problem
    from ves_gym.leaderboard.run import make_entry

    get_problem(args.track, args.problem)  # before anything of one's own is loaded
    own = _own(args.method)
    label = args.name or (own.name if own is not None else Path(args.method[0]).stem)
    stem = "_".join((args.track, args.problem.removeprefix("ves/"), args.author, label))
    folder = Path(args.out or "out/leaderboard") / stem
    with progress() as on_progress:
        entry = make_entry(
            folder,
            args.track,
            args.problem,
            own if own is not None else args.method if len(args.method) > 1 else args.method[0],
            name=args.name,
            author=args.author,
            seeds=_seeds(args.seeds),
            salt=_salt(args.salt),
            training=_training(args.training),
            workers=_workers(args),
            progress=on_progress,
        )
    write_json(args.json, {"schema": "ves-leaderboard-run/1", "folder": str(folder)})
    print(f"{entry.name} on {entry.problem}: {_summary(entry.results['score'])}")
    print(f"written {folder}")
    return 0


def _verify(args: argparse.Namespace) -> int:
    from ves_gym.leaderboard.errors import Refused
    from ves_gym.leaderboard.verify import add, verify

    try:
        with progress() as on_progress:
            entry = verify(
                args.entry,
                salt=_salt(args.salt),
                workers=_workers(args),
                progress=on_progress,
            )
    except Refused as refused:
        print(f"ves-gym: rejected: {on_one_line(str(refused))}", file=sys.stderr)
        return _NEGATIVE
    place = None if args.board is None else add(args.board, entry)
    write_json(args.json, entry.to_dict())
    print(f"{entry.level}: {entry.name} on {entry.problem}: {_summary(entry.results['score'])}")
    if place is not None:
        print(f"written {place}")
    return 0


def _render(args: argparse.Namespace) -> int:
    from ves_gym.leaderboard.board import make_board, read_board
    from ves_gym.leaderboard.page import write_page

    entries = read_board(args.board)
    board = make_board(entries)
    file = Path(args.out or "out/leaderboard") / "index.html"
    write_page(board, file)
    write_json(args.json, board)
    print(f"{len(entries)} entries\nwritten {file}")
    return 0


# ---------------------------------------------------------------------------- arguments


def _own(words: Sequence[str]) -> Any:
    """The object that module:Name stands for, made if it is a class; None of other words."""
    module, colon, name = words[0].partition(":")
    if len(words) > 1 or not (colon and name.isidentifier()):
        return None
    try:
        made = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError) as error:
        raise ParameterError(f"{words[0]}: cannot be loaded: {error}") from None
    return made() if isinstance(made, type) else made


def _seeds(text: str) -> tuple[int, ...]:
    try:
        return tuple(int(k) for k in text.split(","))
    except ValueError:
        raise ParameterError(
            f"--seeds must be whole numbers >= 0 like 0,1,2, got {text!r}"
        ) from None


def _salt(path: str | None) -> str | None:
    from ves_gym.leaderboard.seeds import read_salt

    return None if path is None else read_salt(path)


def _training(pairs: Sequence[str]) -> dict[str, str] | None:
    out = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not (key and equals):
            raise ParameterError(f"--training must be KEY=VALUE, got {pair!r}")
        out[key] = value
    return out or None


def _workers(args: argparse.Namespace) -> int:
    if args.workers < 1:
        raise ParameterError(f"--workers must be >= 1, got {args.workers}")
    workers: int = args.workers
    return workers


def _summary(scores: Array) -> str:
    good = scores[np.isfinite(scores)].tolist()
    middle = f"median score {statistics.median(good):.4g}, " if good else ""
    return f"{middle}{len(good)} of {scores.size} with a score"
