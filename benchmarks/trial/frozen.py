"""Answers as they were: what the diagnosis said of cases made by this generator.

`tests/golden/diagnoses.json` has them: the secrets of two sets of cases and, by set and number,
the effects hidden (their sizes are searched by simulation, so the generator is held, too) and
what `scoring.answer` returned. Names have values, intervals and gains where the case was
answered once more when the answers were frozen; elsewhere what was published of them.

Held are all fields but the seconds: words exactly, numbers to `CLOSE`. A gap is in units of
noise, and of what a computer evaluates (`admittance`) it is rounding: `NEGLIGIBLE` is held
absolutely. Another processor may differ in the last digits, and where a search is near a tie.
"""

import json
import math
import tempfile
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmarks.trial import scoring
from benchmarks.trial.cases import draw
from benchmarks.trial.targets import Cases
from benchmarks.trial.write import write_case

FILE = Path(__file__).parents[2] / "tests" / "golden" / "diagnoses.json"
CLOSE = 1e-6
NEGLIGIBLE = 1e-5


def stored() -> dict[str, Any]:
    """Return secrets by set, and cases by name (`17-012`)."""
    found: dict[str, Any] = json.loads(FILE.read_text("utf-8"))
    for case in found["cases"].values():
        case["gap"] = {k: (gap * 2)[:2] for k, gap in case["gap"].items()}  # one: no change
    return found


def labelled(counts: Mapping[str, int]) -> Cases:
    """Return label and answer of the first cases of sets.

    Args:
        counts: set -> how many.
    """
    found, out = stored(), []
    for name, case in found["cases"].items():
        number, _, index = name.partition("-")
        if int(index) < counts[number]:
            drawn = asdict(draw(found["secrets"][number], int(index)))
            out.append(({**drawn, "effects": case["effects"]}, case))
    return out


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
    """Make a case again, diagnose it, and return what differs from the answer stored.

    Args:
        name: of the case, `17-012`.
    """
    found = stored()
    number, _, index = name.partition("-")
    with tempfile.TemporaryDirectory() as folder:
        case = Path(folder) / "case"
        label = write_case(found["secrets"][number], int(index), case)
        given = scoring.answer(case, Path(folder) / "answer")
    then = found["cases"][name]
    del then["cpu"]
    return differences(then, {**given, "effects": label["effects"]})
