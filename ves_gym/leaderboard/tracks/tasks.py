"""Track *tasks*: solve what a task asks, and then move its base little.

A row's score is the energy of a solved episode. An episode that is not solved has none, and
counts as the worst there is: energies are never compared over what is easy alone. Entries are
ranked by their share of solved episodes first (`leaderboard.statistics`).
"""

from __future__ import annotations

from collections.abc import Sequence

from ves_gym._util.params import Array
from ves_gym.baselines.evaluate import Evaluation
from ves_gym.leaderboard import lower_bounds
from ves_gym.leaderboard.npy_io import pack_levels, unpack_levels
from ves_gym.leaderboard.protocol import Problem, Seeds
from ves_gym.leaderboard.tracks.base import Row
from ves_gym.leaderboard.tracks.policies import ACTIONS, PolicyTrack


class TaskTrack(PolicyTrack):
    """Environments as in `PolicyTrack`; success is the task's own, at the end of an episode.

    Score: E_mean of an episode that is solved [J]. An action is a multiple of 1/4096, as a
    drive with a command of 13 bits takes it: files are a tenth as large.
    """

    LEVELS = 4096

    def require_possible(self, problem: Problem, seeds: Seeds, rows: Sequence[Row]) -> None:
        """See `LeaderboardTrack`."""
        for result in rows:
            lower_bounds.require_energies(result)

    def _scores(
        self, problem: Problem, seeds: Seeds, evaluation: Evaluation
    ) -> list[float | None]:
        """Lower is better; none where the task is not solved."""
        return [r["E_mean"] if r["success"] else None for r in evaluation.rows]

    def _packed(self, actions: Array) -> bytes:
        return pack_levels(actions, self.LEVELS)

    def _unpacked(self, data: bytes, width: int) -> Array:
        return unpack_levels(data, ACTIONS, width, self.LEVELS)
