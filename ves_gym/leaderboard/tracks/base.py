"""What every track has: questions, a way to answer them, to replay and to answer them again."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

from ves_gym.leaderboard.protocol import Problem, Seeds
from ves_gym.system.system import System

Row = dict[str, Any]
Progress = Callable[[str, float], None]


class Case(NamedTuple):
    """A question of a problem."""

    id: str
    seed: int  # as it is shown: of official seeds only which one it is


@dataclass(frozen=True, kw_only=True)
class Method:
    """Answerer of a problem: something built in, by its name, or policies by their files."""

    kind: str
    name: str = ""  # of what is built in, "" of anything else
    seeds: tuple[int, ...] = (0,)
    architecture: str | None = None
    weights: tuple[str, ...] = ()  # SHA-256 of each policy's weights
    settings: Mapping[str, Any] = field(default_factory=dict)  # of the environment


@dataclass(frozen=True)
class Answers:
    """Rows and the file that the replay takes, with everything else a bundle holds."""

    rows: list[Row]
    payload: bytes
    method: Method
    members: dict[str, bytes] = field(default_factory=dict)


class LeaderboardTrack(Protocol):
    """A track of the leaderboard. Rows are ordered by group, then as the cases are."""

    def payload(self, problem: Problem) -> str:
        """File of the answers."""

    def system(self, problem: Problem) -> System:
        """Return the system that is simulated."""

    def seed_list(self, problem: Problem, seeds: Seeds) -> list[int]:
        """The seeds that make the questions."""

    def cases(self, problem: Problem, seeds: Seeds, method: Method, group: int) -> list[Case]:
        """The questions, in order."""

    def replay(
        self, problem: Problem, seeds: Seeds, method: Method, rows: Sequence[Row], data: bytes
    ) -> list[Row]:
        """The rows as the answers give them, energies by simulation; runs nothing submitted.

        Args:
            rows: as claimed; only id, seed, group and length are read.

        Raises:
            BundleError: EPISODE_LENGTH, BAD_ACTION, LEDGER_RESIDUAL.
        """

    def require_possible(self, problem: Problem, seeds: Seeds, rows: Sequence[Row]) -> None:
        """Raise a BundleError (BELOW_FLOOR) where rows are better than physics permits.

        Args:
            rows: as claimed or as replayed, all of the problem and in order.
        """

    def reproduce(
        self,
        problem: Problem,
        seeds: Seeds,
        method: Method,
        members: Mapping[str, bytes],
        rows: Sequence[Row],
        same: bool,
    ) -> None:
        """Run the method again and compare.

        Args:
            rows: as replayed. same: whether every bit must agree.

        Raises:
            BundleError: NOT_REPRODUCED, NOT_REPRODUCIBLE.
        """


def row(
    case: Case,
    group: int,
    *,
    score: float | None,
    success: bool,
    failed: bool,
    energies: Mapping[str, float | None],
    length: int,
    seconds: float | None = None,
    evaluations: int | None = None,
    anytime: list[list[float]] | None = None,
) -> Row:
    """A row of a manifest: that of an entry, and how long its part of the payload is."""
    out: Row = {
        "id": case.id,
        "seed": case.seed,
        "group": group,
        "score": score,
        "success": success,
        "failed": failed,
        **{k: finite_or_none(energies.get(k)) for k in ("E_mean", "E_peak", "E_res", "E_int")},
        "seconds": seconds,
        "evaluations": evaluations,
        "length": length,
    }
    if anytime is not None:
        out["anytime"] = anytime
    return out


def repeated(rows: Sequence[Row], groups: int) -> tuple[int, int] | None:
    """Two groups with the same results to the last bit, which would count one of them twice.

    Groups without any energy or score do not count.
    """
    if len(rows) % groups:
        return None
    size, groups_of = len(rows) // groups, dict[tuple[Any, ...], int]()
    for group in range(groups):
        part = rows[group * size : (group + 1) * size]
        key = tuple(r.get(k) for r in part for k in ("score", "E_mean", "E_peak", "E_res"))
        if key in groups_of and any(value is not None for value in key):
            return groups_of[key], group
        groups_of[key] = group
    return None


def finite_or_none(value: float | None) -> float | None:
    """A number, or None for what is none."""
    return float(value) if value is not None and math.isfinite(value) else None
