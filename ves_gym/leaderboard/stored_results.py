"""Stored results of the probes of every problem, `golden/*.json`, by name."""

from __future__ import annotations

import json
from functools import cache
from importlib.resources import files
from typing import Any

from ves_gym._util.params import ParameterError
from ves_gym.leaderboard.protocol import Problem

FOLDER = "golden"

Plain = dict[str, Any]


def probe_names(problem: Problem) -> tuple[str, ...]:
    """Return the names of a problem's probes, `subject/experiment`.

    A quick problem has those of the whole one.
    """
    track, subject = problem.track, problem.base.removeprefix("ves/")
    own = {
        "policies": ("episode", f"evaluation-{track}"),
        "paths": ("queries", "motions"),
        "damping": ("releases",),
        "discrepancy": (),
    }
    experiments = own["policies" if problem.environment is not None else track]
    names = [f"{subject}/{name}" for name in (f"rules-{track}", *experiments)]
    if track == "tasks":
        names.append(f"{subject}/solved")
    if track == "discrepancy":  # both sets are judged and made alike
        names += ["blind/answers", "blind/case", "blind/effects"]
    return tuple(names)


def golden(problem: Problem) -> dict[str, Plain]:
    """Return the stored results of a problem's probes, by name.

    Raises:
        ParameterError: there are none.
    """
    return {name: _stored(name) for name in probe_names(problem)}


def file_of(name: str) -> str:
    """Return the file of `golden` that holds a probe's results."""
    return f"{name.partition('/')[0]}.json"


def is_stored(name: str) -> bool:
    """Return whether there are results of a probe."""
    return name in read_golden(file_of(name))


def forget() -> None:
    """Read the stored results anew when they are asked for next."""
    read_golden.cache_clear()


def _stored(name: str) -> Plain:
    table = read_golden(file_of(name))
    if name not in table:
        raise ParameterError(f"no stored results of probe {name!r}; known: {', '.join(table)}")
    results: Plain = table[name]
    return results


@cache
def read_golden(file: str) -> Plain:
    """Return a file of `golden`, empty if there is none."""
    place = files("ves_gym.leaderboard") / FOLDER / file
    try:
        table: Plain = json.loads(place.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    return table
