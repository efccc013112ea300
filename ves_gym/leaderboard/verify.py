"""`leaderboard run`: answer a problem and write the entry; `verify`: believe nothing of it.

Where there is a recording its answers are simulated again, and no submitted code runs: level
*replayed*. Else the method, built in or policies in a safe format, answers again: level
*reproduced*. The results of the entry that comes out are those computed here.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ves_gym._util.params import ParameterError, write_bytes
from ves_gym._util.threads import on_one_thread
from ves_gym.baselines.controllers import Controller
from ves_gym.baselines.policy import versions
from ves_gym.leaderboard.entry import (
    LEVELS,
    Code,
    Entry,
    Method,
    Refused,
    Results,
    from_bytes,
    refusing,
    to_bytes,
)
from ves_gym.leaderboard.files import (
    ENTRY,
    RECORDING,
    pack,
    read_files,
    unfinished,
    unpack,
    write_files,
)
from ves_gym.leaderboard.methods import answering, enter
from ves_gym.leaderboard.problems import PUBLIC, Problem, Seeds, get_problem, seeds_of
from ves_gym.leaderboard.statistics import repeated
from ves_gym.leaderboard.tracks.base import (
    Answers,
    BoardTrack,
    Progress,
    no_progress,
    require_settings,
)
from ves_gym.leaderboard.tracks.damping import GainTrack, Tuner
from ves_gym.leaderboard.tracks.paths import PathTrack
from ves_gym.leaderboard.tracks.tasks import DampTrack, TaskTrack
from ves_gym.planners.query import Planner

_NUMBERS = ValueError, ArithmeticError  # of what no simulation can carry on with
_ABSOLUTE = 1e-9
_RELATIVE = 1e-4, 1e-3  # of a score and of a measure: the file holds five and four digits
_FLIPPED = 0.01  # share of episodes that may be off: a threshold that rounding crosses
# Rounding can lead a search into another valley, and then which of two motions has the higher
# peak does not matter: of planners and tuners that answer again, scores alone are compared.
_SEARCHED = (0.01, 0.05)  # relative, share


def make_entry(
    folder: str | os.PathLike[str],
    track: str,
    problem: str,
    method: str | Planner | Controller | Tuner | Sequence[str | os.PathLike[str]],
    *,
    name: str | None = None,
    author: str = "anonymous",
    seeds: Sequence[int] = (0,),
    salt: str | None = None,
    training: Mapping[str, Any] | None = None,
    code: str | None = None,
    workers: int = 1,
    progress: Progress = no_progress,
) -> Entry:
    """Answer a problem and write the entry.

    Args:
        folder: new or empty; gets `entry.json`, files of policies, and the recording of a
            method of one's own.
        track, problem: see `problems`.
        method: name of a built-in planner, controller or tuner, or of a released policy; files
            of policies; or a planner, a controller or a function that finds gains.
        name: on the board; default the method's.
        author: on the board.
        seeds: of the method, 0, 1, ... in order: one group of results each. Policies: one per
            file, as they state it.
        salt: of the official seeds; None for the public ones.
        training: what it took to make the method, plain data; default what policies state.
        code: address of the method's source; default its module.
        workers: processes that plan.
        progress: called with the stage and the fraction done.

    Returns:
        The entry.
    """
    folder = Path(folder)
    unfinished(folder)  # one in use is refused before the work, not after it
    question = get_problem(track, problem)
    drawn, entered = seeds_of(question, salt), enter(question, method, seeds)
    rules = track_of(question, drawn, entered.method, workers)
    with on_one_thread():  # as `verify_entry` does
        answers = rules.answer(entered.agents, progress)
        results = rules.results(answers)
    if (twice := repeated(results, entered.method.kind)) is not None:
        raise ParameterError(
            f"groups {twice[0]} and {twice[1]} do the same, and one of them would count twice:"
            " leave it out"
        )
    stated = {"training": training and dict(training), "code": code}
    about = {key: value for key, value in stated.items() if value is not None}
    entry = Entry(
        track=track,
        problem=problem,
        name=name or entered.name,
        author=author,
        level="reproduced" if entered.built_in else "replayed",
        seeds=drawn.name,
        method=entered.method,
        results=dict(results),
        about={"versions": versions(), **entered.about, **about},
    )
    files = {ENTRY: to_bytes(entry), **entered.files}
    if not entered.built_in:
        files[RECORDING] = pack(answers.recording)
    write_files(folder, files)
    return entry


def track_of(problem: Problem, seeds: Seeds, method: Method, workers: int) -> BoardTrack:
    """The track of a problem that a method answers; `workers` are processes that plan."""
    arguments = problem, seeds, method, workers
    if problem.track == "paths":
        return PathTrack(*arguments)
    if problem.track == "tasks":
        return TaskTrack(*arguments)
    return GainTrack(*arguments) if problem.environment is None else DampTrack(*arguments)


@on_one_thread()
def verify_entry(
    path: str | os.PathLike[str],
    *,
    salt: str | None = None,
    workers: int = 1,
    progress: Progress = no_progress,
) -> Entry:
    """Check an entry.

    Args:
        path: folder that `run` wrote, or the file of an entry.
        salt: the maintainer's secret, for an entry on official seeds.
        workers: processes that plan.
        progress: called with the stage and the fraction done.

    Returns:
        The entry, its numbers those computed here.

    Raises:
        ParameterError: no such entry, or a salt that is missing.
        Refused: what is wrong with the entry.
    """
    files = read_files(path)
    claimed = from_bytes(files[ENTRY])
    problem = _problem(claimed)
    seeds = _seeds(claimed, problem, salt)
    if claimed.results["score"].shape[1] != problem.count:
        raise Refused(
            Code.WRONG_LENGTH,
            f"{claimed.results['score'].shape[1]} results, {problem.name} asks {problem.count}",
        )
    if RECORDING in files:
        level, method = "replayed", _recorded(claimed.method, problem)
        rules = track_of(problem, seeds, method, workers)
        shape = len(method.seeds), problem.count, rules.shape()
        # the seconds that the answers took are taken over as they are told
        answers = Answers(unpack(files[RECORDING], *shape), claimed.results.get("seconds"))
    else:
        level = "reproduced"
        method, agents = answering(problem, claimed.method, files)
        rules = track_of(problem, seeds, method, workers)
        with refusing(Code.BAD_POLICY, *_NUMBERS), np.errstate(all="ignore"):
            answers = rules.answer(agents, progress)
    with refusing(Code.BAD_RECORDING, *_NUMBERS), np.errstate(all="ignore"):
        results = rules.results(answers)
    if (twice := repeated(results, method.kind)) is not None:
        raise Refused(Code.REPEATED_GROUP, f"groups {twice[0]} and {twice[1]} do the same")
    searched = level == "reproduced" and problem.environment is None
    require_claims(claimed.results, results, searched=searched)
    about = {**claimed.about, "versions": versions()}
    return replace(claimed, level=level, method=method, results=dict(results), about=about)


def add(board: str | os.PathLike[str], entry: Entry) -> Path:
    """Write a verified entry to the folder of a board; one that was there is replaced.

    Raises:
        ParameterError: it answers a part of a problem, or is of a lower level than the one of
            the same name that is there.
    """
    if entry.quick:
        raise ParameterError(
            f"{entry.problem} is for a first try: the board takes whole problems"
        )
    place = Path(board) / entry.file
    if place.exists():
        before = from_bytes(read_files(place)[ENTRY])
        if LEVELS.index(entry.level) < LEVELS.index(before.level):
            raise ParameterError(
                f"{place}: was {before.level}, which {entry.level} cannot replace"
            )
    write_bytes(place, to_bytes(entry))
    return place


def require_claims(claimed: Results, computed: Results, *, searched: bool = False) -> None:
    """Refuse claims that are better than what was found; worse ones cost whoever makes them.

    Args:
        claimed, found: results on the same questions.
        searched: of a planner or tuner that answered again.

    Raises:
        Refused: SCORE_DIFFERS.
    """
    relative, share = _SEARCHED if searched else (_RELATIVE[0], _FLIPPED)
    names = ["score"] if searched else [k for k in claimed if k not in ("success", "seconds")]
    off = (claimed["success"] > computed["success"]).copy()
    first = {"success": off.copy()}
    for name in names:
        its, mine = claimed[name], computed.get(name, np.inf)
        room = relative if name == "score" else _RELATIVE[1]
        least = np.where(np.isfinite(mine), (1 - room) * mine - _ABSOLUTE, np.inf)
        first[name] = its < least
        off |= first[name]
    if off.sum() > int(share * off.size):
        name = next(k for k, worse in first.items() if worse.any())
        group, episode = np.argwhere(first[name])[0]
        mine = np.broadcast_to(computed.get(name, np.inf), off.shape)[group, episode]
        raise Refused(
            Code.SCORE_DIFFERS,
            f"{int(off.sum())} of {off.size} are better than found here: {name} of episode"
            f" {episode}, group {group} is claimed as {claimed[name][group, episode]:.6g},"
            f" found {mine:.6g}",
        )


def _problem(claimed: Entry) -> Problem:
    with refusing(Code.UNKNOWN_PROBLEM):
        problem = get_problem(claimed.track, claimed.problem)
    if claimed.method.kind not in problem.kinds:
        raise Refused(
            Code.UNKNOWN_PROBLEM,
            f"{problem.name} is answered by {' or '.join(problem.kinds)}, not by"
            f" {claimed.method.kind}",
        )
    return problem


def _seeds(claimed: Entry, problem: Problem, salt: str | None) -> Seeds:
    if claimed.seeds != PUBLIC and salt is None:
        raise ParameterError("an entry on official seeds: give the salt (--salt FILE)")
    seeds = seeds_of(problem, None if claimed.seeds == PUBLIC else salt)
    if claimed.seeds != seeds.name:
        raise Refused(Code.WRONG_SEEDS, f"{claimed.seeds} is of another salt")
    return seeds


def _recorded(method: Method, problem: Problem) -> Method:
    """The method of a recording: of its settings only those that it may choose."""
    if problem.environment is None and method.settings:
        raise Refused(Code.BAD_SETTINGS, "settings: there is no environment")
    if problem.environment is not None:
        with refusing(Code.BAD_SETTINGS):
            require_settings(problem.environment, method.settings)
    return method
