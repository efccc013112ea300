"""Fill the board in docs/leaderboard: `python scripts/leaderboard.py [--workers N]`.

Every entry of the table below is answered, bundled (in out/leaderboard/bundles), verified and
added to docs/leaderboard/entries, its bundle to docs/leaderboard/bundles; then
docs/leaderboard/index.html is written. What is on the board already, for the present version of
its problem, is left alone, so it can be stopped at any moment and goes on where it was.

    --track T       only entries of this track; repeatable
    --problem P     only entries of this problem; repeatable
    --skip WORD     no method whose name begins so; repeatable
    --quick         a tenth of every problem, to try it out on another --board
    --blind DIR     logs, labels and answers of the track discrepancy (out/leaderboard/blind)
    --whole-blind   all 600 cases of that track, not only its 30 (some 17 hours of one core)
    --board DIR     another folder of entries; the page is written beside it
    --salt FILE     official seeds, of the season of this salt (`python scripts/season.py`): its
                    bundles are published when it ends
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass, field, replace
from pathlib import Path

from ves_gym._util.params import ParameterError
from ves_gym._util.process_pool import Workers
from ves_gym.baselines.policy import released, task_name
from ves_gym.baselines.registry import CONTROLLERS, REFERENCES
from ves_gym.leaderboard.board import make_board
from ves_gym.leaderboard.entry import Entry
from ves_gym.leaderboard.errors import BundleError
from ves_gym.leaderboard.evaluators import history_reason, resolve, version_of
from ves_gym.leaderboard.journal import append, read
from ves_gym.leaderboard.page import write_page
from ves_gym.leaderboard.protocol import (
    DURATIONS,
    ENVIRONMENTS,
    MODES,
    QUICK,
    TASKS,
    get_problem,
    read_salt,
    salt_mark,
)
from ves_gym.leaderboard.published import MOST, publish
from ves_gym.leaderboard.run import make_bundle
from ves_gym.leaderboard.tracks.damping import TUNERS
from ves_gym.leaderboard.tracks.selectors import SELECTORS
from ves_gym.leaderboard.verify import bundle_manifest, verify

PLACE = Path(__file__).parents[1] / "docs" / "leaderboard"
BUNDLES = Path("out/leaderboard/bundles")
AUTHOR = "ves_gym"

PLANNERS = (
    "straight", "direct", "refined", "shaped-zv", "shaped-zvd", "smooth-jerk", "reaction-null",
)  # fmt: skip
SEARCHES = ("hotspot-q", "hotspot-qt", "ompl-time", "ompl-q", "ompl-qt")
# Beside the released policies: what can act on a task and is not the same as another there.
BESIDE = {
    "PumaRestToRest": ("zero", "random", "straight", "hotspot", "direct"),
    "PumaReach": ("zero", "random", "hold", "resolved"),
    "PumaReachGoal": ("zero", "random", "hold", "resolved"),
    "PumaTrack": ("zero", "random", "hold", "resolved"),
    "PumaDamp": ("zero", "random", "high", "pped"),
    "FreeFlyerReach": ("zero", "random", "hold"),
    "BeamLQR": ("zero", "random", "hold", "pped", "lqr"),
}
_SLOWEST = ("mppi", "receding", "hotspot")  # a search per episode or period
# Track tasks: beside zero, random, the task's reference and the released policies. Left out is
# what does as another one here (`straight` as zero, `hold` where zero holds), gains tuned for
# every start (`tuned`), which solve none, and what plans for 1.5 to 4 s of one core per episode
# beside other searches (`hotspot`, `robust`, `ilqr`): an hour and more for all of them.
SOLVING = {
    "PumaRestToRest": ("refined", "adaptive", "mppi"),
    "PumaReach": ("closing", "homing", "resolved-gentle", "braced"),
    "PumaReachGoal": ("closing", "homing", "resolved-gentle", "braced"),
    "PumaTrack": ("closing", "resolved-gentle", "braced"),
    "PumaDamp": ("high", "pped", "receding"),
    "BeamLQR": ("hold", "pped", "lqi"),
    "FreeFlyerReach": ("resolved-gentle", "braced"),
    "MacroMicro": ("resolved-gentle", "braced"),
    "PoseReach": ("closing-pose",),
    "PayloadTransfer": ("resolved-gentle", "braced"),
}
# Bytes of a published bundle of that track: of a controller, which anyone runs again, and of a
# policy, with its weights.
MOST_OF_TASKS = {"controller": 60_000, "policy": 300_000}


@dataclass(frozen=True)
class Wanted:
    """An entry that the board should have."""

    track: str
    problem: str
    method: str
    level: str = "reproduced"
    salt: str | None = field(default=None, repr=False)  # of official seeds

    @property
    def bundle(self) -> Path:
        """Where its bundle is kept."""
        words = f"{self.track}-{self.problem.removeprefix('ves/')}-{self.method}"
        if self.salt is not None:
            words += f"-{salt_mark(self.salt)[:12]}"
        return BUNDLES / f"{words}.zip"

    def __str__(self) -> str:
        return f"{self.track} {self.problem} {self.method}"


def table(whole_blind: bool) -> list[Wanted]:
    """All of them, quick ones first.

    Args:
        whole_blind: the 600 cases of the track discrepancy too, beside the 30.
    """
    acting = {
        mode: [
            (f"ves/{task}{mode}-v0", name)
            for task in ENVIRONMENTS
            for name in (*BESIDE[task], *released(f"ves/{task}-v0"))
        ]
        for mode in ("", "Emulated")
    }

    def episodes(mode: str) -> list[Wanted]:
        damp = [Wanted("damping", id, k) for id, k in acting[mode] if "/PumaDamp" in id]
        return damp + [Wanted("policies", id, name) for id, name in acting[mode]]

    def tasks(emulated: bool) -> list[Wanted]:
        ids = [f"ves/{name}" for name in TASKS if ("Emulated" in name) == emulated]
        return [
            Wanted("tasks", id, name)
            for id in ids
            for task in [task_name(id).removesuffix("Emulated")]
            for name in (
                "zero",
                "random",
                REFERENCES[task],
                *SOLVING.get(task, ()),
                *released(id),
            )
        ]

    def paths(mode: str, planners: Sequence[str]) -> list[Wanted]:
        return [
            Wanted("paths", f"reach100-{duration}{mode}", name)
            for name in planners
            for duration in DURATIONS
        ]

    whole = [
        *episodes(""),
        *tasks(emulated=False),
        *paths(MODES[0], PLANNERS),
        *episodes("Emulated"),
        *tasks(emulated=True),
        *paths(MODES[1], PLANNERS),
        *(Wanted("damping", "pped-bent", name) for name in TUNERS),
        *(w for mode in MODES for w in paths(mode, SEARCHES)),
        *(Wanted("discrepancy", f"blind-development{QUICK}", k) for k in SELECTORS),
        *(Wanted("discrepancy", "blind-development", k) for k in SELECTORS if whole_blind),
    ]
    return sorted(whole, key=lambda w: w.method in _SLOWEST)


def prove(wanted: Wanted, blind: Path | None) -> Entry:
    """Answer, bundle and verify; a bundle that is there and of this evaluator is kept."""
    if not _current(wanted):
        wanted.bundle.unlink(missing_ok=True)
        id = wanted.problem
        files = released(id.removesuffix(QUICK)) if id.startswith("ves/") else {}
        built_in = wanted.method in CONTROLLERS or wanted.method not in files
        make_bundle(
            wanted.bundle,
            wanted.track,
            wanted.problem,
            wanted.method if built_in else [files[wanted.method]],
            author=AUTHOR,
            salt=wanted.salt,
            folder=blind,
        )
    return verify(wanted.bundle, level=wanted.level, salt=wanted.salt, folder=blind)


def prove_each(together: Sequence[Wanted], blind: Path | None) -> list[Entry | Exception]:
    """Prove one after another; of one that fails the error."""
    out: list[Entry | Exception] = []
    for wanted in together:
        try:
            out.append(prove(wanted, blind))
        except Exception as error:  # it keeps no other from the board
            out.append(error)
    return out


def in_jobs(wanted: Sequence[Wanted]) -> list[list[Wanted]]:
    """Return what each job proves: all selectors of a problem read the same diagnoses.

    Side by side each would make them, all of them at the same time.
    """
    jobs: dict[object, list[Wanted]] = {}
    for w in wanted:
        jobs.setdefault(w.problem if w.track == "discrepancy" else w, []).append(w)
    return list(jobs.values())


def _quick(problem: str) -> str:
    return problem.removesuffix(QUICK) + QUICK


def _current(wanted: Wanted) -> bool:
    """Whether its bundle is there, whole, and made by the evaluator of today's version."""
    if not wanted.bundle.exists():
        return False
    try:
        manifest, _ = bundle_manifest(wanted.bundle)
    except BundleError:
        return False
    return _of_today(wanted, manifest["spec"]["evaluator"])


