"""Leaderboard: problems, entries that anybody can repeat, their verification, the board."""

from typing import TYPE_CHECKING

from ves_gym._util.lazy import lazily as _lazily

if TYPE_CHECKING:
    from ves_gym.leaderboard import statistics as statistics

__all__ = ["statistics"]

_HOMES: dict[str, str] = {}
_lazily(__name__, _HOMES, ("statistics",))
