"""Which evaluator computed a result: versions by what they compute, not by their sources.

An evaluator is a track's rules, a problem and the version of both; its identity is the hash
of these and of the stored results of its probes (`probes.py`). `golden/evaluators.json` lists
the identity of every version there has been. Results of before carry a hash of source files
instead; the table says which version those sources were shown to be, and by which measurement.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from ves_gym._util.params import ParameterError, content_hash
from ves_gym.leaderboard.errors import BundleError, Code
from ves_gym.leaderboard.protocol import (
    PROTOCOL,
    VERSIONS,
    Problem,
    get_problem,
)
from ves_gym.leaderboard.stored_results import golden, read_golden

SCHEMA = "ves-evaluators/1"
_FILE = "evaluators.json"

Plain = Mapping[str, Any]


class Version(NamedTuple):
    """Version of a track's rules, and of one problem under them."""

    protocol: int
    problem: int

    def __str__(self) -> str:
        """Both, as they are shown."""
        return f"{self.protocol}.{self.problem}"


def version_of(problem: Problem) -> Version:
    """Return the present version of a problem."""
    return Version(PROTOCOL[problem.track], VERSIONS.get((problem.track, problem.base), 1))


def identity(problem: Problem) -> str:
    """Return the SHA-256 that stands for the present evaluator of a problem."""
    version = version_of(problem)
    return content_hash(
        {
            "track": problem.track,
            "protocol": version.protocol,
            "problem": problem.base,
            "version": version.problem,
            "golden": {name: content_hash(plain) for name, plain in golden(problem).items()},
        }
    )


def registered(track: str, base: str) -> dict[Version, list[str]]:
    """Return the identities of every version of a problem that there has been.

    A version has several where probes were added to it later.

    Args:
        track: name of the track.
        base: name of the problem, without that of its quick form.
    """
    rows = _table()["versions"].get(track, {}).get(base, {})
    return {_version(text): digests for text, digests in rows.items()}


def resolve(track: str, base: str, evaluator: str) -> Version | None:
    """Return the version that computed a result, None if the table does not know it.

    Args:
        track: name of the track.
        base: name of the problem, without that of its quick form.
        evaluator: the hash that the result carries: an identity, or one of source files.
    """
    row = _table()["sources"].get(evaluator)
    if row is not None and row["track"] == track:
        evaluator = row["identities"].get(base, evaluator)
    for version, digests in registered(track, base).items():
        if evaluator in digests:
            return version
    return None


def history_reason(entry: Plain) -> str | None:
    """Return why an entry of the board is history, None where it is of the present version.

    Args:
        entry: plain data of schema ves-entry/1.
    """
    track, name = entry["track"], entry["problem"]
    if entry["protocol"] < PROTOCOL[track]:
        return f"rules {entry['protocol']} of the track, today {PROTOCOL[track]}"
    try:
        problem = get_problem(track, name)
    except ParameterError:
        return "the problem is no longer asked"
    version = resolve(track, problem.base, entry["about"]["evaluator"])
    if version is None:
        return "by an evaluator that no version is known to equal"
    if version != version_of(problem):
        return f"version {version} of the problem, today {version_of(problem)}"
    return None


def require_same(problem: Problem, evaluator: str) -> None:
    """Raise a BundleError (EVALUATOR_MISMATCH) unless a bundle is of the present version.

    Args:
        problem: what the bundle answers.
        evaluator: the hash that its manifest carries.
    """
    there = resolve(problem.track, problem.base, evaluator)
    present = version_of(problem)
    if evaluator == identity(problem) or there == present:
        return
    if there is None:
        why = f"{evaluator[:12]} is no known evaluator of {problem.base}: make the bundle again"
    else:
        why = f"version {there} of {problem.base} then, {present} now"
    raise BundleError(Code.EVALUATOR_MISMATCH, why)


def _version(text: str) -> Version:
    protocol, problem = text.split(".")
    return Version(int(protocol), int(problem))


def _table() -> Plain:
    table = read_golden(_FILE) or {"schema": SCHEMA, "versions": {}, "sources": {}}
    if table.get("schema") != SCHEMA:
        raise ParameterError(f"{_FILE}: schema must be {SCHEMA!r}, got {table.get('schema')!r}")
    return table
