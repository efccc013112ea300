"""`ves-gym leaderboard render`, `check`, `migrate`: the board as a page, and its files."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from ves_gym._util.optional import require
from ves_gym._util.params import ParameterError
from ves_gym.cli.common import write_json

_NEGATIVE = 1


def add_render(subparsers: Any) -> None:
    """Add `render`, `check` and `migrate` to the actions of `ves-gym leaderboard`."""
    parser = subparsers.add_parser(
        "render", help="one HTML page from the entries, and tables beside it"
    )
    parser.add_argument("board", metavar="ENTRIES", help="folder with a file per entry")
    parser.add_argument("--head", metavar="HASH", help="that all entries together must have")
    parser.add_argument("--parquet", action="store_true", help="write Parquet tables as well")
    parser.add_argument("--sqlite", action="store_true", help="write an SQLite file as well")
    parser.set_defaults(action=render)
    parser = subparsers.add_parser(
        "check",
        help="every file of the board and its history in git; exit status 1: faults",
        description="Checks that every file holds what its name says, that names and keys of"
        " authors fit, that no commit changed or removed a file, and that the page beside the"
        " folder ranks no entry by an evaluator of before.",
    )
    parser.add_argument("board", metavar="ENTRIES", help="folder with a file per entry")
    parser.add_argument("--head", metavar="HASH", help="that all entries together must have")
    parser.add_argument(
        "--since", metavar="COMMIT", help="look at commits after it alone, such as origin/main"
    )
    parser.set_defaults(action=check_files)
    parser = subparsers.add_parser(
        "migrate", help="entries of a board of ves_gym 0.1 (board.jsonl) as files"
    )
    parser.add_argument("old", metavar="BOARD.jsonl", help="lines in a hash chain")
    parser.add_argument("board", metavar="ENTRIES", help="folder to write, without entries")
    parser.set_defaults(action=migrate_board)


def render(args: argparse.Namespace) -> int:
    """Check the entries, write the page and the tables."""
    from ves_gym.leaderboard.board import make_board
    from ves_gym.leaderboard.journal import check
    from ves_gym.leaderboard.page import write_page
    from ves_gym.leaderboard.table import write_parquet, write_sqlite

    if args.parquet:
        require("Parquet", "pyarrow")
    path = Path(args.board)
    if not path.exists():
        raise ParameterError(f"{path}: no such board")
    journal = check(path, head=args.head)
    if journal.problems:
        for problem in journal.problems[1:]:
            print(f"{path}: {problem}", file=sys.stderr)
        raise ParameterError(f"{path}: {journal.problems[0]}")
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
        print(f"not ranked: {entry['id']}, {entry['name']}: {entry['why']}")
    print(f"{len(journal.records)} entries, hash {journal.head}")
    for file in files:
        print(f"written {file}")
    write_json(args.json, board)
    return 0


def check_files(args: argparse.Namespace) -> int:
    """Check the files of the board and their history."""
    from ves_gym.leaderboard.audit import page_data, stale_ranked
    from ves_gym.leaderboard.history import history_faults
    from ves_gym.leaderboard.journal import check

    path = Path(args.board)
    if not path.exists():
        raise ParameterError(f"{path}: no such board")
    journal = check(path, head=args.head)
    faults = [*journal.problems, *history_faults(path, since=args.since)]
    page = path.absolute().with_name("index.html")
    if page.exists():
        faults += stale_ranked(page_data(page), journal)
    for fault in faults:
        print(f"{path}: {fault}", file=sys.stderr)
    write_json(
        args.json,
        {"schema": "ves-leaderboard-check/1", "entries": len(journal.records),
         "head": journal.head, "faults": faults},
    )  # fmt: skip
    print(f"{len(journal.records)} entries, {len(faults)} faults, hash {journal.head}")
    return _NEGATIVE if faults else 0


def migrate_board(args: argparse.Namespace) -> int:
    """Write the entries of an older board as files."""
    from ves_gym.leaderboard.journal import migrate

    count = migrate(args.old, args.board)
    write_json(args.json, {"schema": "ves-leaderboard-migrate/1", "entries": count})
    print(f"{count} entries written to {args.board}")
    return 0
