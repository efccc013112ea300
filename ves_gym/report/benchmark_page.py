"""Scores as Markdown: each quantity beside its target, and what was missed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ves_gym.diagnosis.benchmark.run import thresholds_hash
from ves_gym.diagnosis.benchmark.score import OWN
from ves_gym.diagnosis.inference.model_selection import Thresholds

Plain = Mapping[str, Any]


def markdown(result: Plain) -> str:
    """Return the page of a benchmark's result."""
    ours = result["score"]["methods"][OWN]
    parts = [_head(result), _targets(result["score"]["methods"]), _curve(ours), _kinds(ours)]
    parts += [_confusion(ours["confusion"]), _missed(result["score"])]
    return "\n\n".join(p for p in parts if p) + "\n"


def _head(result: Plain) -> str:
    counts = ", ".join(f"{n} {k}" for k, n in result["score"]["cases"].items())
    text = [
        "# Blind benchmark of `ves-gym diagnose`",
        f"Set `{result['set']}`, {len(result['cases'])} cases: {counts}. Answers under"
        f" thresholds `{result['thresholds'][:12]}`, ves-gym {result['version']}.",
        f"```sh\n{result['command']}\n```",
    ]
    now = thresholds_hash(Thresholds())
    if now != result["thresholds"]:
        text.append(
            f"**These are not the answers of this version**: its thresholds are `{now[:12]}`,"
            " changed after the set was answered. A sealed set is answered once, so what the"
            " change does to these figures has not been measured."
        )
    if result["seal"] is not None:
        text.append(
            f"SHA-256 of the sealed labels, written before any diagnosis:"
            f" `{result['seal']['digest']}`; nonce `{result['seal']['nonce']}`."
        )
    failed = result["score"]["failed"]
    if failed:
        numbers = ", ".join(map(str, failed))
        text.append(
            f"The diagnosis failed on {len(failed)} cases, counted as wrong: {numbers}."
        )
    return "\n\n".join(text)


def _targets(methods: Mapping[str, Plain]) -> str:
    others = [k for k in methods if k != OWN]
    by_name = {k: {r["name"]: r for r in methods[k]["rows"]} for k in others}
    head = ["quantity", "result", "95 % bounds", "n", "target", "met", *others]
    lines = []
    for r in methods[OWN]["rows"]:
        low = "" if r["low"] is None else f"{_value(r['low'], r)} to {_value(r['high'], r)}"
        met = {True: "yes", False: "**no**", None: ""}[r["met"]]
        beside = [
            _value(by_name[k][r["name"]]["value"], r) if r["name"] in by_name[k] else ""
            for k in others
        ]
        cells = [r["name"], _value(r["value"], r), low, str(r["n"]), _target(r), met]
        lines.append([*cells, *beside])
    wrong = [r["name"] for r in methods[OWN]["rows"] if r["met"] is False]
    summary = f"Not met: {'; '.join(wrong)}." if wrong else "No target is missed."
    return (
        "## Targets\n\n" + _table(head, lines) + "\n\nBounds are one-sided (Clopper-Pearson)."
        " Baselines, on the same residuals: forward selection by the plain Bayesian information"
        " criterion, without and with the description's tolerances fitted along, and always the"
        f" one candidate of least error. {summary}"
    )


def _value(value: float | None, row: Plain) -> str:
    if value is None:
        return "no case"
    return f"{value:.1f} s" if row["unit"] == "s" else f"{100 * value:.1f} %"


def _target(row: Plain) -> str:
    least, most = row["least"], row["most"]
    if least is not None and most is not None:
        return f"{_value(least, row)} to {_value(most, row)}"
    if least is not None:
        return f">= {_value(least, row)}"
    return f"<= {_value(most, row)}" if most is not None else ""


def _curve(ours: Plain) -> str:
    if not ours["by_ratio"]:
        return ""
    head = ["gap / noise", "cases", "right", "in class", "nothing", "unknown"]
    lines = [
        [f"{r['ratio']:g}", *(str(r[k]) for k in ("n", *head[2:]))] for r in ours["by_ratio"]
    ]
    return "## Single effects by size\n\n" + _table(head, lines)


def _kinds(ours: Plain) -> str:
    if not ours["by_kind"]:
        return ""
    ratios = sorted({r for k in ours["by_kind"] for r in k["right"]}, key=float)
    head = ["effect", *(f"{r}x" for r in ratios), "least gap named right"]
    lines = [
        [
            k["kind"],
            *("/".join(map(str, k["right"][r])) if r in k["right"] else "" for r in ratios),
            "none" if k["least"] is None else f"{k['least']:.1f}",
        ]
        for k in ours["by_kind"]
    ]
    return "## Single effects, right of all\n\n" + _table(head, lines)


def _confusion(rows: Mapping[str, Mapping[str, int]]) -> str:
    """One line per true kind; its columns in words, because most of a full matrix is zero."""
    if not rows:
        return ""
    extra = ("nothing", "unknown", "ambiguous")
    head = ["true", "right kind", *extra, "taken for"]
    lines = []
    for kind, row in rows.items():
        bare = kind.removesuffix(" (weak)")
        mistaken = {k: n for k, n in row.items() if k != bare and k not in extra}
        correct = str(row.get(bare, 0)) if bare != "nothing" else ""
        taken = ", ".join(f"{k} ({n})" for k, n in mistaken.items())
        lines.append([kind, correct, *(str(row.get(k, 0)) for k in extra), taken])
    return (
        "## Confusion\n\nSingle effects of 3 times the noise and more, and cases with none, or"
        " none of the library.\n\n" + _table(head, lines)
    )


def _missed(score: Plain) -> str:
    if not score["missed"]:
        return "## Missed\n\nNothing."
    head = ["case", "category", "truth (gap / noise)", "verdict", "named"]
    lines = []
    for m in score["missed"]:
        true = " + ".join(f"{_name(t)} ({t['gap']:.1f})" for t in m["true"])
        named = " + ".join(map(_name, m["given"])) + (" (in class)" if m["in_class"] else "")
        lines.append([str(m["index"]), m["category"], true, m["verdict"], named])
    return "## Missed\n\n" + _table(head, lines)


def _name(name: Plain) -> str:
    return f"{name['kind']} {name['slot']}".strip()


def _table(head: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    rows = [head, ["---"] * len(head), *lines]
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)
