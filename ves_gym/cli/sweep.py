"""`ves-gym sweep`: every unit of a spec once, in processes of this machine."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ves_gym.cli.flags import Answer, Flag, integer, path, read, say
from ves_gym.experiments.sweep import Report, merge, sweep, write_rows

SCHEMA = "ves-sweep/1"
_FAILURES = 10  # that are printed


def _part(value: str) -> tuple[int, int]:
    k, n = (int(word) for word in value.split("/"))
    return k, n


WORKERS = Flag("--workers", "N", integer(1), "processes; default one per processor")
FLAGS = (
    Flag("SPEC", read=path, help="a .toml file (docs/sweeps.md)"),
    WORKERS,
    Flag("--again", help="do finished units again (default: skip them)"),
    Flag("--part", "K/N", read(_part, "K/N, like 1/4"), "every N-th unit from the K-th"),
)


def run(
    spec: Path,
    *,
    again: bool = False,
    out: Path | None = None,
    progress: Any = None,
    **how: Any,
) -> Answer:
    """Sweep, merge; negative if a unit failed."""
    folder = out or Path("out/sweep", spec.stem)
    report = sweep(spec, folder, resume=not again, progress=progress, **how)
    rows = merge([folder]) if report.done or report.skipped else []
    if rows:
        write_rows(folder / "rows.jsonl", rows)
    say_failures(report)
    plain = {"schema": SCHEMA, **report.to_dict(), "rows": len(rows)}
    return Answer(text=report.summary, plain=plain, negative=not report.complete)


def say_failures(report: Report) -> None:
    """Say on stderr why the first of the units of a sweep or matrix that failed did."""
    for why in list(report.failed.values())[:_FAILURES]:
        say(why, "failed")
