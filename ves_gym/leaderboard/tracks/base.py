"""Parts of every track: questions, a way to answer them, to replay and to answer them again."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np

from ves_gym.leaderboard.errors import BundleError, Code
from ves_gym.leaderboard.protocol import ABSOLUTE, PLANNED, PLANNED_SHARE, Problem, Seeds
from ves_gym.system.system import System

Row = dict[str, Any]
Progress = Callable[[str, float], None]


def no_progress(stage: str, done: float) -> None:
    """Show nothing of the progress."""


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
    ) -> list[Row]:
        """Run the method again; the rows of that run.

        Args:
            rows: as replayed.

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


NEAR = 1e-3  # median relative difference of results below which two policies are one
NUMBERS = ("score", "E_mean", "E_peak", "E_res", "E_int")  # lower is better


def claims_more(
    claimed: Row, found: Row, relative: float, numbers: Sequence[str] = NUMBERS
) -> str | None:
    """Name of the first number in which a row claims to be better than it was found.

    Args:
        claimed, found: rows of one question.
        relative: part of a number by which it may be lower than found.
        numbers: those that are compared.
    """
    if claimed["success"] and not found["success"]:
        return "success"
    if found["failed"] and not claimed["failed"]:
        return "failed"
    for name in numbers:
        its, mine = claimed.get(name), found.get(name)
        if its is None:  # a failure, or not measured in this track
            continue
        if mine is None or its < mine - ABSOLUTE - relative * abs(mine):
            return name
    return None


def require_as_good(claimed: Sequence[Row], found: Sequence[Row]) -> None:
    """Raise a BundleError (NOT_REPRODUCED) unless a method does as well when run again.

    Rounding can lead a search into another valley: 5 % of the scores may be worse by more
    than 1 %. Which of two motions has the higher peak does not matter here.

    Args:
        claimed: rows as replayed. found: of the method's run here.
    """
    off = [
        (its, mine, name)
        for its, mine in zip(claimed, found, strict=True)
        if (name := claims_more(its, mine, PLANNED, ("score",))) is not None
    ]
    if len(off) > (1 - PLANNED_SHARE) * len(found):
        its, mine, name = off[0]
        raise BundleError(
            Code.NOT_REPRODUCED,
            f"{len(off)} of {len(found)} rows are worse when the method runs again, first"
            f" {its['id']}: {name} is {mine.get(name)}, submitted was {its.get(name)}",
        )


def repeated(rows: Sequence[Row], method: Method) -> tuple[int, int] | None:
    """Two groups with the same results, which would count one of them twice.

    The same: to the last bit, and of policies within `NEAR`, for a copy with noise on its
    weights, or with its hidden units in another order, does what the original does. Groups
    without any energy or score do not count.

    Args:
        rows: of all groups, one group after another.
        method: whose they are.
    """
    groups = len(method.seeds)
    if len(rows) % groups:
        return None
    size, within = len(rows) // groups, NEAR if method.kind == "policy" else 0.0
    parts = [rows[k * size : (k + 1) * size] for k in range(groups)]
    for k, part in enumerate(parts):
        for earlier in range(k):
            apart = difference(parts[earlier], part)
            if apart is not None and apart <= within:
                return earlier, k
    return None


def difference(
    some: Sequence[Mapping[str, Any]], others: Sequence[Mapping[str, Any]]
) -> float | None:
    """Return how far results of the same questions are apart, relative to their size.

    The median of mean and peak energy of the simulations; the largest of the scores where there
    are no energies. A question that only one of them solves counts as 1. None where neither has
    a number.
    """
    means = ("E_mean", "E_decay")
    simulated = any(r.get(name) is not None for r in some for name in means)
    names = (*means, "E_peak") if simulated else ("score",)
    apart = []
    for a, b in zip(some, others, strict=True):
        for name in names:
            x, y = a.get(name), b.get(name)
            if x is not None and y is not None:
                apart.append(abs(x - y) / max(abs(x), abs(y), 1e-300))
            elif x is not y:
                apart.append(1.0)
    if not apart:
        return None
    return float(np.median(apart) if simulated else np.max(apart))


def finite_or_none(value: float | None) -> float | None:
    """A number, or None for what is none."""
    return float(value) if value is not None and math.isfinite(value) else None
