"""Fill the board in docs/leaderboard: `python scripts/leaderboard.py [--workers N]`.

Every entry of the table below that docs/leaderboard/entries lacks is answered and added, then
docs/leaderboard/index.html is written. Stopped at any moment, it goes on where it was.
`scripts/results.py` writes the README's table of them.

    --track T       only entries of this track; repeatable
    --problem P     only entries of this problem; repeatable
    --method M      only entries of this method; repeatable
    --board DIR     another folder of entries; the page is written beside it
    --salt FILE     official seeds, of this salt
    --repeat N      run the commands of N entries of the board, drawn at random, and time them
"""

from __future__ import annotations

import argparse
import os
import random
import shlex
import statistics
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import as_completed
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from ves_gym._util.own import import_own
from ves_gym._util.params import ParameterError
from ves_gym._util.process_pool import Workers
from ves_gym.baselines.policy import released, task_name
from ves_gym.baselines.registry import REFERENCES
from ves_gym.leaderboard.board import PLACE as FOLDER
from ves_gym.leaderboard.board import command, make_board, read_board, write_page
from ves_gym.leaderboard.entry import Entry
from ves_gym.leaderboard.problems import (
    GAINS,
    PUBLIC,
    QUICK,
    SCORES,
    UNKNOWN,
    get_problem,
    problems,
    read_salt,
    seeds_of,
)
from ves_gym.leaderboard.tracks.damping import TUNERS
from ves_gym.leaderboard.verify import add, make_entry

ROOT = Path(__file__).parents[1]
PLACE = ROOT / FOLDER
SHOWN = "bent-2s"  # problem of the README's table, and methods, one of each kind
KINDS = ("refined", "calm", "shaped-zv", "drake-torque", "ompl-qt", "straight")
PEER_FILES = ROOT / "examples" / "peers"
AUTHOR = "ves-gym"
PLANNERS = (
    "straight", "smooth-jerk", "shaped-zv", "shaped-zvd", "reaction-null", "direct", "refined",
    "calm", "robust", "robust-worst", "hotspot-q", "hotspot-qt",
    "ompl-time", "ompl-q", "ompl-qt",
)  # fmt: skip
# What one would use instead, each by its own library: entries of author peer. Where a library
# is not installed its methods are left out.
PEER = "peer"
PEERS = {
    "cma_es": ("cma-es",),
    "drake_trajectory": ("drake-acceleration", "drake-torque", "drake-wrench"),
}
LEARNED = ("sb3-ppo", "sb3-sac")  # on tasks in space; trained before they answer
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
BESIDE_UNKNOWN = ("direct", "refined", "adaptive", "oracle")


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
    if track == "paths":
        return (*PLANNERS, *peers())
    if problem == GAINS:
        return TUNERS
    if problem in UNKNOWN:
        return ("zero", "random", *BESIDE_UNKNOWN)
    task = task_name(problem).removesuffix("Emulated")
    beside = BESIDE.get(task, ())
    learned = () if "Emulated" in problem else LEARNED
    return ("zero", "random", REFERENCES[task], *beside, *released(problem), *learned)


@lru_cache
def peers() -> tuple[str, ...]:
    """Names of the peers whose libraries are installed, registered."""
    out: list[str] = []
    for module, names in PEERS.items():
        try:
            import_own(str(PEER_FILES / f"{module}.py"))
        except ParameterError as error:
            print(f"left out: {', '.join(names)}: {error}", file=sys.stderr)
        else:
            out += names
    return tuple(out)


def answer(wanted: Wanted, salt: str | None) -> Entry:
    """The entry of one method."""
    with TemporaryDirectory() as folder:
        place = Path(folder) / "entry"
        if wanted.method in LEARNED:
            file = Path(folder) / f"{wanted.method}.json"
            trainer = import_own(str(PEER_FILES / "sb3.py"))
            environment = get_problem(wanted.track, wanted.problem).environment
            trainer.train(wanted.method, environment, str(file))
            asked = (wanted.track, wanted.problem, [file])
            return make_entry(place, *asked, name=wanted.method, author=PEER, salt=salt)
        author = PEER if wanted.method in peers() else AUTHOR
        return make_entry(place, *wanted, author=author, salt=salt)


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


def repeat(count: int) -> int:
    """Run the commands of entries drawn at random; how many were refused."""
    refused, seconds = 0, []
    entries = read_board(PLACE / "entries")
    for entry in random.Random(0).sample(entries, min(count, len(entries))):
        before, begun = os.times(), time.monotonic()
        words = [sys.executable, "-m", "ves_gym.cli.main", *shlex.split(command(entry))[1:]]
        done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
        after = os.times()
        seconds.append(sum(after[2:4]) - sum(before[2:4]))
        refused += done.returncode != 0
        told = (done.stdout if done.returncode == 0 else done.stderr).strip().splitlines()
        wall = time.monotonic() - begun
        print(f"{seconds[-1]:.0f} s ({wall:.0f} s)  {entry.file}: {told[-1:]}", flush=True)
    print(
        f"{len(seconds) - refused} of {len(seconds)} repeated; median"
        f" {statistics.median(seconds):.0f} s of processor time"
    )
    return refused


def methods_compared() -> str:
    """Return the README's table of one problem, as the board has it."""
    board = make_board(read_board(PLACE / "entries"))
    (group,) = (
        group
        for track in board["tracks"]
        for group in track["groups"]
        if (group["problem"], group["seeds"]) == (SHOWN, PUBLIC)
    )
    rows = ["| | energy | peak acceleration | success | planning |", "|---|---|---|---|---|"]
    for entry in group["entries"]:
        if entry["name"] in KINDS:
            amounts = f"{entry['score'][0]:.3g} | {entry['acceleration']:.2g}"
            price = f"{100 * entry['success'][0]:.0f} % | {entry['seconds']:.2g} s"
            rows.append(f"| `{entry['name']}` | {amounts} | {price} |")
    return "\n".join(rows)


def main(words: Sequence[str]) -> int:
    """See the module's docstring."""
    parser = argparse.ArgumentParser(usage=__doc__)
    parser.add_argument("--workers", type=int, default=1)
    for option in ("--track", "--problem", "--method"):
        parser.add_argument(option, action="append")
    parser.add_argument("--board", type=Path, default=PLACE / "entries")
    parser.add_argument("--salt", type=Path)
    parser.add_argument("--repeat", type=int)
    args = parser.parse_args(words)
    if args.repeat is not None:
        return int(repeat(args.repeat) > 0)
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
