"""What published sets show: rows of the goals over all of them, every case, set by set.

A published set is a folder with `answers.json` and, where some were answered besides,
`nulls.json`: nulls with tolerances as described, which count as nulls only.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.trial2.publish import SCHEMA
from benchmarks.trial2.scoring import Label, judge
from benchmarks.trial2.targets import (
    LARGE,
    Answer,
    alarms,
    as_described,
    names_told,
    share,
    targets,
)

Cases = list[tuple[Label, Answer]]


def read(path: Path) -> Cases:
    """Return labels and answers of a published file, in the order of their numbers."""
    found = json.loads(path.read_text("utf-8"))
    if found.get("schema") != SCHEMA:
        raise SystemExit(f"{path}: got schema {found.get('schema')!r}, expected {SCHEMA!r}")
    return [(label, found["answers"][f"{label['index']:03d}"]) for label in found["labels"]]


def pooled(folders: Sequence[Path]) -> Cases:
    """Return the cases of several sets, numbered anew."""
    every = [case for folder in folders for case in read(folder / "answers.json")]
    return [({**label, "index": k}, given) for k, (label, given) in enumerate(every)]


def further_nulls(folders: Sequence[Path]) -> Cases:
    """Return the nulls that were answered besides."""
    files = [folder / "nulls.json" for folder in folders]
    return [case for path in files if path.exists() for case in read(path)]


def goals(folders: Sequence[Path]) -> str:
    """Return the rows of the goals over all cases as Markdown."""
    cases = pooled(folders)
    lines = targets([label for label, _ in cases], {a["index"]: g for a, g in cases})
    more = further_nulls(folders)
    if more:
        usual = [(a, g) for a, g in cases if as_described(a)] + more
        lines += (
            f"\n| the same nulls, with {len(more)} answered besides: false alarms"
            f" | {alarms(usual)} | <= 1 of 120 |"
        )
    return lines


def every_case(folder: Path) -> str:
    """Return one row of each case of a set as Markdown."""
    lines = ["| case | machine | noise | tolerances | truth (gap / noise) | answer | judged |"]
    lines += ["|---|---|---|---|---|---|---|"]
    for label, given in read(folder / "answers.json"):
        mode = "laboratory" if label["mode"] == "emulated" else "space"
        said = ", stated" if label["stated"] else ", unsaid"
        factor = f"{label['factor']:g}" + ("" if label["factor"] == 1 else said)
        effects = label["effects"]
        truth = ", ".join(_placed(e["kind"], e["slot"]) for e in effects)
        gaps = ", ".join(f"{e['gap']:.3g}" for e in effects)
        names = ", ".join(
            f"{_placed(n['kind'], n['slot'])} ({n['probability']:.2f})"
            for n in given.get("names") or []
        )
        verdict = given["verdict"]
        told = names if verdict == "named" else f"{verdict}: {names}" if names else verdict
        lines.append(
            f"| {label['index']} | {mode}, `{label['vehicle']}`, {label['arm']} |"
            f" {label['noise']} | {factor} | {f'{truth} ({gaps})' if effects else 'nothing'} |"
            f" {told} | {judge(label, given)} |"
        )
    return "\n".join(lines)


def _placed(kind: str, slot: Any) -> str:
    return kind if slot in (None, "") else f"{kind} {slot}"


def _right(cases: Cases, category: str, least: float = 0.0) -> str:
    """Return how many of a category, and of this gap over noise at least, are judged right."""
    return share(
        (
            judge(label, given) == "right"
            for label, given in cases
            if label["category"] == category
            and min((e["gap"] for e in label["effects"]), default=0.0) >= least
        ),
        interval=False,
    )


def set_by_set(folders: Sequence[Path]) -> str:
    """Return one row of each set as Markdown, in shares."""
    head = (
        "set",
        "cases",
        "singles >= 3 x",
        "pairs",
        "outside",
        "nulls: alarms",
        "names right",
    )
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    for folder in folders:
        cases = read(folder / "answers.json")
        nulls = [(a, g) for a, g in cases if a["category"] == "null"]
        row = (
            folder.name.removeprefix("set-").lstrip("0"),
            str(len(cases)),
            _right(cases, "single", LARGE),
            _right(cases, "pair"),
            _right(cases, "outside"),
            alarms(nulls, interval=False),
            share((r for _, r in names_told(cases)), interval=False),
        )
        lines.append("| " + " | ".join(row) + " |")
    return "\n".join(lines)
