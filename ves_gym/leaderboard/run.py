"""`leaderboard run`: answer a problem and write the entry."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

from ves_gym._util.params import ParameterError
from ves_gym._util.threads import on_one_thread
from ves_gym.baselines.controllers import Controller
from ves_gym.baselines.policy import versions
from ves_gym.leaderboard.entry import Entry, Method, to_bytes
from ves_gym.leaderboard.files import ENTRY, RECORDING, pack, write_files
from ves_gym.leaderboard.methods import enter
from ves_gym.leaderboard.problems import Problem, Seeds, get_problem, seeds_of
from ves_gym.leaderboard.statistics import repeated
from ves_gym.leaderboard.tracks.base import Progress, Track, no_progress
from ves_gym.leaderboard.tracks.damping import GainTrack, Tuner
from ves_gym.leaderboard.tracks.paths import PathTrack
from ves_gym.leaderboard.tracks.tasks import DampTrack, TaskTrack
from ves_gym.planners.query import Planner


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
            file, as told by them.
        salt: of the official seeds; None for the public ones.
        training: what it took to make the method, plain data; default what policies tell.
        workers: processes that plan.
        progress: called with the stage and the fraction done.

    Returns:
        The entry.
    """
    question = get_problem(track, problem)
    drawn, entered = seeds_of(question, salt), enter(question, method, seeds)
    rules = track_of(question, drawn, entered.method, workers)
    with on_one_thread():  # as `verify` does
        answers = rules.answer(entered.agents, progress)
        results = rules.results(answers)
    if (twice := repeated(results, entered.method.kind)) is not None:
        raise ParameterError(
            f"groups {twice[0]} and {twice[1]} do the same, and one of them would count twice:"
            " leave it out"
        )
    about = {} if training is None else {"training": dict(training)}
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


def track_of(problem: Problem, seeds: Seeds, method: Method, workers: int) -> Track:
    """The track of a problem that a method answers; `workers` are processes that plan."""
    kind = {"paths": PathTrack, "tasks": TaskTrack, "damping": DampTrack}[problem.track]
    if problem.track == "damping" and problem.environment is None:
        kind = GainTrack
    return kind(problem, seeds, method, workers)
