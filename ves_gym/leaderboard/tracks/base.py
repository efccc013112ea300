"""Parts of every track: a way to let a method answer, and to replay what it answered."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

from ves_gym._util.params import Array
from ves_gym.leaderboard.entry import Method, Results
from ves_gym.leaderboard.files import Recording
from ves_gym.leaderboard.problems import Problem
from ves_gym.leaderboard.seeds import Seeds

Progress = Callable[[str, float], None]


def no_progress(stage: str, done: float) -> None:
    """Show nothing of the progress."""


class Answers(NamedTuple):
    """What was done, of each group and episode, and the seconds it took to plan, if known."""

    recording: Recording
    seconds: Array | None = None  # (groups, episodes)


class TrackRules(Protocol):
    """A track of the leaderboard: problems that are answered and replayed in one way."""

    def shape(self, problem: Problem, method: Method) -> tuple[int, ...]:
        """Shape of an answer but for its first axis."""

    def answer(
        self,
        problem: Problem,
        seeds: Seeds,
        method: Method,
        agents: Sequence[Any],
        progress: Progress = no_progress,
    ) -> Answers:
        """Let a method answer.

        Args:
            agents: one per group.
            progress: called with the stage and the fraction done.
        """

    def replay(
        self, problem: Problem, seeds: Seeds, method: Method, recording: Recording
    ) -> Results:
        """Results of recorded answers, by simulation.

        Raises:
            Refused: WRONG_LENGTH, BAD_RECORDING, LEDGER_RESIDUAL.
        """
