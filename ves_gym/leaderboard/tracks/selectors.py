"""Selectors of the track *discrepancy*: how each answers a case, all in one form.

Four are read off one diagnosis, which tries all of them (`diagnosis.benchmark`). Two name
nothing and show what that is worth: one says at which port the record and the description
disagree, the other that nothing is missing, whatever it is shown.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from ves_gym.diagnosis.benchmark.run import FAILED
from ves_gym.diagnosis.benchmark.score import METHODS, OWN
from ves_gym.diagnosis.diagnose import NAMED, NOTHING, UNKNOWN

LOCATION = "location only"
SILENT = "always nothing"
SELECTORS = (*METHODS, LOCATION, SILENT)
# Root mean square over that of the noise from which `LOCATION` speaks: the gap beside the noise
# is then as large as the noise itself, tolerances of the description fitted along.
AUDIBLE = math.sqrt(2.0)

Plain = Mapping[str, Any]


def answer_of(diagnosed: Plain, selector: str) -> dict[str, Any]:
    """Return what a selector says of a case: the part that a score needs.

    Args:
        diagnosed: the record of a diagnosis, of `blind_benchmark.answer_case`.
        selector: of `SELECTORS`, but `SILENT`, which needs no diagnosis.
    """
    verdict, effects = diagnosed["verdict"], diagnosed["effects"]
    if selector == LOCATION and verdict != FAILED:
        return _location(diagnosed)
    if selector != OWN and verdict != FAILED:
        effects = diagnosed["baselines"][selector]
        verdict = NAMED if effects else NOTHING
    named = [{k: e[k] for k in ("kind", "slot", "value")} for e in effects]
    return {"index": diagnosed["index"], "verdict": verdict, "effects": named}


def silent(index: int) -> dict[str, Any]:
    """Return the answer of `SILENT` to a case."""
    return {"index": index, "verdict": NOTHING, "effects": []}


def _location(diagnosed: Plain) -> dict[str, Any]:
    """The port and channel that are off most, as something without a name."""
    port, channel, size, _ = max(diagnosed["gaps"], key=lambda gap: gap[2])
    if size <= AUDIBLE:
        return silent(diagnosed["index"])
    at = {"kind": port, "slot": channel, "value": {"gap": size}}
    return {"index": diagnosed["index"], "verdict": UNKNOWN, "effects": [at]}
