"""Fill the board in docs/leaderboard: `python scripts/leaderboard.py [--workers N]`.

Every entry of the table below that docs/leaderboard/entries lacks is answered and added, then
docs/leaderboard/index.html is written. Stopped at any moment, it goes on where it was.

    --track T       only entries of this track; repeatable
    --problem P     only entries of this problem; repeatable
    --method M      only entries of this method; repeatable
    --board DIR     another folder of entries; the page is written beside it
    --salt FILE     official seeds, of this salt
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from concurrent.futures import as_completed
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from ves_gym._util.process_pool import Workers
from ves_gym.baselines.policy import released, task_name
from ves_gym.baselines.registry import REFERENCES
from ves_gym.leaderboard.board import make_board, read_board, write_page
from ves_gym.leaderboard.entry import Entry
from ves_gym.leaderboard.problems import (
    QUICK,
    SCORES,
    get_problem,
    problems,
    read_salt,
    seeds_of,
)
from ves_gym.leaderboard.tracks.damping import TUNERS
from ves_gym.leaderboard.verify import add, make_entry

PLACE = Path(__file__).parents[1] / "docs" / "leaderboard"
AUTHOR = "ves-gym"
PLANNERS = (
    "straight", "smooth-jerk", "shaped-zv", "shaped-zvd", "reaction-null", "direct", "refined",
    "hotspot-q", "hotspot-qt", "ompl-time", "ompl-q", "ompl-qt",
)  # fmt: skip
# Beside zero, random, the task's reference and the released policies: what acts on a task, is
# not the same as another there, and plans for less than a second per episode.
BESIDE = {
    "PumaRestToRest": ("refined", "adaptive", "mppi"),
    "PumaReach": ("closing", "resolved-gentle", "braced"),
    "PumaReachGoal": ("closing", "resolved-gentle", "braced"),
    "PumaTrack": ("closing", "resolved-gentle", "braced"),
    "PumaDamp": ("high", "pped", "receding"),
    "BeamLQR": ("hold", "pped", "lqi"),
    "FreeFlyerReach": ("resolved-gentle", "braced"),
    "MacroMicro": ("resolved-gentle", "braced"),
    "PoseReach": ("closing-pose",),
    "PayloadTransfer": ("resolved-gentle", "braced"),
}


class Wanted(NamedTuple):
    """An entry that the board should have."""

    track: str
    problem: str
    method: str


def table() -> list[Wanted]:
    """All of them, by track and problem."""
    return [
        Wanted(track, problem, method)
        for track in SCORES
        for problem in problems(track)
        if not problem.endswith(QUICK)
        for method in methods(track, problem)
    ]


def methods(track: str, problem: str) -> tuple[str, ...]:
    """Methods of ours that answer a problem."""
    if not problem.startswith("ves/"):
        return PLANNERS if track == "paths" else TUNERS
    task = task_name(problem).removesuffix("Emulated")
    beside = BESIDE.get(task, ())
    return ("zero", "random", REFERENCES[task], *beside, *released(problem))


def answer(wanted: Wanted, salt: str | None) -> Entry:
    """The entry of one method."""
    with TemporaryDirectory() as folder:
        return make_entry(Path(folder) / "entry", *wanted, author=AUTHOR, salt=salt)


def fill(wanted: Sequence[Wanted], board: Path, workers: int, salt: str | None) -> int:
    """Answer what is missing and add it as soon as it is done; how many failed."""
    there = {(e.track, e.problem, e.name, e.seeds) for e in read_board(board)}
    todo = [w for w in wanted if (*w, seeds_of(get_problem(*w[:2]), salt).name) not in there]
    print(f"{len(wanted) - len(todo)} of {len(wanted)} entries are on the board", flush=True)
    failed, begun = 0, time.monotonic()
    with Workers(workers) as pool:
        jobs = {pool.submit(answer, w, salt): w for w in todo}
        for done, job in enumerate(as_completed(jobs), 1):
            error = job.exception()  # it keeps no other from the board
            failed += error is not None
            if error is None:
                add(board, job.result())
            told = "added" if error is None else f"FAILED: {error}"
            seconds = time.monotonic() - begun
            print(
                f"{done}/{len(todo)} {seconds:.0f} s  {' '.join(jobs[job])}: {told}", flush=True
            )
    return failed


def main(words: Sequence[str]) -> int:
    """See the module's docstring."""
    parser = argparse.ArgumentParser(usage=__doc__)
    parser.add_argument("--workers", type=int, default=1)
    for option in ("--track", "--problem", "--method"):
        parser.add_argument(option, action="append")
    parser.add_argument("--board", type=Path, default=PLACE / "entries")
    parser.add_argument("--salt", type=Path)
    args = parser.parse_args(words)
    salt = None if args.salt is None else read_salt(args.salt)
    wanted = [
        w
        for w in table()
        if all(
            asked is None or value in asked
            for value, asked in zip(w, (args.track, args.problem, args.method), strict=True)
        )
    ]
    args.board.mkdir(parents=True, exist_ok=True)
    try:
        return int(fill(wanted, args.board, args.workers, salt) > 0)
    except KeyboardInterrupt:
        return 130
    finally:  # of what is there, also when it was stopped
        entries = read_board(args.board)
        page = args.board.with_name("index.html")
        write_page(make_board(entries), page)
        print(f"{len(entries)} entries; written {page}")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
