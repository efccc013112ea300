"""`ves-gym leaderboard`: entries that anybody can repeat, their verification, and the board."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ves_gym._util.one_line import on_one_line
from ves_gym._util.own import own_object
from ves_gym._util.params import Array
from ves_gym.cli.flags import Answer, Context, Flag, integer, integers, path, read, say, text


def make(
    at: Context,
    track: str,
    problem: str,
    method: Sequence[str],
    *,
    name: str | None = None,
    author: str = "anonymous",
    training: Sequence[tuple[str, str]] = (),
    **how: Any,
) -> Answer:
    """Answer a problem and write the entry; a tenth of the queries, for a first try: ves-gym
    leaderboard run paths bent-2s-quick direct.
    """
    from ves_gym.leaderboard.problems import get_problem
    from ves_gym.leaderboard.verify import make_entry

    get_problem(track, problem)  # before a method of the user's is loaded
    chosen = list(method) if len(method) > 1 else own_object(method[0])
    label = name or (Path(method[0]).stem if isinstance(chosen, (str, list)) else chosen.name)
    stem = "_".join((track, problem.removeprefix("ves/"), author, label))
    folder = at.folder("out/leaderboard") / stem
    entry = make_entry(
        folder, track, problem, chosen, name=name, author=author,
        training=dict(training) or None, progress=at.progress, **how,
    )  # fmt: skip
    return Answer(
        text=f"{entry.name} on {entry.problem}: {_summary(entry.results['score'])}",
        plain={"schema": "ves-leaderboard-run/1", "folder": str(folder)},
        then=[["leaderboard", "verify", folder]],
    )


def check(at: Context, entry: str, *, board: Path | None = None, **how: Any) -> Answer:
    """Check an entry (exit status 1: refused): a built-in method or a policy answers again,
    the recording of any other is simulated again; no code of an entry runs.
    """
    from ves_gym.leaderboard.entry import Refused
    from ves_gym.leaderboard.verify import add, verify_entry

    try:
        checked = verify_entry(entry, progress=at.progress, **how)
    except Refused as refused:
        say(on_one_line(str(refused)), "rejected")
        return Answer(negative=True)
    text = f"{checked.level}: {checked.name} on {checked.problem}:"
    text += f" {_summary(checked.results['score'])}"
    if board is not None:
        text += f"\nadded: {add(board, checked)}"
    return Answer(text=text, plain=checked.to_dict())


def render(at: Context, entries: Path) -> Answer:
    """Write one HTML page from the entries."""
    from ves_gym.leaderboard.board import make_board, read_board, write_page

    listed = read_board(entries)
    board = make_board(listed)
    file = at.folder("out/leaderboard") / "index.html"
    write_page(board, file)
    return Answer(text=f"{len(listed)} entries", plain=board, files=[file])


def _training(value: str) -> tuple[str, str]:
    key, equals, figure = value.partition("=")
    if not (key and equals):
        raise ValueError
    return key, figure


def _salt(file: str) -> str:
    from ves_gym.leaderboard.problems import read_salt

    return read_salt(file)


SHARED = (
    Flag("--salt", "FILE", read(_salt), "the maintainer's, of official seeds"),
    Flag("--workers", "N", integer(1), "processes that plan (1)"),
)


def _summary(scores: Array) -> str:
    good = scores[np.isfinite(scores)].tolist()
    middle = f"median score {statistics.median(good):.4g}, " if good else ""
    return f"{middle}{len(good)} of {scores.size} with a score"


TABLE = {
    "leaderboard run": (make, (
        Flag("TRACK", help="paths, tasks or damping"),
        Flag("PROBLEM", help="of the track, such as bent-2s (docs/leaderboard.md)"),
        Flag("METHOD", many=True,
             help="a built-in planner, controller or tuner; policies: .json files, a folder of"
             " ves-gym train, or the name of a released one; or one's own, as module:Name"),
        Flag("--seeds", "A,B", integers, "of the method: 0,1,... (0)"),
        Flag("--name", "N", text, "on the board; default the method's"),
        Flag("--author", "A", text, "on the board"),
        Flag("--training", "KEY=VALUE", read(_training, "KEY=VALUE"),
             "what the method took to make, for the board; repeatable", many=True),
        Flag("--code", "URL", text, "of the method's source; default its module"),
        *SHARED,
    )),
    "leaderboard verify": (check, (
        Flag("ENTRY", help="folder that run wrote, or a file of the board"),
        Flag("--board", "ENTRIES", path, "folder of the board to add it to"),
        *SHARED,
    )),
    "leaderboard render": (
        render, (Flag("ENTRIES", read=path, help="folder with a file per entry"),)
    ),
}  # fmt: skip
