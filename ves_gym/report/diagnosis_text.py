"""A diagnosis as text: the verdict, how sure it is, and what the gaps were and are."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ves_gym._util.tables import table
from ves_gym.diagnosis.diagnose import ONE_OF, UNKNOWN, WIDE, Diagnosis

_SHOWN = 12  # channels in the table
_SEEN = 0.005  # probability from which a hypothesis is printed


def diagnosis_text(diagnosis: Diagnosis, result: Mapping[str, Any]) -> str:
    """Return what `ves-gym diagnose` prints.

    Args:
        diagnosis: the verdict.
        result: what the command writes as JSON.
    """
    beliefs = [f"{k} {p:.2f}" for k, p in result["hypotheses"].items() if p >= _SEEN]
    lines = [
        diagnosis.sentence,
        result["null"]["sentence"],
        f"Probabilities: {', '.join(beliefs)}.",
    ]
    for experiment in result["experiments"] if diagnosis.verdict == ONE_OF else ():
        lines.append(f"next experiment: {experiment['sentence']}")
    if designed := result["next_motion"]:
        lines += [
            f"designed: {designed['sentence']}",
            f"  the motion, at every control period: {designed['files'][1]}",
            f"  in simulation: {designed['simulate']}",
            f"  afterwards: {designed['diagnose']}",
        ]
    if diagnosis.verdict == UNKNOWN and diagnosis.explanations:
        lines.append("the best that the library can do, not a name:")
    for f in diagnosis.explanations:
        rows = zip(f.candidate.names, f.values, f.std, f.candidate.units, strict=True)
        numbers = ", ".join(
            f"{name} = {value:.4g} +- {WIDE * std:.2g} {unit}"
            for name, value, std, unit in rows
        )
        lines.append(f"  {f.candidate.name}: {numbers} (90 %), p = {f.probability:.2f}")
    for f in diagnosis.withheld:
        lines.append(
            f"  withheld: {f.candidate.name}; of names with such evidence"
            f" {100 * f.reliability:.0f} % are right"
        )
    lines.append(_gaps(diagnosis, result["held_back"]))
    if result["worse"]:
        lines.append(f"worse by more than 2 %: {', '.join(result['worse'])}")
    lines += [f"held back, so opened last: {question}" for question in result["doubts"]]
    lines += result["notes"]
    for port, lacks in result["untestable"].items():
        lines.append(f"not tested: {port}, the logs lack {', '.join(lacks)}")
    return "\n".join(lines)


def _gaps(diagnosis: Diagnosis, held_back: list[str]) -> str:
    of = f"held back: {', '.join(held_back)}" if diagnosis.final else "the runs fitted"
    rows = []
    for gap in sorted(diagnosis.final or diagnosis.gaps, key=lambda g: -g.before)[:_SHOWN]:
        sure = [f"{a:.2f} to {b:.2f}" for a, b in (gap.before_interval, gap.after_interval)]
        before, after = f"{gap.before:.2f}", f"{gap.after:.2f}"
        rows.append((gap.port, gap.channel, before, sure[0], after, sure[1]))
    title = f"gap in standard deviations of noise, {of}"
    head = ("port", "channel", "before", "95 %", "after", "95 %")
    return table(head, rows, title=title, left=(0, 1), width=110)