def _of_today(wanted: Wanted, evaluator: str) -> bool:
    """Return whether an evaluator is of the present version of an entry's problem."""
    problem = get_problem(wanted.track, wanted.problem)
    return resolve(problem.track, problem.base, evaluator) == version_of(problem)


def missing(wanted: Sequence[Wanted], board: Path) -> list[Wanted]:
    """Return those that are not on the board, or by the evaluator of another version.

    Args:
        wanted: entries that the board should have.
        board: the folder of its entries.
    """
    there = {
        (e["track"], e["problem"], e["name"], e["about"].get("salt"))
        for e in (record.entry for record in read(board).records)
        if e["author"] == AUTHOR and history_reason(e) is None
    }
    marks = {w.salt: None if w.salt is None else salt_mark(w.salt) for w in wanted}
    return [w for w in wanted if (w.track, w.problem, w.method, marks[w.salt]) not in there]


def fill(wanted: Sequence[Wanted], board: Path, workers: int, blind: Path | None) -> int:
    """Prove what is missing and append it, as soon as a job is done; how many failed."""
    todo, failed, begun = missing(wanted, board), 0, time.monotonic()
    print(f"{len(wanted) - len(todo)} of {len(wanted)} entries are on the board", flush=True)
    with Workers(workers) as pool:  # diagnoses have workers of their own
        jobs = {pool.submit(prove_each, part, blind): part for part in in_jobs(todo)}
        each = ((job, k) for job in as_completed(jobs) for k in range(len(jobs[job])))
        for done, (job, k) in enumerate(each, 1):
            w, entry = jobs[job][k], job.exception() or job.result()[k]
            if isinstance(entry, BaseException):
                failed += 1
                told = f"FAILED: {entry}"
            else:
                record = append(board, entry.shortened())
                told = entry.level
                most = MOST_OF_TASKS[entry.kind] if entry.track == "tasks" else MOST
                place = w.bundle
                if w.salt is None and not publish(board, record, place, most):
                    told += ", bundle too large to publish"
            seconds = time.monotonic() - begun
            print(f"{done}/{len(todo)} {seconds:.0f} s  {w}: {told}", flush=True)
    return failed


