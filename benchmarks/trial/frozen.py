"""Answers as they were: what the diagnosis said of cases made by this generator.

`tests/golden/diagnoses.json` has 24, chosen to hold every kind: nulls, singles at joints, load,
sensor, weight estimate, platform and base, pairs, and laws outside the library, in space and in
the laboratory, five of them with seven joints. It has the secrets of two sets of cases and, by
set and number, the effects hidden (their sizes are searched by simulation, so the generator is
held, too) and what `scoring.answer` returned.

Held are all fields but the seconds: words exactly, numbers to `CLOSE`. A gap is in units of
noise, and of what a computer evaluates (`admittance`) it is rounding: `NEGLIGIBLE` is held
absolutely. Another processor may differ in the last digits, and where a search is near a tie.
"""

import json
import math
import tempfile
import tomllib
from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmarks.trial import scoring
from benchmarks.trial.cases import draw
from benchmarks.trial.targets import Cases, targets
from benchmarks.trial.write import write_case

FILE = Path(__file__).parents[2] / "tests" / "golden" / "diagnoses.json"
SETS = Path(__file__).with_name("sets.toml")
MARKS = ("right", "class", "partly", "wrong", "unknown", "silent")  # by their first letters
CLOSE = 1e-6
NEGLIGIBLE = 1e-5


def stored() -> dict[str, Any]:
    """Return secrets by set, and cases by name (`17-012`)."""
    found: dict[str, Any] = json.loads(FILE.read_text("utf-8"))
    return found


def labelled() -> Cases:
    """Return label and answer of every case."""
    found, out = stored(), []
    for name, case in found["cases"].items():
        number, _, index = name.partition("-")
        drawn = asdict(draw(found["secrets"][number], int(index)))
        out.append(({**drawn, "effects": case["effects"]}, case))
    return out


def cases_judged() -> str:
    """Return the rows of what a trial must show, of the cases stored, as Markdown."""
    return targets(labelled())


def sets_judged() -> str:
    """Return how the answers of `sets.toml` were judged, by category and gap, as Markdown."""
    counts: Counter[tuple[str, float, str]] = Counter()
    for one in tomllib.loads(SETS.read_text("utf-8"))["set"].values():
        for index, letter in enumerate(one["judged"]):
            case = draw(one["secret"], index)
            counts[case.category, case.gap, letter] += 1
    lines = ["| | " + " | ".join(MARKS) + " |", "|---" * (len(MARKS) + 1) + "|"]
    for category, gap in sorted({key[:2] for key in counts}):
        size = f", {gap:g} times the noise" if gap else ""
        cells = [str(counts[category, gap, mark[0]]) for mark in MARKS]
        lines.append(f"| {category}{size} | {' | '.join(cells)} |")
    return "\n".join(lines)


def made_again(name: str) -> dict[str, Any]:
    """Make a case again and diagnose it; return the effects hidden and the answer.

    Args:
        name: of the case, `17-012`.
    """
    number, _, index = name.partition("-")
    with tempfile.TemporaryDirectory() as folder:
        case = Path(folder) / "case"
        label = write_case(stored()["secrets"][number], int(index), case)
        return {"effects": label["effects"], **scoring.answer(case, Path(folder) / "answer")}


def record(name: str) -> None:
    """Store what is answered now, one line a case; nine digits are kept of a number."""
    now = json.loads(
        json.dumps(made_again(name)), parse_float=lambda x: float(f"{float(x):.9g}")
    )
    found = stored()
    found["cases"] = dict(sorted({**found["cases"], name: now}.items()))
    cases = ",\n".join(f"{json.dumps(k)}: {json.dumps(v)}" for k, v in found["cases"].items())
    secrets = json.dumps(found["secrets"])
    FILE.write_text(f'{{\n"secrets": {secrets},\n"cases": {{\n{cases}\n}}\n}}\n', "utf-8")


def differences(then: Any, now: Any, at: str = "") -> list[str]:
    """Return what differs between an answer as it was and one of now.

    Args:
        then: as stored; what it lacks is not compared.
        now: of `scoring.answer`.
        at: where in the answer.
    """
    if isinstance(then, dict):
        return [d for k, v in then.items() for d in differences(v, now.get(k), f"{at}/{k}")]
    if isinstance(then, list) and isinstance(now, list | tuple) and len(then) == len(now):
        return [d for i, v in enumerate(then) for d in differences(v, now[i], f"{at}/{i}")]
    if isinstance(then, float) and isinstance(now, float):
        least = NEGLIGIBLE if at.startswith("/gap") else 0.0
        same = math.isclose(then, now, rel_tol=CLOSE, abs_tol=least)
    else:
        same = then == now
    return [] if same else [f"{at}: {then!r}, now {now!r}"]


def check(name: str) -> list[str]:
    """Make a case again, diagnose it, and return what differs from the answer stored."""
    then = stored()["cases"][name]
    del then["cpu"]
    return differences(then, made_again(name))
