"""`ves-gym leaderboard render`: the journal as a page, and as tables."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from ves_gym._util.optional import require
from ves_gym._util.params import ParameterError
from ves_gym.cli.common import write_json


def add_render(subparsers: Any) -> None:
    """Add `render` to the actions of `ves-gym leaderboard`."""
    parser = subparsers.add_parser(
        "render", help="one HTML page from the journal, and tables beside it"
    )
    parser.add_argument("board", metavar="BOARD.jsonl", help="the journal")
    parser.add_argument("--head", metavar="HASH", help="hash that its last line must have")
    parser.add_argument("--parquet", action="store_true", help="write Parquet tables as well")
    parser.add_argument("--sqlite", action="store_true", help="write an SQLite file as well")
    parser.set_defaults(action=render)


def render(args: argparse.Namespace) -> int:
    """Check the journal, write the page and the tables."""
    from ves_gym.leaderboard.board import make_board
    from ves_gym.leaderboard.journal import check
    from ves_gym.leaderboard.page import write_page
    from ves_gym.leaderboard.table import write_parquet, write_sqlite

    if args.parquet:
        require("Parquet", "pyarrow")
    path = Path(args.board)
    if not path.is_file():
        raise ParameterError(f"{path}: no such journal")
    journal = check(path, head=args.head)
    if journal.problems:
        for problem in journal.problems[1:]:
            print(f"{path}: {problem}", file=sys.stderr)
        raise ParameterError(f"{path}: {journal.problems[0]}")
    if journal.torn:
        print(
            f"ves-gym: warning: {path}: the last line was cut short ({len(journal.torn)} bytes)"
            " and is left out",
            file=sys.stderr,
        )
    board = make_board(journal)
    folder = Path(args.out or "out/leaderboard")
    files = [folder / "index.html"]
    write_page(board, files[0])
    if args.parquet:
        files += write_parquet(journal, folder)
    if args.sqlite:
        files.append(folder / "board.sqlite")
        write_sqlite(journal, files[-1])
    for entry in board["unranked"]:
        print(f"not ranked: line {entry['line']}, {entry['name']}: {entry['why']}")
    print(f"{len(journal.records)} entries, last hash {journal.head}")
    for file in files:
        print(f"written {file}")
    write_json(args.json, board)
    return 0
