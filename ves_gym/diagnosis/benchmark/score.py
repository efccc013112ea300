"""Scores of answers against labels: the rows of the target table, and who was taken for whom.

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

from ves_gym.diagnosis.benchmark.labels import INTERVAL, Name, given_name, numbers, true_name
from ves_gym.diagnosis.diagnose import MORE, NAMED, NOTHING, ONE_OF, SPEAKS, UNKNOWN, WEAK

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
class Row:
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
        """Whether the target is met; None without one, or without cases."""
        if self.value is None or (self.least is None and self.most is None):
            return None
        above = self.least is None or self.value >= self.least
        return above and (self.most is None or self.value <= self.most)


@dataclass(frozen=True)
class Case:
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
        """The least gap over noise that was wanted of its effects."""
        return min((float(e["wanted"]) for e in self.label["effects"]), default=0.0)

    @cached_property
    def true(self) -> list[Name]:
        """What is there."""
        return [true_name(e) for e in self.label["effects"]]

    @cached_property
    def given(self) -> list[Name]:
        """What is said to be there."""
        return [given_name(e) for e in self.effects]

    @property
    def right(self) -> bool:
        """Exactly what is there, by kind and slot."""
        return set(self.given) == set(self.true) and len(self.given) == len(self.true)

    @property
    def in_class(self) -> bool:
        """One effect is named, and the truth is among those that do as well."""
        if len(self.effects) != 1:
            return False
        near = [r for r in self.effects[0].get("rivals", ()) if r["near"]]
        return self.true[0] in {given_name(e) for e in (self.effects[0], *near)}

    @property
    def belief(self) -> float:
        """Probability that is given to the truth of a single case."""
        best = 0.0
        for e in self.effects:
            rivals = e.get("rivals") or ({**e, "probability": 1.0},)
            mine = (r["probability"] for r in rivals if given_name(r) == self.true[0])
            best = max(best, sum(mine))
        return best


def cases_of(
    labels: Sequence[Plain], answers: Sequence[Plain], method: str = OWN
) -> list[Case]:
    """Labels paired with what a method says; a baseline always gives names or nothing."""
    out = []
    for label, answer in zip(labels, answers, strict=True):
        if method == OWN:
            verdict = answer["verdict"]
            effects = answer["effects"] if verdict in SPEAKS else []
        elif "why" in answer:  # failed before a baseline had its evidence
            verdict, effects = answer["verdict"], []
        else:
            effects = answer["baselines"][method]
            verdict = NAMED if effects else NOTHING
        out.append(Case(label, verdict, effects, answer))
    return out


def score(labels: Sequence[Plain], answers: Sequence[Plain]) -> dict[str, Any]:
    """Everything, plain data: per method the rows of the table, the curve, the confusion."""
    out: dict[str, Any] = {"methods": {}}
    for method in METHODS:
        cases = cases_of(labels, answers, method)
        out["methods"][method] = {
            "rows": [{**asdict(r), "met": r.met} for r in rows(cases, method == OWN)],
            "by_ratio": by_ratio(cases),
            "by_kind": by_kind(cases),
            "confusion": confusion(cases),
        }
    own = cases_of(labels, answers)
    out["cases"] = {k: sum(c.category == k for c in own) for k in _CATEGORIES}
    out["failed"] = [a["index"] for a in answers if "why" in a]
    out["missed"] = [missed(c) for c in own if not fine(c)]
    return out


_CATEGORIES = ("single", "null", "outside", "pair", "weak")


def bounds(hits: int, n: int) -> tuple[float, float]:
    """One-sided 95 % bounds of a share, lower and upper (Clopper and Pearson 1934)."""
    beta = scipy.stats.beta
    low = float(beta.ppf(1 - CONFIDENCE, hits, n - hits + 1)) if hits else 0.0
    high = float(beta.ppf(CONFIDENCE, hits + 1, n - hits)) if hits < n else 1.0
    return low, high


def share(name: str, hits: Iterable[bool], **target: float) -> Row:
    """A share of cases, with its bounds."""
    list_ = list(hits)
    if not list_:
        return Row(name, None, 0, **target)  # type: ignore[arg-type]
    k, n = sum(list_), len(list_)
    low, high = bounds(k, n)
    return Row(name, k / n, n, low, high, **target)  # type: ignore[arg-type]


def _middle(name: str, values: Sequence[float], unit: str = "1", **target: float) -> Row:
    value = float(np.median(values)) if values else None
    return Row(name, value, len(values), unit=unit, **target)  # type: ignore[arg-type]


def rows(cases: Sequence[Case], own: bool = True) -> list[Row]:
    """The target table; `own`: with what only answers that hold probabilities can have."""
    of = {k: [c for c in cases if c.category == k] for k in _CATEGORIES}
    owed = [c for c in of["single"] if c.ratio >= VISIBLE]
    pairs = of["pair"]
    out = [share("single, 3x noise and more: name", (c.right for c in owed), least=0.90)]
    if own:
        out += [
            share(
                "single, 3x and more: in the class named",
                (c.right or c.in_class for c in owed),
                least=0.97,
            ),
            Row(
                "single, 3x and more: mean probability of the truth",
                float(np.mean([c.belief for c in owed])) if owed else None,
                len(owed),
                least=0.85,
            ),
        ]
    out += [
        share(
            "single, 3x and more: right one named, others beside it",
            (len(c.given) > 1 and c.true[0] in c.given for c in owed),
        ),
        share(
            "single, 3x and more: right, but more said to remain",
            (c.right and c.verdict == MORE for c in owed),
        ),
        share("null: false alarm", (c.verdict not in _QUIET for c in of["null"]), most=1 / 120),
        share("outside: a wrong name", (bool(c.given) for c in of["outside"]), most=0.05),
    ]
    if own:
        unknown = (c.verdict == UNKNOWN for c in of["outside"])
        out.append(share("outside: said to be unknown", unknown, least=0.85))
    out.append(
        share("pair: both named", (set(c.true) <= set(c.given) for c in pairs), least=0.75)
    )
    out += _retrieval(pairs)
    out.append(share("right slot where the kind is right", _slots(cases), least=0.95))
    if own:
        out += _only_own(cases, owed, of["weak"])
    return out


def _only_own(cases: Sequence[Case], owed: Sequence[Case], weak: Sequence[Case]) -> list[Row]:
    large = [c for c in owed if c.ratio >= LARGE]
    found = [p for c in owed if c.right for p in _numbers(c)]
    inside = [abs(f - t) <= INTERVAL * s for t, f, s in found if s is not None]
    off = [abs(f - t) / abs(t) for t, f, _ in found if t]
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


def _numbers(case: Case) -> list[tuple[float, float, float | None]]:
    return numbers(case.label["effects"][0], case.effects[0])


def _retrieval(pairs: Sequence[Case]) -> list[Row]:
    """Precision, recall and F1 over all effects of the pairs."""
    hits = sum(len(set(c.true) & set(c.given)) for c in pairs)
    given, true = sum(len(c.given) for c in pairs), sum(len(c.true) for c in pairs)
    precision = hits / given if given else None
    recall = hits / true if true else None
    f1 = 2 * hits / (given + true) if true else None
    return [
        Row("pair: precision", precision, given),
        Row("pair: recall", recall, true),
        Row("pair: F1", f1, len(pairs), least=0.88),
    ]


def _slots(cases: Sequence[Case]) -> list[bool]:
    """Of effects named with the right kind, where a kind has several slots."""
    out = []
    for c in cases:
        for kind, slot in c.true:
            same = [g for g in c.given if g[0] == kind]
            if slot and same:
                out.append((kind, slot) in same)
    return out


def _calibration(cases: Sequence[Case]) -> Row:
    """Expected calibration error of the probabilities of all kinds named, in ten bins."""
    p = np.array([e["probability"] for c in cases for e in c.effects], float)
    kinds = [(e["kind"], {k for k, _ in c.true}) for c in cases for e in c.effects]
    right = np.array([kind in true for kind, true in kinds], float)
    name = "calibration error of probabilities"
    if not len(p):
        return Row(name, None, 0, most=0.05)
    which = np.minimum((p * _BINS).astype(int), _BINS - 1)
    error = sum(
        np.sum(which == b) / len(p) * abs(p[which == b].mean() - right[which == b].mean())
        for b in np.unique(which)
    )
    return Row(name, float(error), len(p), most=0.05)


def removed_gap(final: Sequence[Sequence[Any]]) -> float | None:
    """Part of the gap above noise that is gone, in the channel that was off most.

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


