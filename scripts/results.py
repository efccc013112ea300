"""Write what stored results say into pages: `python scripts/results.py`.

A block of `PAGES` is named after the file that its figures come from, as `<!-- FILE -->`. Files
of docs/results are tables: the command that measured them, columns and rows (`--json` of the
benchmarks writes them); those of `MADE` have a form of their own. Of a run of `ves-gym
benchmark`, `python scripts/results.py DIR/benchmark.json docs/results/NAME.json` makes a table.

No other figure stands on these pages (`strays`), unless the block of its section has it, a
Python file that the section names has it as a constant (what a test compares with, what a
script sets), or a `pycon` example, which a test executes. Figures are numbers with a point, an
exponent or a percent sign, `3 of 4`, and cells of tables that are numbers alone.
"""

from __future__ import annotations

import ast
import json
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks import write  # noqa: E402 - run as a file, the root is not on the path
from benchmarks.trial import frozen  # noqa: E402
from scripts import every_arm, leaderboard, training  # noqa: E402
from scripts.marks import BLOCK, filled  # noqa: E402
from ves_gym._util.params import write_text  # noqa: E402

PAGES = tuple(
    ROOT / name
    for name in (
        *("README.md", "docs/results.md", "docs/validation.md", "docs/diagnosis-trial.md"),
        *("docs/leaderboard.md", "docs/leaderboard/statistics.md"),
    )
)
MADE: dict[str, Callable[[], str]] = {
    "benchmarks/trial/sets.toml": frozen.sets_judged,
    "docs/leaderboard/entries": leaderboard.methods_compared,
    "docs/results/every-arm.json": every_arm.table,
    "docs/training": training.policies,
    "docs/training/rewards.json": training.rewards,
    "tests/golden/diagnoses.json": frozen.cases_judged,
}

# ---------------------------------------------------------------------------- blocks


def table(path: Path) -> str:
    """Return a stored table as Markdown, below the command that measured it."""
    stored = json.loads(path.read_text("utf-8"))
    rows = [stored["columns"], ["---"] * len(stored["columns"]), *stored["rows"]]
    lines = ["| " + " | ".join(map(_cell, row)) + " |" for row in rows]
    return "\n".join([f"    {stored['command']}", "", *lines])


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def page(path: Path) -> str:
    """Return the text of a page with its blocks as the stored results have them."""
    text = path.read_text("utf-8")
    names = [name for name, _ in BLOCK.findall(text)]
    return filled(text, {k: MADE[k]() if k in MADE else table(ROOT / k) for k in names})


def of_benchmark(path: Path) -> tuple[list[str], list[list[Any]]]:
    """Return columns and rows of a benchmark.json: medians over the straight line's.

    Args:
        path: of a run with one vehicle.
    """
    summary = json.loads(path.read_text("utf-8"))["summary"]
    at = {(one["planner"], one["duration"]): one for one in summary}
    durations = list(dict.fromkeys(one["duration"] for one in summary))
    rows: list[list[Any]] = []
    for planner in dict.fromkeys(one["planner"] for one in summary):
        found = [at[planner, duration] for duration in durations]
        solved = [f"{one['success_rate'] * one['n']:.0f} of {one['n']}" for one in found]
        cells = zip((one["ratio_median"] for one in found), solved, strict=True)
        rows.append([f"`{planner}`", *(cell for pair in cells for cell in pair)])
    heads = ((f"E_mean, {duration:g} s", "solved") for duration in durations)
    return ["planner", *(head for pair in heads for head in pair)], rows


# --------------------------------------------------------------------------- strays

_FIGURE = re.compile(
    r"(?<![\w.§])(\d+ of \d+|\d+(?:\.\d+)?e[-+−]?\d+|\d+\.\d+|\d+(?= ?%))( ?%)?(?!\w|\.\d)"
)
_CELL = re.compile(r"[-+−<>= ]*\d[\d.,e%/ +−-]*(?:(?:to|of) [\d.,e% +−-]+)?")
_NUMBER = re.compile(r"\d[\d,]*(?:\.\d+)?(?:e[-+−]?\d+)?")
_CODE = re.compile(r"^```.*?^```$|^    [^\n]*$|`[^`\n]*`|\]\([^)]*\)", re.MULTILINE | re.DOTALL)
_RUN = re.compile(r"^```pycon\n(.*?)^```$", re.MULTILINE | re.DOTALL)  # what doctest executes
_SOURCE = re.compile(r"python -m ([\w.]+)|([\w./-]+\.py)\b")


def strays(text: str) -> list[str]:
    """Return the figures of a page that nothing named in their section produces."""
    found = []
    for section in re.split(r"^(?=#)", text, flags=re.MULTILINE):
        blocks = [block for _, block in BLOCK.findall(section)] + _RUN.findall(section)
        known = set(_values("\n".join(blocks)))
        for module, path in _SOURCE.findall(section):
            known |= _constants(path or module.replace(".", "/") + ".py")
        title = section.partition("\n")[0].strip("# ")
        for figure, values in _figures(_CODE.sub("", BLOCK.sub("", section))):
            unit = 100 if "%" in figure else 1000  # mm, ms and g are m, s and kg there
            if not all(known & {k, round(k / unit, 12)} for k in values):
                found.append(f"{title}: {figure}")
    return found


def _figures(text: str) -> Iterator[tuple[str, list[float]]]:
    """Yield figures outside blocks, and their numbers."""
    for line in text.splitlines():
        for part in line.strip("|").split("|") if line[:1] == "|" else [line]:
            whole = line[:1] == "|" and _CELL.fullmatch(part.strip())
            for match in [whole] if whole else _FIGURE.finditer(part):
                yield match[0], _values(match[0])


def _values(text: str) -> list[float]:
    """Return the numbers in a text, without their signs."""
    return [float(k.replace(",", "").replace("−", "-")) for k in _NUMBER.findall(text)]


def _constants(path: str) -> set[float]:
    """Return the numbers that a Python file of the repository has, but for comments."""
    places = (root / path for root in (ROOT, ROOT / "ves_gym", ROOT / "docs"))
    file = next((place for place in places if place.is_file()), None)
    if file is None:
        return set()
    tree = ast.parse(file.read_text("utf-8"))
    words = {
        id(node.value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    }  # docstrings
    found: set[float] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and id(node) not in words:
            if isinstance(node.value, str):
                found |= set(_values(node.value))
            elif isinstance(node.value, (int, float)):
                found.add(float(abs(node.value)))
    return found


def main(words: Sequence[str]) -> int:
    """See the module's docstring; return 1 where a figure is a stray."""
    if words:
        source, target = map(Path, words)
        command = json.loads(source.read_text("utf-8"))["command"]
        write(target, re.sub(r" --out \S+", "", command), *of_benchmark(source))
    for path in PAGES:
        write_text(path, page(path))
    found = {path: strays(path.read_text("utf-8")) for path in PAGES}
    for path, figures in found.items():
        print(f"{path.relative_to(ROOT)}: {len(figures)} figures that nothing produces")
        print("".join(f"  {figure}\n" for figure in figures), end="")
    return int(any(found.values()))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
