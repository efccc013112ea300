"""Rows of what a trial must show, with their 95 % intervals (Clopper and Pearson)."""

from collections.abc import Iterable
from dataclasses import fields
from typing import Any

import numpy as np
import scipy.stats as st

from benchmarks.trial.arm import Array
from benchmarks.trial.cases import Case
from benchmarks.trial.imitation import most_gained
from benchmarks.trial.scoring import Label, in_place, judge

Answer = dict[str, Any]
Cases = list[tuple[Label, Answer]]
SURE, BINS = 0.99, 10
LARGE = 2.7  # gap over noise of singles that are owed a name: sizes are drawn for 3, and vary
NEEDED = 35.0  # deviance that a name needs: what gains less in any runs cannot be told


def share(hits: Iterable[bool]) -> str:
    """Return a share as `hits of n (%; low to high %)`."""
    marks = list(hits)
    k, n = sum(marks), len(marks)
    if not n:
        return "no case"
    low = st.beta.ppf(0.025, k, n - k + 1) if k else 0.0
    high = st.beta.ppf(0.975, k + 1, n - k) if k < n else 1.0
    return f"{k} of {n} ({100 * k / n:.0f} %; {100 * low:.0f} to {100 * high:.0f} %)"


def _median(shares: list[float]) -> str:
    if not shares:
        return "no case"
    return f"{100 * float(np.median(shares)):.0f} % (n = {len(shares)})"


def _removed(given: Answer) -> float:
    """Return the part of the gap above noise that is gone on the run held back."""
    before, after = (
        sum(max(gap[side] ** 2 - 1, 0.0) for gap in given["gap"].values()) for side in (0, 1)
    )
    return 1 - after / before if before else 0.0


def alarms(nulls: Cases) -> str:
    """Return the share of nulls that are not silent."""
    return share(judge(a, given) != "right" for a, given in nulls)


def as_described(label: Label) -> bool:
    """Return True for a null whose tolerances are those that its description states."""
    return label["category"] == "null" and (label["factor"] == 1 or label["stated"])


def names_told(cases: Cases) -> list[tuple[float, bool]]:
    """Return probability and truth of every name given."""
    return [
        (float(name["probability"]), any(in_place(t, name) for t in label["effects"]))
        for label, given in cases
        for name in given["names"]
    ]


def calibration_error(p: Array, right: Array) -> float:
    """Return the mean distance of probability and share of the right, over ten ranges.

    Args:
        p: (n,) probabilities.
        right: (n,) 1 where the name is right, else 0.
    """
    at = np.minimum((p * BINS).astype(int), BINS - 1)
    return float(sum(abs((p - right)[at == b].sum()) for b in range(BINS)) / len(p))


def _calibration(names: list[tuple[float, bool]]) -> str:
    if not names:
        return "no name"
    p, right = np.array(names, float).T
    return f"{calibration_error(p, right):.3f} (n = {len(p)})"


def _f1(pairs: Cases) -> str:
    """Return the F1 of the names of pairs."""
    if not pairs:
        return "no case"
    found = sum(
        any(in_place(t, n) for n in given["names"])
        for label, given in pairs
        for t in label["effects"]
    )
    given_names = names_told(pairs)
    right, truths = sum(r for _, r in given_names), sum(len(a["effects"]) for a, _ in pairs)
    precision = right / len(given_names) if given_names else 0.0
    recall = found / truths
    total = precision + recall
    return f"{2 * precision * recall / total if total else 0.0:.2f}"


def can_be_told(label: Label) -> bool:
    """Return False if tolerances of the machine imitate an effect of a case, and likely so.

    Args:
        label: of the case.
    """
    case = Case(**{f.name: label[f.name] for f in fields(Case)})
    sizes = [effect["size"] for effect in label["effects"]]
    return all(most_gained(case, i, size) >= NEEDED for i, size in enumerate(sizes))


def targets(every: Cases) -> str:
    """Return the rows as Markdown."""

    def of(category: str) -> Cases:
        return [(a, given) for a, given in every if a["category"] == category]

    large = [(a, g) for a, g in of("single") if min(e["gap"] for e in a["effects"]) >= LARGE]
    usual = [(a, g) for a, g in of("null") if as_described(a)]
    beyond = [(a, g) for a, g in of("null") if not as_described(a)]
    outside, pairs, names = of("outside"), of("pair"), names_told(every)
    unknown = [_removed(g) for a, g in outside if g["verdict"] == "not in the library"]
    sure = [right for p, right in names if p > SURE]
    times = sorted(g["cpu"] for _, g in every)

    def mark(part: Cases, *wanted: str) -> str:
        return share(judge(a, given) in wanted for a, given in part)

    rows = [
        ("singles >= 3 x: named alone, kind and place", mark(large, "right"), ">= 92 %"),
        ("the same, or its class", mark(large, "right", "class"), ">= 97 %"),
        (
            "singles >= 3 x that tolerances cannot imitate: named alone",
            mark([(a, g) for a, g in large if can_be_told(a)], "right"),
            "",
        ),
        (
            "nulls, tolerances as described: false alarms",
            alarms(usual),
            "<= 1 of 120",
        ),
        (
            "nulls, tolerances 3 and 10 times those described, unsaid: alarms",
            alarms(beyond),
            "",
        ),
        ("outside: unknown", mark(outside, "right"), ">= 90 %"),
        ("outside: a wrong name", mark(outside, "wrong"), "<= 4 %"),
        ("pairs: both named, nothing else", mark(pairs, "right"), ">= 80 %"),
        (
            "pairs that tolerances cannot imitate: both named",
            mark([(a, g) for a, g in pairs if can_be_told(a)], "right"),
            "",
        ),
        ("pairs: F1", _f1(pairs), ">= 0.9"),
        (f"names with p > {SURE} that are right", share(sure), ">= 97 %"),
        ("calibration error", _calibration(names), "<= 0.04"),
        (
            "a channel worse by 2 % on the run held back",
            share(bool(g["worse"]) for _, g in every),
            "0",
        ),
        (
            "outside, unknown: gap above noise removed on the run held back, median",
            _median(unknown),
            ">= 70 %",
        ),
        (
            "processor time of an answer, median",
            f"{times[len(times) // 2]:.0f} s" if times else "no case",
            "<= 60 s",
        ),
    ]  # fmt: skip
    lines = ["| quantity | result (95 % interval) | target |", "|---|---|---|"]
    return "\n".join(lines + [f"| {a} | {b} | {c} |" for a, b, c in rows])


def each_case(cases: Cases) -> str:
    """Return one row of each case as Markdown."""
    lines = ["| case | machine | noise | tolerances | truth (gap / noise) | answer | judged |"]
    lines += ["|---" * 7 + "|"]
    for label, given in cases:
        mode = "laboratory" if label["mode"] == "emulated" else "space"
        said = ", stated" if label["stated"] else ", unsaid"
        factor = f"{label['factor']:g}" + ("" if label["factor"] == 1 else said)
        effects = label["effects"]
        truth = ", ".join(_placed(e["kind"], e["slot"]) for e in effects)
        gaps = ", ".join(f"{e['gap']:.3g}" for e in effects)
        names = ", ".join(
            f"{_placed(n['kind'], n['slot'])} ({n['probability']:.2f})" for n in given["names"]
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