def by_ratio(cases: Sequence[Case]) -> list[dict[str, Any]]:
    """Right names of single cases by gap over noise."""
    singles = [c for c in cases if c.category == "single"]
    out = []
    for ratio in sorted({c.ratio for c in singles}):
        some = [c for c in singles if c.ratio == ratio]
        out.append({"ratio": ratio, "n": len(some)} | _counts(some))
    return out


def by_kind(cases: Sequence[Case]) -> list[dict[str, Any]]:
    """Single cases of every kind: right of all by gap, and the least gap named right."""
    singles = [c for c in cases if c.category == "single"]
    out = []
    for kind in sorted({c.true[0][0] for c in singles}):
        some = [c for c in singles if c.true[0][0] == kind]
        seen = [c.label["effects"][0]["reached"] for c in some if c.right]
        ratios = sorted({c.ratio for c in some})
        out.append(
            {
                "kind": kind,
                "right": {
                    f"{r:g}": [sum(c.right for c in some if c.ratio == r),
                               sum(c.ratio == r for c in some)]
                    for r in ratios
                },
                "least": min(seen, default=None),
            }
        )  # fmt: skip
    return out


def _counts(some: Sequence[Case]) -> dict[str, int]:
    tests: dict[str, Callable[[Case], bool]] = {
        "right": lambda c: c.right,
        "in class": lambda c: c.right or c.in_class,
        "nothing": lambda c: c.verdict in _QUIET,
        "unknown": lambda c: c.verdict == UNKNOWN,
    }
    return {name: sum(map(test, some)) for name, test in tests.items()}


