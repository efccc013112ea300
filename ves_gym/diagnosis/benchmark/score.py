"""Scores of answers against labels: the rows of the target table, and the confusion.

An effect is named right if kind and slot are the label's. A case of one effect is right if
nothing else is named beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy

from ves_gym.diagnosis.benchmark.labels import INTERVAL, Name, answer_name, label_name, numbers
from ves_gym.diagnosis.diagnose import (
    MORE,
    NAMED,
    NAMING_VERDICTS,
    NOTHING,
    ONE_OF,
    UNKNOWN,
    WEAK,
)

OWN = "ves-gym"
METHODS = (OWN, "stepwise", "stepwise, tolerances", "smallest error")
VISIBLE = 3.0  # gap over noise from which a name is owed
LARGE = 10.0
CONFIDENCE = 0.95
_BINS = 10  # of probability
_CLEAR = 2.0  # times the noise: a gap before, of which a part removed means something
_WORSE = 1.02
_QUIET = (NOTHING, WEAK)
NOTHING_COLUMN, UNKNOWN_COLUMN, AMBIGUOUS_COLUMN = "nothing", "unknown", "ambiguous"

Plain = Mapping[str, Any]


@dataclass(frozen=True)
class TargetRow:
    """A quantity with its target."""

    name: str
    value: float | None
    n: int  # what it was computed from
    low: float | None = None  # one-sided 95 % bounds
    high: float | None = None
    least: float | None = None  # target
    most: float | None = None
    unit: str = "1"  # "1" for shares

    @property
    def met(self) -> bool | None:
        """True if the target is met; None without one, or without cases."""
        if self.value is None or (self.least is None and self.most is None):
            return None
        above = self.least is None or self.value >= self.least
        return above and (self.most is None or self.value <= self.most)


@dataclass(frozen=True)
class ScoredCase:
    """A label and the answer of one method."""

    label: Plain
    verdict: str
    effects: Sequence[Plain]  # those named; empty unless the verdict gives names
    answer: Plain  # the whole record

    @property
    def category(self) -> str:
        """single, null, outside, pair or weak."""
        return str(self.label["category"])

    @property
    def ratio(self) -> float:
        """Least gap over noise that its effects were sized for."""
        return min((float(e["wanted"]) for e in self.label["effects"]), default=0.0)

    @cached_property
    def true_names(self) -> list[Name]:
        """Kind and slot of every effect that is there."""
        return [label_name(e) for e in self.label["effects"]]

    @cached_property
    def answered_names(self) -> list[Name]:
        """Kind and slot of every effect that the answer names."""
        return [answer_name(e) for e in self.effects]

    @property
    def correct(self) -> bool:
        """True if exactly the effects there are named, by kind and slot."""
        return set(self.answered_names) == set(self.true_names) and len(
            self.answered_names
        ) == len(self.true_names)

    @property
    def in_class(self) -> bool:
        """True if one effect is named, and the truth is among those that do as well."""
        if len(self.effects) != 1:
            return False
        near = [r for r in self.effects[0].get("rivals", ()) if r["near"]]
        return self.true_names[0] in {answer_name(e) for e in (self.effects[0], *near)}

    @property
    def belief(self) -> float:
        """Probability that the answer has for the truth of a single case."""
        best = 0.0
        for e in self.effects:
            rivals = e.get("rivals") or ({**e, "probability": 1.0},)
            mine = (r["probability"] for r in rivals if answer_name(r) == self.true_names[0])
            best = max(best, sum(mine))
        return best


def cases_of(
    labels: Sequence[Plain], answers: Sequence[Plain], method: str = OWN
) -> list[ScoredCase]:
    """Pair labels with the answers of a method; a baseline always gives names or nothing.

    Args:
        labels, answers: in the same order.
        method: of `METHODS`.
    """
    out = []
    for label, answer in zip(labels, answers, strict=True):
        if method == OWN:
            verdict = answer["verdict"]
            effects = answer["effects"] if verdict in NAMING_VERDICTS else []
        elif "why" in answer:  # failed before a baseline had its residuals
            verdict, effects = answer["verdict"], []
        else:
            effects = answer["baselines"][method]
            verdict = NAMED if effects else NOTHING
        out.append(ScoredCase(label, verdict, effects, answer))
    return out


def score(labels: Sequence[Plain], answers: Sequence[Plain]) -> dict[str, Any]:
    """Score all methods: per method the rows of the table, the curve, the confusion.

    Args:
        labels, answers: in the same order.

    Returns:
        Plain data.
    """
    out: dict[str, Any] = {"methods": {}}
    for method in METHODS:
        cases = cases_of(labels, answers, method)
        out["methods"][method] = {
            "rows": [{**asdict(r), "met": r.met} for r in rows(cases, method == OWN)],
            "by_ratio": by_ratio(cases),
            "by_kind": by_kind(cases),
            "confusion": confusion(cases),
        }
    scored = cases_of(labels, answers)
    out["cases"] = {k: sum(c.category == k for c in scored) for k in _CATEGORIES}
    out["failed"] = [a["index"] for a in answers if "why" in a]
    out["missed"] = [missed(c) for c in scored if not is_correct(c)]
    return out


_CATEGORIES = ("single", "null", "outside", "pair", "weak")


def bounds(hits: int, n: int) -> tuple[float, float]:
    """Return one-sided 95 % bounds of a share, lower and upper (Clopper and Pearson 1934).

    Args:
        hits: of n.
        n: cases.
    """
    beta = scipy.stats.beta
    low = float(beta.ppf(1 - CONFIDENCE, hits, n - hits + 1)) if hits else 0.0
    high = float(beta.ppf(CONFIDENCE, hits + 1, n - hits)) if hits < n else 1.0
    return low, high


def share(name: str, hits: Iterable[bool], **target: float) -> TargetRow:
    """Return a share of cases, with its bounds.

    Args:
        name: of the row.
        hits: one per case.
        target: `least`, `most`.
    """
    list_ = list(hits)
    if not list_:
        return TargetRow(name, None, 0, **target)  # type: ignore[arg-type]
    k, n = sum(list_), len(list_)
    low, high = bounds(k, n)
    return TargetRow(name, k / n, n, low, high, **target)  # type: ignore[arg-type]


def _middle(name: str, values: Sequence[float], unit: str = "1", **target: float) -> TargetRow:
    value = float(np.median(values)) if values else None
    return TargetRow(name, value, len(values), unit=unit, **target)  # type: ignore[arg-type]


def rows(cases: Sequence[ScoredCase], with_probabilities: bool = True) -> list[TargetRow]:
    """Return the target table.

    Args:
        cases: of one method.
        with_probabilities: with the rows for which answers must hold probabilities.
    """
    of = {k: [c for c in cases if c.category == k] for k in _CATEGORIES}
    owed = [c for c in of["single"] if c.ratio >= VISIBLE]
    pairs = of["pair"]
    out = [share("single, 3x noise and more: name", (c.correct for c in owed), least=0.90)]
    if with_probabilities:
        out += [
            share(
                "single, 3x and more: in the class named",
                (c.correct or c.in_class for c in owed),
                least=0.97,
            ),
            TargetRow(
                "single, 3x and more: mean probability of the truth",
                float(np.mean([c.belief for c in owed])) if owed else None,
                len(owed),
                least=0.85,
            ),
        ]
    out += [
        share(
            "single, 3x and more: right one named, others beside it",
            (len(c.answered_names) > 1 and c.true_names[0] in c.answered_names for c in owed),
        ),
        share(
            "single, 3x and more: right, but more said to remain",
            (c.correct and c.verdict == MORE for c in owed),
        ),
        share("null: false alarm", (c.verdict not in _QUIET for c in of["null"]), most=1 / 120),
        share(
            "outside: a wrong name", (bool(c.answered_names) for c in of["outside"]), most=0.05
        ),
    ]
    if with_probabilities:
        unknown = (c.verdict == UNKNOWN for c in of["outside"])
        out.append(share("outside: said to be unknown", unknown, least=0.85))
        finals = (c.answer["final"] for c in of["outside"] if c.verdict == UNKNOWN)
        removed = [r for final in finals if (r := removed_gap(final)) is not None]
        name = "outside, unknown: gap above noise removed, runs held back, median"
        out.append(_middle(name, removed, least=0.70))
    out.append(
        share(
            "pair: both named",
            (set(c.true_names) <= set(c.answered_names) for c in pairs),
            least=0.75,
        )
    )
    out += _retrieval(pairs)
    out.append(share("right slot where the kind is right", _slots(cases), least=0.95))
    if with_probabilities:
        out += _probability_rows(cases, owed, of["weak"])
    return out


def _probability_rows(
    cases: Sequence[ScoredCase], owed: Sequence[ScoredCase], weak: Sequence[ScoredCase]
) -> list[TargetRow]:
    large = [c for c in owed if c.ratio >= LARGE]
    pairs = [p for c in owed if c.correct for p in _numbers(c)]
    inside = [abs(f - t) <= INTERVAL * s for t, f, s in pairs if s is not None]
    off = [abs(f - t) / abs(t) for t, f, _ in pairs if t]
    removed = [r for c in large if (r := removed_gap(c.answer["final"])) is not None]
    seconds = [float(c.answer["seconds"]["total"]) for c in cases]
    return [
        _calibration(cases),
        share("90 % intervals that hold the true number", inside, least=0.85, most=0.95),
        _middle("relative error of numbers, median", off, most=0.05),
        _middle("single, 10x: gap above noise removed, runs held back, median", removed,
                least=0.90),
        share("a channel worse by more than 2 % on runs held back",
              (_worse(c.answer["final"]) for c in cases), most=0.0),
        share("weak: said to be too weak", (c.verdict == WEAK for c in weak)),
        _middle("time of a diagnosis, median", seconds, "s", most=60.0),
    ]  # fmt: skip


def _numbers(case: ScoredCase) -> list[tuple[float, float, float | None]]:
    return numbers(case.label["effects"][0], case.effects[0])


def _retrieval(pairs: Sequence[ScoredCase]) -> list[TargetRow]:
    """Return precision, recall and F1 over all effects of the pairs."""
    hits = sum(len(set(c.true_names) & set(c.answered_names)) for c in pairs)
    n_answered, n_true = (
        sum(len(c.answered_names) for c in pairs),
        sum(len(c.true_names) for c in pairs),
    )
    precision = hits / n_answered if n_answered else None
    recall = hits / n_true if n_true else None
    f1 = 2 * hits / (n_answered + n_true) if n_true else None
    return [
        TargetRow("pair: precision", precision, n_answered),
        TargetRow("pair: recall", recall, n_true),
        TargetRow("pair: F1", f1, len(pairs), least=0.88),
    ]


def _slots(cases: Sequence[ScoredCase]) -> list[bool]:
    """Return hits of the slot among effects of the right kind, where a kind has several."""
    out = []
    for c in cases:
        for kind, slot in c.true_names:
            same = [g for g in c.answered_names if g[0] == kind]
            if slot and same:
                out.append((kind, slot) in same)
    return out


def _calibration(cases: Sequence[ScoredCase]) -> TargetRow:
    """Return the expected calibration error of the probabilities named, in ten bins."""
    p = np.array([e["probability"] for c in cases for e in c.effects], float)
    kinds = [(e["kind"], {k for k, _ in c.true_names}) for c in cases for e in c.effects]
    hits = np.array([kind in kinds_true for kind, kinds_true in kinds], float)
    name = "calibration error of probabilities"
    if not len(p):
        return TargetRow(name, None, 0, most=0.05)
    which = np.minimum((p * _BINS).astype(int), _BINS - 1)
    error = sum(
        np.sum(which == b) / len(p) * abs(p[which == b].mean() - hits[which == b].mean())
        for b in np.unique(which)
    )
    return TargetRow(name, float(error), len(p), most=0.05)


def removed_gap(final: Sequence[Sequence[Any]]) -> float | None:
    """Return the part of the gap above noise that is gone, in the channel that was off most.

    None where no channel was off by twice the noise.
    """
    if not final:
        return None
    *_, before, after = max(final, key=lambda g: g[2])
    if before < _CLEAR:
        return None
    return float(1 - np.sqrt(max(after**2 - 1, 0.0) / (before**2 - 1)))


def _worse(final: Sequence[Sequence[Any]]) -> bool:
    return any(after > _WORSE * max(before, 1.0) for *_, before, after in final)


def by_ratio(cases: Sequence[ScoredCase]) -> list[dict[str, Any]]:
    """Return names right of single cases by gap over noise."""
    singles = [c for c in cases if c.category == "single"]
    out = []
    for ratio in sorted({c.ratio for c in singles}):
        group = [c for c in singles if c.ratio == ratio]
        out.append({"ratio": ratio, "n": len(group)} | _counts(group))
    return out


def by_kind(cases: Sequence[ScoredCase]) -> list[dict[str, Any]]:
    """Return single cases of every kind: right of all by gap, and the least gap named right."""
    singles = [c for c in cases if c.category == "single"]
    out = []
    for kind in sorted({c.true_names[0][0] for c in singles}):
        group = [c for c in singles if c.true_names[0][0] == kind]
        gaps = [c.label["effects"][0]["reached"] for c in group if c.correct]
        ratios = sorted({c.ratio for c in group})
        out.append(
            {
                "kind": kind,
                "right": {
                    f"{r:g}": [sum(c.correct for c in group if c.ratio == r),
                               sum(c.ratio == r for c in group)]
                    for r in ratios
                },
                "least": min(gaps, default=None),
            }
        )  # fmt: skip
    return out


def _counts(group: Sequence[ScoredCase]) -> dict[str, int]:
    tests: dict[str, Callable[[ScoredCase], bool]] = {
        "right": lambda c: c.correct,
        "in class": lambda c: c.correct or c.in_class,
        "nothing": lambda c: c.verdict in _QUIET,
        "unknown": lambda c: c.verdict == UNKNOWN,
    }
    return {name: sum(map(test, group)) for name, test in tests.items()}


def column(case: ScoredCase) -> str:
    """Return the column under which an answer to a case without pairs is counted."""
    if case.verdict in _QUIET:
        return NOTHING_COLUMN
    if not case.effects:
        return UNKNOWN_COLUMN if case.verdict == UNKNOWN else case.verdict
    if case.verdict == ONE_OF:
        return AMBIGUOUS_COLUMN
    kinds = [k for k, _ in case.answered_names]
    true_names = [k for k, _ in case.true_names if k in kinds]
    return (true_names or kinds)[0]


def confusion(cases: Sequence[ScoredCase], least: float = VISIBLE) -> dict[str, dict[str, int]]:
    """Count answers by true kind and answered column.

    Args:
        cases: all; pairs are left out.
        least: gap over noise below which single cases are left out.
    """
    out: dict[str, dict[str, int]] = {}
    for c in cases:
        if c.category == "pair" or (c.category == "single" and c.ratio < least):
            continue
        kind = c.true_names[0][0] if c.true_names else NOTHING_COLUMN
        row = out.setdefault(kind if c.category != "weak" else f"{kind} (weak)", {})
        row[column(c)] = row.get(column(c), 0) + 1
    return {k: dict(sorted(out[k].items())) for k in sorted(out)}


def is_correct(case: ScoredCase) -> bool:
    """Return True if an answer is what the table asks of its case."""
    if case.category == "null":
        return case.verdict in _QUIET
    if case.category == "outside":
        return case.verdict == UNKNOWN
    if case.category == "weak":
        return case.verdict == WEAK
    return case.correct


def missed(case: ScoredCase) -> dict[str, Any]:
    """Return a case that was answered wrong, as plain data."""
    return {
        "index": case.label["index"],
        "category": case.category,
        "true": [
            {"kind": k, "slot": s, "gap": e["reached"]}
            for (k, s), e in zip(case.true_names, case.label["effects"], strict=True)
        ],
        "verdict": case.verdict,
        "given": [{"kind": k, "slot": s} for k, s in case.answered_names],
        "in_class": case.category == "single" and case.in_class,
    }
