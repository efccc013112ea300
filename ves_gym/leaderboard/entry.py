"""`Entry`: what a method did on a problem, in one JSON file of at most 20 kB.

Results are arrays (groups, episodes): a group is a training of a policy or a seed of a planner,
and all groups answer the same questions in the same order. Lower is better in every score. A
failure, null in the file, is infinity here: the worst there is, and never left out.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any

import numpy as np

from ves_gym._util.params import (
    Array,
    ParameterError,
    canonical_json,
    from_plain,
    require_choice,
    to_plain,
)
from ves_gym.leaderboard.problems import QUICK, SCORES

SCHEMA = "ves-entry/1"
LARGEST = 20_000  # bytes of a file
KINDS = ("planner", "policy", "controller", "gains")
LEVELS = ("replayed", "reproduced")  # by its recording, or by its method, which answered again
# J (seconds: of planning, told by the method's own run); which there are depends on the track.
# E_decay is E_mean where the base vibrates from the start; acceleration is the mount's peak
# over the straight line's.
MEASURES = ("E_mean", "E_decay", "E_peak", "E_res", "acceleration", "seconds")
MOST_GROUPS = 16
_DIGITS = 5, 4  # of a score and a measure in the file: five trainings on 100 episodes fit in
_NAME = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")
_LONGEST = 40  # characters of a name
_SEEDS = re.compile(r"public|official-[0-9a-f]{16}")
_DIGEST = re.compile(r"[0-9a-f]{64}")

Results = Mapping[str, Array]  # score, success (0 or 1) and measures, each (groups, episodes)


class Code(Enum):
    """Faults of an entry; the text is the meaning (docs/leaderboard.md)."""

    UNSAFE_FILE = "a link, a name or a size that no file of an entry has"
    MALFORMED_ENTRY = "entry.json is no JSON of the schema"
    UNKNOWN_PROBLEM = "no such track, problem or kind of method"
    WRONG_SEEDS = "not the seeds of the problem, or of the method"
    WRONG_LENGTH = "more or fewer results, actions, control points or gains than a problem has"
    BAD_RECORDING = "an action, motion or gain is not finite, out of bounds or no such thing"
    BAD_SETTINGS = "settings of the environment that are not the method's to choose"
    BAD_POLICY = "a policy that cannot be read, does not fit or is not the one that is named"
    REPEATED_GROUP = "two trainings or seeds do the same: one would count twice"
    SCORE_DIFFERS = "results are claimed that are better than those found here"
    NOT_REPRODUCIBLE = "there is neither a recording nor a method that could answer again"

    @property
    def slug(self) -> str:
        """The code as it is printed, such as `score-differs`."""
        return self.name.lower().replace("_", "-")


class Refused(Exception):
    """An entry that is refused."""

    def __init__(self, code: Code, why: str) -> None:
        super().__init__(f"{code.slug}: {' '.join(why.split())[:300]}")
        self.code = code


@contextmanager
def refusing(code: Code, *kinds: type[Exception]) -> Iterator[None]:
    """Take an error inside for the entry's fault; of the kinds, default a ParameterError."""
    faults = kinds or (ParameterError,)
    try:
        yield
    except Refused:
        raise
    except faults as error:
        raise Refused(code, f"{type(error).__name__}: {error}") from None


@dataclass(frozen=True, kw_only=True)
class Method:
    """Answerer of a problem: something built in by its name, policies, or one's own."""

    kind: str
    name: str = ""  # of what is built in, "" of anything else
    seeds: tuple[int, ...] = (0,)  # one per group
    weights: tuple[str, ...] = ()  # SHA-256 of each policy's
    settings: dict[str, Any] = field(default_factory=dict)  # of the environment

    def __post_init__(self) -> None:
        require_choice(self, "kind", KINDS)
        if not 1 <= len(self.seeds) <= MOST_GROUPS:
            raise ParameterError(
                f"Method.seeds must be 1 to {MOST_GROUPS}, got {len(self.seeds)}"
            )
        if self.name:
            require_name(self.name, "Method.name")
        count = len(self.seeds) if self.kind == "policy" else 0
        if len(self.weights) != count or not all(map(_DIGEST.fullmatch, self.weights)):
            raise ParameterError("Method.weights must be a SHA-256 per policy, of others none")