def column(case: Case) -> str:
    """Under what an answer to a case without pairs is counted."""
    if case.verdict in _QUIET:
        return NOTHING_COLUMN
    if not case.effects:
        return UNKNOWN_COLUMN if case.verdict == UNKNOWN else case.verdict
    if case.verdict == ONE_OF:
        return AMBIGUOUS_COLUMN
    kinds = [k for k, _ in case.given]
    true = [k for k, _ in case.true if k in kinds]
    return (true or kinds)[0]


def confusion(cases: Sequence[Case], least: float = VISIBLE) -> dict[str, dict[str, int]]:
    """True kind -> what was answered -> cases; all but pairs and gaps below `least`."""
    out: dict[str, dict[str, int]] = {}
    for c in cases:
        if c.category == "pair" or (c.category == "single" and c.ratio < least):
            continue
        kind = c.true[0][0] if c.true else NOTHING_COLUMN
        row = out.setdefault(kind if c.category != "weak" else f"{kind} (weak)", {})
        row[column(c)] = row.get(column(c), 0) + 1
    return {k: dict(sorted(out[k].items())) for k in sorted(out)}


def fine(case: Case) -> bool:
    """Whether an answer is what the table wants of its case."""
    if case.category == "null":
        return case.verdict in _QUIET
    if case.category == "outside":
        return case.verdict == UNKNOWN
    if case.category == "weak":
        return case.verdict == WEAK
    return case.right


def missed(case: Case) -> dict[str, Any]:
    """A case that was not answered as wanted."""
    return {
        "index": case.label["index"],
        "category": case.category,
        "true": [
            {"kind": k, "slot": s, "gap": e["reached"]}
            for (k, s), e in zip(case.true, case.label["effects"], strict=True)
        ],
        "verdict": case.verdict,
        "given": [{"kind": k, "slot": s} for k, s in case.given],
        "in_class": case.category == "single" and case.in_class,
    }
