"""A diagnosis as one HTML file without a script, pictures inside, and as text."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from ves_gym._util.params import write_text
from ves_gym._util.tables import table
from ves_gym.diagnosis.diagnose import ONE_OF, UNKNOWN, WIDE, Diagnosis
from ves_gym.report.diagnosis_figures import (
    LABELLED,
    likeness_figure,
    overlay_figure,
    when_figure,
    where_figure,
)
from ves_gym.report.figures import png_address
from ves_gym.report.pages import escaped, html_table, page, require_schema

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SCHEMA = "ves-diagnose/1"
Result = Mapping[str, Any]

_CHANNELS = 12  # in the table of the text
_VISIBLE = 0.05  # standard deviations
_LEAST = 1e-4  # p below which it is not a number
_ROUND = 100.0  # gain above which tenths do not matter
_LIKELY = 0.001  # probability from which the page lists a hypothesis; the text: 0.005


def write_page(result: Result, path: str | os.PathLike[str]) -> None:
    """Write the report of a diagnosis, completely or not at all: what `ves-gym diagnose` writes
    as JSON, with `overlays` (`diagnosis_figures.overlays`) and `diff` (text) where there are
    any."""
    write_text(path, render_page(result))


def render_page(result: Result) -> str:
    """The text of the page."""
    require_schema(result, SCHEMA)
    better, count = bool(result["effects"]), len(result["logs"])
    shares = ", ".join(
        f"{k} {_probability(p)}" for k, p in result["hypotheses"].items() if p >= _LIKELY
    )
    return page(
        "report/diagnosis.html",
        title=f"Diagnosis: {result['verdict']}",
        styles=("report/diagnosis.css",),
        eyebrow=escaped(
            f"ves-gym diagnose: {result['machine']}; {count} log{'s' * (count != 1)},"
            f" {len(result['held_back'])} of them held back to the end"
        ),
        sentence=escaped(result["sentence"]),
        null=escaped(result["null"]["sentence"]),
        hypotheses=escaped(f"Probabilities: {shares}."),
        tiles=_tiles(result),
        missing=_missing(result),
        where=png_address(where_figure(result["where"], better)),
        when=png_address(when_figure(result["when"], better)),
        overlays=_overlays(result),
        candidates=_candidates(result),
        steps=_list(result["steps"], "<p>Taken one by one, in full fits:</p>", "ol"),
        confusable=_confusable(result),
        worse=escaped(_worse_channels(result)),
        free=_free(result),
        untested=_untested(result),
        change=_change(result),
        provenance=_provenance(result),
        schema=escaped(result["schema"]),
        **_gaps(result),
    )


# --------------------------------------------------------------------------- sections


def _tiles(result: Result) -> str:
    tiles = []
    for effect in result["effects"]:
        rivals, p = effect["class"], effect["probability"]
        big, small = "> 99 %" if p > 0.99 else f"{100 * p:.0f} %", "probability of this kind"
        if len(rivals) > 1:
            big, small = f"one of {len(rivals)}", "; ".join(rivals)
        tiles.append((effect["name"], big, small))
    before, after, _ = _chosen_gaps(result)
    if before:
        worst = max(before, key=lambda k: before[k])
        low = f" to {after[worst]:.2f}" if result["effects"] else ""
        tiles.append(
            (
                f"largest gap: {worst}",
                f"{before[worst]:.3g}{low}",
                "standard deviations of noise",
            )
        )
    return "".join(
        f'<div class="tile" style="--colour: var(--s{1 + k % 6})">'
        f'<div class="who">{escaped(who)}</div><div class="big">{escaped(big)}</div>'
        f'<div class="detail">{escaped(detail)}</div></div>'
        for k, (who, big, detail) in enumerate(tiles)
    )


def _missing(result: Result) -> str:
    effects, end = result["effects"] or result["closest"], _designed(result)
    named, rows = result["verdict"] != UNKNOWN, []
    if not effects:
        return f"<p>{_NO_EFFECT[named]}</p>{end}"
    for effect in effects:
        for k, (name, value) in enumerate(effect["value"].items()):
            ends = effect["interval"][name]
            rows.append(
                [
                    effect["name"] if k == 0 else "",
                    name,
                    f"{value:.5g}",
                    "not known" if ends is None else f"{ends[0]:.5g} to {ends[1]:.5g}",
                    _unit(effect["unit"][name]),
                    _probability(effect["probability"]) if named and k == 0 else "",
                ]
            )
    head = ("effect", "number", "value", "90 % interval", "unit", "probability")
    experiments = "".join(
        f"<p><b>Next experiment.</b> {escaped(e['sentence'])}</p>"
        for e in (result["experiments"] if result["effects"] else ())
    )
    return (
        ("" if named else f"<p>{_NO_NAME}</p>")
        + html_table(head, rows, numbers=(2, 3, 5))
        + f'<p class="note">{_INTERVALS}</p>{experiments}{end}'
    )


_NO_EFFECT = {
    True: "Nothing of the library is needed to explain these runs.",
    False: "Nothing of the library explains the gap.",
}
_NO_NAME = (
    "No name is given. The numbers below are the best that the library can do; they leave most"
    " of the gap, so they stand for something else and are not to be believed."
)
_INTERVALS = (
    "Intervals are of the fit with tolerances carried along. The probability is that of the"
    " kind among everything that could stand in its place, and of the name being there at all."
)


def _designed(result: Result) -> str:
    """Return the motion designed, what it separates and the commands that run it."""
    design = result.get("next_motion")
    if not design:
        return ""
    shares = ", ".join(f"{k} {100 * x:.0f} %" for k, x in design["limits"].items())
    return (
        f"<p><b>Designed experiment.</b> {escaped(design['sentence'])} Of its limits it takes,"
        f" as simulated: {escaped(shares)}. The motion is in"
        f" {escaped(', '.join(design['files']))}; in simulation"
        f" <code>{escaped(design['simulate'])}</code>, afterwards"
        f" <code>{escaped(design['diagnose'])}</code>.</p>"
    )


def _overlays(result: Result) -> str:
    if not result.get("overlays"):
        return "<p>No channel to show.</p>"
    return _figure(
        overlay_figure(result["overlays"], bool(result["effects"])),
        "residuals of two channels over time, and their spectra",
        "The channel in which the gap falls most, where effects are added, and that with the"
        " largest, each in the run that shows it most. Left: residual up to the frequency at"
        " which the gap ends, of the description and of that with the effects above. Right: in"
        " standard deviations of noise (dotted: 1), tolerances taken off.",
    )


def _candidates(result: Result) -> str:
    rows = []
    for r in result["ranking"]:
        digits = 0 if abs(r["gain"]) > _ROUND else 1
        gain = f"{r['gain']:.{digits}f}"
        if r["gain_error"] is not None:
            gain += f" ± {r['gain_error']:.{digits}f}"
        rows.append(
            [
                r["name"],
                ", ".join(
                    f"{k} {v:.3g} {_unit(r['unit'][k])}".rstrip() for k, v in r["value"].items()
                ),
                "low" if r["screen"] is None else f"{r['screen']:.{digits}f}",
                gain,
                f"< {_LEAST:g}" if r["p"] < _LEAST else f"{r['p']:.2g}",
                "" if r["probability"] is None else _probability(r["probability"]),
            ]
        )
    head = ("candidate", "numbers", "score", "gain ± SE", "p", "probability")
    chosen = [r["chosen"] for r in result["ranking"]]
    return html_table(head, rows, numbers=(2, 3, 4, 5), wrap=(1,), bold=chosen)


def _confusable(result: Result) -> str:
    text = "".join(f"<p>{escaped(e['sentence'])}</p>" for e in result["experiments"])
    for e in result["experiments"]:
        rows = [
            [a["where"], f"{a['likeness']:.3f}", f"{a['sigma']:.1f}"]
            for a in (*e["runs"], *(p for p in e["ports"] if p["sigma"] >= _VISIBLE))
        ]
        head = ("run or port", "likeness", "apart [standard deviations]")
        caption = f"{e['between'][0]} imitated by {e['between'][1]}"
        text += html_table(head, rows, numbers=(1, 2), caption=caption, kind="narrow")
    alike = [", ".join(names) for names in result["likeness"]["classes"]]
    text += _list(alike, "<p>These runs do not separate:</p>")
    if not result["likeness"]["names"]:
        return text or "<p>No candidate.</p>"
    if not alike:
        text += "<p>No two of the candidates that do best are alike on these runs.</p>"
    return text + _figure(
        likeness_figure(result["likeness"]),
        "matrix of the likeness of candidates",
        "How well the candidate of a column imitates that of a row at its usual size: the"
        " cosine between signatures, tolerances taken out. It does not depend on the residual."
        " One class where both imitate each other better than 0.95.",
        "narrow",
    )


def _gaps(result: Result) -> dict[str, str]:
    before, after, on_held_back = _chosen_gaps(result)
    sure = result["final_intervals" if on_held_back else "gap_intervals"]
    rows = [
        [
            *name.split("/", 1),
            f"{before[name]:.2f} ({_range(sure[name]['before'])})",
            f"{after[name]:.2f} ({_range(sure[name]['after'])})",
            _removed(before[name], after[name]),
        ]
        for name in sorted(before, key=lambda k: -before[k])
    ]
    runs = "that were fitted"
    if on_held_back:
        runs = f"held back ({', '.join(result['held_back'])}), which nothing before had used"
    within = "within" if result["remaining"] <= result["remaining_allowed"] else "more than"
    head = ("port", "channel", "before", "after", "of the gap above noise removed")
    return {
        "runs": escaped(runs),
        "remaining": f"{result['remaining']:.0f} in deviance beyond twice the noise stated:"
        f" {within} the {result['remaining_allowed']:.0f}",
        "gaps": html_table(head, rows, numbers=(2, 3, 4), kind="narrow"),
    }


def _worse_channels(result: Result) -> str:
    """The harm that the added effects do elsewhere, in a sentence."""
    if not result["effects"]:
        return "Nothing is added to the description."
    if not result["worse"]:
        return "No channel is worse by more than 2 % of its gap, or of noise."
    sure = result["final_intervals"] or result["gap_intervals"]
    ratios = (f"{k} (after / before: {_range(sure[k]['ratio'])})" for k in result["worse"])
    return f"Worse by more than 2 %: {', '.join(ratios)}."


def _free(result: Result) -> str:
    free = result.get("free")
    if free is None:
        return "<p>Not simulated.</p>"
    if not free["gaps"]:
        return f"<p>Not simulated: {escaped(free['why_not'])}.</p>"
    rows = [
        [g["channel"], g["unit"], *(f"{g[k]:.3g}" for k in ("before", "after", "noise"))]
        for g in free["gaps"]
    ]
    head = ("channel", "unit", "before", "after", "noise")
    return (
        "<p>Measured less simulated, root mean square up to the band, when the loop as a whole"
        " is simulated from the log's start state with the references logged, no measured"
        f" signal fed in: {escaped(', '.join(free['runs']))}. A controller hides here what the"
        " ports show. The file written, read back, plays the same within"
        f" {max(free['difference'], result['replay_difference']):.0e}.</p>"
        + html_table(head, rows, numbers=(2, 3, 4), kind="narrow")
    )


def _untested(result: Result) -> str:
    untestable = result["untestable"].items()
    lines = [f"port {port}: the logs lack {', '.join(lacks)}" for port, lacks in untestable]
    lines += [f"{name}: the runs move too little to show it" for name in result["weak"]]
    lines += [f"held back, so opened last: {text}" for text in result.get("doubts", ())]
    return _list(lines) or (
        "<p>All ports could be tested, and the runs move enough to show what joints do.</p>"
    )


def _change(result: Result) -> str:
    diff = result.get("diff", "")
    if not diff:
        return "<p>None: the description stays as it is.</p>"
    forms = {"+": "<ins>{}</ins>", "-": "<del>{}</del>"}
    lines = [forms.get(text[:1], "{}").format(escaped(text)) for text in diff.splitlines()]
    return (
        "<p>Read back and played again at every port, it leaves the same residuals within"
        f" {result['replay_difference']:.0e} of a channel's size.</p>"
        + _list(result.get("notes", ()))
        + f"<pre>{chr(10).join(lines)}</pre>"
    )


def _provenance(result: Result) -> str:
    rows = [
        ["ves-gym", result["version"]],
        ["command", result["command"]],
        ["seed of the noise draws", str(result["seed"])],
        ["description (SHA-256)", result["described"]],
        ["better description (SHA-256)", result["better"]],
        *(
            [f"{name}{' (held back)' if name in result['held_back'] else ''}", digest]
            for name, digest in result["logs"].items()
        ),
        *([f"time to {name} [s]", f"{s:.1f}"] for name, s in result["seconds"].items()),
        ["time in all [s]", f"{sum(result['seconds'].values()):.1f}"],
    ]
    return html_table(("what", "value"), [row for row in rows if row[1]], wrap=(1,))


# ----------------------------------------------------------------------- what they share


def _figure(figure: Figure, words: str, caption: str, kind: str = "") -> str:
    """A picture, with words for whoever does not see it and a caption."""
    return (
        f'<figure class="{kind}"><img alt="{escaped(words)}" src="{png_address(figure)}">'
        f"<figcaption>{caption}</figcaption></figure>\n"
    )


def _list(lines: Iterable[str], title: str = "", tag: str = "ul") -> str:
    items = "".join(f"<li>{escaped(text)}</li>" for text in lines)
    return f"{title}<{tag}>{items}</{tag}>" if items else ""


def _chosen_gaps(result: Result) -> tuple[dict[str, float], dict[str, float], bool]:
    """Gaps before and after, of the runs held back where there are any."""
    on_held_back = bool(result["final_before"])
    key = "final" if on_held_back else "gap"
    return result[f"{key}_before"], result[f"{key}_after"], on_held_back


def _removed(before: float, after: float) -> str:
    """Share of what is above noise; nothing to say where hardly anything is."""
    above = before**2 - 1
    return "" if above < LABELLED - 1 else f"{1 - max(after**2 - 1, 0) / above:.1%}"


def _range(ends: Sequence[float]) -> str:
    return f"{ends[0]:.2f} to {ends[1]:.2f}"


def _probability(p: float) -> str:
    return "> 0.999" if p > 0.999 else "< 0.001" if p < 0.001 else f"{p:.3f}"


def _unit(unit: str) -> str:
    return "" if unit == "1" else unit


# ------------------------------------------------------------------------------- text


def diagnosis_text(diagnosis: Diagnosis, result: Mapping[str, Any]) -> str:
    """Return what `ves-gym diagnose` prints of a verdict and of what it writes as JSON."""
    beliefs = [f"{k} {p:.2f}" for k, p in result["hypotheses"].items() if p >= 5 * _LIKELY]
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
    lines.append(_gap_table(diagnosis, result["held_back"]))
    if result["worse"]:
        lines.append(f"worse by more than 2 %: {', '.join(result['worse'])}")
    lines += [f"held back, so opened last: {question}" for question in result["doubts"]]
    lines += result["notes"]
    for port, lacks in result["untestable"].items():
        lines.append(f"not tested: {port}, the logs lack {', '.join(lacks)}")
    return "\n".join(lines)


def _gap_table(diagnosis: Diagnosis, held_back: list[str]) -> str:
    of = f"held back: {', '.join(held_back)}" if diagnosis.final else "the runs fitted"
    rows = []
    for gap in sorted(diagnosis.final or diagnosis.gaps, key=lambda g: -g.before)[:_CHANNELS]:
        before = f"{gap.before:.2f}", _range(gap.before_interval)
        after = f"{gap.after:.2f}", _range(gap.after_interval)
        rows.append((gap.port, gap.channel, *before, *after))
    title = f"gap in standard deviations of noise, {of}"
    head = ("port", "channel", "before", "95 %", "after", "95 %")
    return table(head, rows, title=title, left=(0, 1), width=110)