def main(words: Sequence[str]) -> int:
    """See the module's docstring."""
    parser = argparse.ArgumentParser(usage=__doc__)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--track", action="append")
    parser.add_argument("--problem", action="append")
    parser.add_argument("--skip", action="append", default=[])
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--blind", type=Path)
    parser.add_argument("--whole-blind", action="store_true")
    parser.add_argument("--board", type=Path, default=PLACE / "entries")
    parser.add_argument("--salt", type=Path)
    args = parser.parse_args(words)
    salt = None if args.salt is None else read_salt(args.salt)
    if args.whole_blind and salt is not None:
        raise ParameterError("the public cases of the discrepancy track take no --salt")
    wanted = [
        replace(w, problem=_quick(w.problem) if args.quick else w.problem, salt=salt)
        for w in table(args.whole_blind and not args.quick)
        if (args.track is None or w.track in args.track)
        and (args.problem is None or w.problem in args.problem)
        and not w.method.startswith(tuple(args.skip))
        and not (w.track == "discrepancy" and salt is not None)  # of public cases alone
    ]
    try:
        return int(fill(wanted, args.board, args.workers, args.blind) > 0)
    except KeyboardInterrupt:
        return 130
    finally:  # of what is there, also when it was stopped
        page = args.board.with_name("index.html")
        journal = read(args.board)
        write_page(make_board(journal), page)
        print(f"{len(journal.records)} entries, hash {journal.head}; written {page}")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
