"""Record the golden results of probes: `python scripts/golden.py [--check]`.

Results that are stored already are never overwritten: a problem whose behaviour changes on
purpose first gets a new version (`VERSIONS` or `PROTOCOL` in leaderboard/protocol.py), and
only then are its results recorded anew and its identity added to golden/evaluators.json.

    --check     compare all probes with what is stored, and change nothing
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import ves_gym
from ves_gym._util.params import write_text
from ves_gym.leaderboard import evaluators, probes, solutions, stored_results
from ves_gym.leaderboard.protocol import PROTOCOL, QUICK, Problem, problems

FOLDER = Path(ves_gym.__file__).parent / "leaderboard" / "golden"


def every_problem() -> list[Problem]:
    """Return all problems but the quick ones, whose probes are those of the whole ones."""
    return [
        Problem(track, name)
        for track in PROTOCOL
        for name in problems(track)
        if not name.endswith(QUICK)
    ]


def check() -> int:
    """Print the largest difference of every probe; return how many are not permitted."""
    refused, largest, seen = 0, 0.0, set[str]()
    for problem in every_problem():
        for name, stored in stored_results.golden(problem).items():
            if name in seen:
                continue
            seen.add(name)
            deviation = probes.compare(stored, probes.measure(problem, name))
            refused += not deviation.permitted
            largest = max(largest, deviation.size)
            verdict = "" if deviation.permitted else "  DIFFERS"
            print(f"{deviation.size:8.1e} {name} {deviation.where}{verdict}", flush=True)
    print(f"{len(seen)} probes, {refused} differ, largest {largest:.1e}")
    return refused


def record() -> None:
    """Record what has no stored results for the present versions."""
    path = FOLDER / "evaluators.json"
    table: dict[str, Any] = {"schema": evaluators.SCHEMA, "versions": {}, "sources": {}}
    if path.exists():
        table = json.loads(path.read_text(encoding="utf-8"))
    FOLDER.mkdir(exist_ok=True)
    rows: dict[Problem, dict[str, list[str]]] = {}
    for problem in every_problem():
        tracks = table["versions"].setdefault(problem.track, {})
        rows[problem] = tracks.setdefault(problem.base, {})
    add_solutions([problem for problem in rows if problem.track == "tasks"])
    # what a problem of an unchanged version has, stays: it may be shared with another one
    settled = {
        name
        for problem, versions in rows.items()
        if str(evaluators.version_of(problem)) in versions
        for name in probes.probes_of(problem)
        if stored_results.is_stored(name)
    }
    for problem in rows:
        for name in probes.probes_of(problem):
            if name not in settled:
                settled.add(name)
                store(name, probes.measure(problem, name))
    stored_results.forget()
    for problem, versions in rows.items():
        digests = versions.setdefault(str(evaluators.version_of(problem)), [])
        if (own := evaluators.identity(problem)) not in digests:
            digests.append(own)
    write_text(path, json.dumps(table, indent=1, sort_keys=True) + "\n")


def add_solutions(problems: Sequence[Problem]) -> None:
    """Store the actions of a solved episode of every problem that has none."""
    file = FOLDER / solutions.FILE
    table = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    for problem in problems:
        if problem.base not in table:
            table[problem.base] = solutions.found_solution(problem)
            print(f"recorded a solution of {problem.base}", flush=True)
    short = {k: json.dumps(table[k], separators=(",", ":")) for k in sorted(table)}
    lines = [f"{json.dumps(k)}: {text}" for k, text in short.items()]
    write_text(file, "{\n" + ",\n".join(lines) + "\n}\n")
    stored_results.forget()


def store(name: str, results: dict[str, Any]) -> None:
    """Write the results of one probe into its file, a line per probe.

    Args:
        name: of the probe.
        results: plain data, all digits of every number.
    """
    file = FOLDER / stored_results.file_of(name)
    table = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    table[name] = results
    lines = [f"{json.dumps(k)}: {json.dumps(table[k], sort_keys=True)}" for k in sorted(table)]
    write_text(file, "{\n" + ",\n".join(lines) + "\n}\n")
    print(f"recorded {name}", flush=True)


def main(words: Sequence[str]) -> int:
    """See the module's docstring."""
    parser = argparse.ArgumentParser(usage=__doc__)
    parser.add_argument("--check", action="store_true")
    if parser.parse_args(words).check:
        return int(check() > 0)
    record()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
