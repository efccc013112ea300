"""A solved episode of each problem of track tasks, as fixed actions: what its success is.

Actions that no method gives solve nothing, so probes of fixed patterns would not see a change
of what counts as solved. `golden/solutions.json` holds, of every problem, the actions by which
the task's reference controller once solved an episode; they are played as they are.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym.baselines.evaluate import evaluate
from ves_gym.baselines.policy import task_name
from ves_gym.baselines.registry import REFERENCES, get_controller
from ves_gym.leaderboard.protocol import Problem, seeds_of
from ves_gym.leaderboard.stored_results import read_golden
from ves_gym.leaderboard.tracks.action_recorder import Recorded, Replayed
from ves_gym.leaderboard.tracks.tasks import TaskTrack

FILE = "solutions.json"
_TRIED = 10  # episodes
_NUMBERS = ("return", "E_mean", "E_peak", "E_res", "E_int")

Plain = dict[str, Any]


def played_solution(problem: Problem) -> list[Plain]:
    """Play the stored actions in their episode, and in the next one, which they do not know.

    Args:
        problem: of track tasks.

    Raises:
        ParameterError: there are no actions of the problem.
    """
    known = read_golden(FILE)
    if problem.base not in known:
        raise ParameterError(f"no solution of {problem.base!r}; known: {', '.join(known)}")
    stored = known[problem.base]
    first = int(stored["seed"])
    steps = np.array(stored["steps"], dtype=np.int64)  # (width, periods)
    actions: Array = np.cumsum(steps, axis=1).T / TaskTrack.LEVELS
    player = Replayed({first: actions, first + 1: actions})
    rows = evaluate(player, problem.base, episodes=2, seed=first, threads=1).rows
    flags = ("success", "success_once", "failed", "length")
    return [{k: row[k] for k in (*flags, *_NUMBERS)} for row in rows]


def found_solution(problem: Problem) -> Plain:
    """Return the actions of the first public episode that the task's reference solves.

    Args:
        problem: of track tasks.

    Raises:
        ParameterError: it solves none of the first.
    """
    law = get_controller(REFERENCES[task_name(problem.base).removesuffix("Emulated")])
    recorder = Recorded(law, TaskTrack.LEVELS)
    root = seeds_of(problem, None).root
    rows = evaluate(recorder, problem.base, episodes=_TRIED, seed=root, threads=1).rows
    for row in rows:
        if row["success"]:
            counts = np.rint(recorder.actions(row["seed"]) * TaskTrack.LEVELS).astype(np.int64)
            steps = np.diff(counts, axis=0, prepend=0).T
            return {"seed": row["seed"], "steps": steps.tolist()}
    raise ParameterError(f"{law.name} solves none of {_TRIED} episodes of {problem.base}")