@dataclass(frozen=True, kw_only=True)
class Entry:
    """A result; `verify` gives one whose numbers were computed where it ran."""

    schema: str = SCHEMA
    track: str
    problem: str
    name: str
    author: str
    level: str
    seeds: str  # public, or official- and the mark of the salt
    method: Method
    results: dict[str, Any]  # see `Results`
    about: dict[str, Any] = field(default_factory=dict)  # what is only told

    def __post_init__(self) -> None:
        require_choice(self, "schema", (SCHEMA,))
        require_choice(self, "track", tuple(SCORES))
        require_choice(self, "level", LEVELS)
        for name in ("name", "author"):
            require_name(getattr(self, name), f"Entry.{name}")
        if not _SEEDS.fullmatch(self.seeds):
            raise ParameterError(
                f"Entry.seeds must be public or official-..., got {self.seeds!r}"
            )

    @property
    def file(self) -> str:
        """Name of its file on the board: no two of one author and problem have the same."""
        words = [self.track, self.problem.removeprefix("ves/"), self.author, self.name]
        words += [] if self.seeds == "public" else [self.seeds]
        return "_".join(words) + ".json"  # no name has a _

    def to_dict(self) -> dict[str, Any]:
        """Plain data, as its file holds it: numbers rounded, null what is infinite."""
        results = {
            name: _listed(values, _DIGITS[name != "score"])
            for name, values in self.results.items()
        }
        return {**to_plain(self), "results": results}

    @property
    def quick(self) -> bool:
        """True where it answers a part of a problem."""
        return self.problem.endswith(QUICK)


def require_name(value: str, where: str) -> str:
    """Return a name of a-z, 0-9 and single hyphens: no two of these look alike."""
    if not _NAME.fullmatch(value) or len(value) > _LONGEST:
        raise ParameterError(
            f"{where} must be of a-z, 0-9 and hyphens, at most {_LONGEST}, got {value!a:.80}"
        )
    return value


def to_bytes(entry: Entry) -> bytes:
    """The file of an entry.

    Raises:
        ParameterError: it is larger than an entry may be.
    """
    data = (canonical_json(entry.to_dict()) + "\n").encode()
    if len(data) > LARGEST:
        raise ParameterError(
            f"an entry has at most {LARGEST} bytes, this one {len(data)}: enter fewer seeds"
        )
    return data


def from_bytes(data: bytes) -> Entry:
    """An entry from its file.

    Raises:
        Refused: MALFORMED_ENTRY.
    """
    with refusing(Code.MALFORMED_ENTRY, ValueError, TypeError, RecursionError):
        if len(data) > LARGEST:
            raise ParameterError(f"an entry has at most {LARGEST} bytes")
        plain = json.loads(data, object_pairs_hook=_once, parse_constant=_no_number)
        entry: Entry = from_plain(Entry, plain)
        arrays = _arrays(entry.results, len(entry.method.seeds))
        entry = replace(entry, results=dict(arrays))
        to_bytes(entry)  # whatever is told in it can be written again
    return entry


def _listed(values: Array, digits: int) -> list[list[float | None]]:
    return [[_rounded(x, digits) for x in group.tolist()] for group in values]


def _rounded(x: float, digits: int) -> float | None:
    if not math.isfinite(x):
        return None
    return int(x) if x in (0.0, 1.0) else float(f"{x:.{digits}g}")


def _arrays(plain: Mapping[str, Any], groups: int) -> Results:
    names = ("score", "success", *MEASURES)
    if not {"score", "success"} <= plain.keys() <= set(names):
        raise ParameterError(f"results must be score, success and of {', '.join(MEASURES)}")
    out = {name: _array(table, f"results.{name}") for name, table in plain.items()}
    shape = (groups, out["score"].shape[1])
    if any(values.shape != shape for values in out.values()):
        raise ParameterError(f"results must be lists of {groups} groups of equal length")
    if not np.isin(out["success"], (0.0, 1.0)).all():
        raise ParameterError("results.success must be 0 or 1")
    return out


def _array(table: Any, where: str) -> Array:
    """(groups, episodes) numbers; null is infinity."""
    if not (isinstance(table, list) and table and all(isinstance(g, list) for g in table)):
        raise ParameterError(f"{where} must be a list of groups")
    lengths = {len(group) for group in table}
    numbers = [x for group in table for x in group if x is not None]
    if lengths != {max(lengths)} or not max(lengths):
        raise ParameterError(f"{where} must hold as many episodes in every group")
    if any(isinstance(x, bool) or not isinstance(x, (int, float)) for x in numbers):
        raise ParameterError(f"{where} must hold numbers and null")
    if not all(0 <= x < 1e300 for x in numbers):
        raise ParameterError(f"{where} must hold numbers that are finite and not negative")
    return np.array([[math.inf if x is None else float(x) for x in g] for g in table])


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) != len(pairs):
        raise ParameterError("a key is given more than once")
    return table


def _no_number(name: str) -> float:
    raise ParameterError(f"{name} is no number of JSON")
