"""A diagnosis as one HTML file: no server, no network, no script, pictures inside."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

from ves_gym._util.params import ParameterError, write_text
from ves_gym.report.diagnosis_figures import (
    LABELLED,
    likeness_figure,
    overlay_figure,
    when_figure,
    where_figure,
)
from ves_gym.report.diagnosis_markup import (
    STYLE,
    escaped,
    interval_text,
    picture,
    probability_text,
    range_text,
    share_text,
    table,
    unit_text,
    value_text,
)
from ves_gym.report.pages import part
from ves_gym.report.planner_styles import css

SCHEMA = "ves-diagnose/1"
Result = dict[str, Any]

_VISIBLE = 0.05  # standard deviations
_LEAST = 1e-4  # p below which it is not told apart
_ROUND = 100.0  # gain above which tenths do not matter
_SEEN = 0.001  # probability from which a hypothesis is listed


def write_page(result: Result, path: str | os.PathLike[str]) -> None:
    """Write the report of a diagnosis, completely or not at all.

    Args:
        result: what `ves-gym diagnose` writes as JSON, with `overlays`
            (`diagnosis_overlays.overlays`) and `diff` (text) where there are any.

    Raises:
        ParameterError: another schema, or matplotlib is not installed.
    """
    write_text(path, render_page(result))


def render_page(result: Result) -> str:
    """The text of the page."""
    if result.get("schema") != SCHEMA:
        raise ParameterError(f"result.schema must be {SCHEMA!r}, got {result.get('schema')!r}")
    sections = (
        ("What is missing", _missing(result)),
        ("Where", _where(result)),
        ("When", _when(result)),
        ("Before and after", _overlays(result)),
        ("Candidates", _candidates(result)),
        ("What these runs can tell apart", _confusable(result)),
        ("Gap and noise floor", _gaps(result)),
        ("The whole loop, left to itself", _free(result)),
        ("Not tested", _untested(result)),
        ("Change of the description", _change(result)),
        ("How this was found", _provenance(result)),
    )
    body = "\n".join(
        f"<section><h2>{title}</h2>\n{content}</section>" for title, content in sections
    )
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<meta http-equiv="Content-Security-Policy"
  content="default-src 'none'; style-src 'unsafe-inline'; img-src data:">
<title>{escaped(f"Diagnosis: {result['verdict']}")}</title>
<style>
{css()}{part("page.css")}{STYLE}</style>
</head>
<body>
<header class="top">
<p class="eyebrow">{escaped(_eyebrow(result))}</p>
<h1>Where do data and description disagree, and what is missing?</h1>
<p class="verdict">{escaped(result["sentence"])}</p>
<p class="note">{escaped(result["null"]["sentence"])} {escaped(_hypotheses(result))}</p>
</header>
<main>
{_tiles(result)}
{body}
</main>
<footer><p class="note">{escaped(_signature(result))}</p></footer>
</body>
</html>
"""


# --------------------------------------------------------------------------- sections


def _eyebrow(result: Result) -> str:
    held_back = result["held_back"]
    count = len(result["logs"])
    logs = (
        f"{count} log{'s' if count != 1 else ''}, {len(held_back)} of them held back to the end"
    )
    return f"ves-gym diagnose: {result.get('machine', 'machine')}; {logs}"


def _tiles(result: Result) -> str:
    tiles = []
    for effect in result["effects"]:
        rivals = effect["class"]
        big = f"one of {len(rivals)}" if len(rivals) > 1 else share_text(effect["probability"])
        small = "; ".join(rivals) if len(rivals) > 1 else "probability of this kind"
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
    text = "".join(
        f'<div class="tile" style="--colour: var(--s{1 + k % 6})">'
        f'<div class="who">{escaped(who)}</div><div class="big">{escaped(big)}</div>'
        f'<div class="detail">{escaped(detail)}</div></div>'
        for k, (who, big, detail) in enumerate(tiles)
    )
    return f'<div class="tiles">{text}</div>'


def _missing(result: Result) -> str:
    effects, withheld = result["effects"] or result["closest"], _withheld(result)
    if not effects:
        return f"<p>{_NO_EFFECT[_has_name(result)]}</p>" + withheld + _designed(result)
    named, rows = _has_name(result), []
    for effect in effects:
        for k, (name, value) in enumerate(effect["value"].items()):
            rows.append(
                [
                    effect["name"] if k == 0 else "",
                    name,
                    f"{value:.5g}",
                    interval_text(effect["interval"][name]),
                    unit_text(effect["unit"][name]),
                    probability_text(effect["probability"]) if named and k == 0 else "",
                ]
            )
    head = ("effect", "number", "value", "90 % interval", "unit", "probability")
    return ("" if named else f"<p>{_NO_NAME}</p>") + (
        table(head, rows, numbers=(2, 3, 5))
        + '<p class="note">Intervals are of the fit with tolerances carried along. The'
        " probability is that of the kind among everything that could stand in its place, times"
        " how often a name with such evidence is right.</p>"
        + "".join(
            f"<p><b>Next experiment.</b> {escaped(k)}</p>" for k in _next_experiments(result)
        )
        + withheld
        + _designed(result)
    )


def _withheld(result: Result) -> str:
    """Names that are not given, and how often such names are right."""
    told = ", ".join(
        f"{escaped(k['name'])} ({100 * k['reliability']:.0f} %)" for k in result["withheld"]
    )
    if not told:
        return ""
    return (
        '<p class="note">Withheld, since of names with such evidence most are wrong (share that'
        f" is right): {told}.</p>"
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


def _next_experiments(result: Result) -> list[str]:
    """Sentences that say which measurements tell rivals apart."""
    return [e["sentence"] for e in result["experiments"]] if result["effects"] else []


_NO_EFFECT = {
    True: "Nothing of the library is needed to explain these runs.",
    False: "Nothing of the library explains the gap.",
}
_NO_NAME = (
    "No name is given. The numbers below are the best that the library can do; they leave most"
    " of the gap, so they stand for something else and are not to be believed."
)


def _where(result: Result) -> str:
    return picture(
        where_figure(result["where"], bool(result["effects"])),
        "map of the mean square residual by channel and frequency, before and after",
        "Mean square of the residual of each port in units of the noise there, on the runs that"
        " were fitted: 1 (white) is noise. Tolerances of the description are taken off in both."
        " Each port is a part of the machine run alone on its measured input, so a gap shows"
        " where it arises.",
    )


def _when(result: Result) -> str:
    return picture(
        when_figure(result["when"], bool(result["effects"])),
        "map of the mean square residual by channel and elapsed time",
        "Mean square of the residual over the time elapsed, stretch by stretch, run after run,"
        " in units of noise: what drifts grows, what belongs to a motion comes with it. The"
        " channels that show most; tolerances taken off.",
    )


def _overlays(result: Result) -> str:
    if not result.get("overlays"):
        return "<p>No channel to show.</p>"
    better = bool(result["effects"])
    return picture(
        overlay_figure(result["overlays"], better),
        "residuals of two channels over time, and their spectra",
        f"{_OVERLAY_CHANNELS[better]}, each in the run that shows it most. Left: residual up to"
        f" the frequency at which the gap ends, as {_LEFT_BY[better]} it. Right: in standard"
        " deviations of noise (dotted: 1), tolerances taken off.",
    )


_OVERLAY_CHANNELS = {
    True: "The channel in which the gap falls most and, of the others, that with the largest",
    False: "The channels with the largest gap",
}
_LEFT_BY = {
    True: "the description and the one with the effects above leave",
    False: "the description leaves",
}


def _hypotheses(result: Result) -> str:
    """Probabilities of nothing, of members of the library and of none of these."""
    shown = [
        f"{k} {probability_text(p)}" for k, p in result["hypotheses"].items() if p >= _SEEN
    ]
    return f"Probabilities: {', '.join(shown)}."


def _candidates(result: Result) -> str:
    rows, marks = [], []
    for r in result["ranking"]:
        digits = 0 if abs(r["gain"]) > _ROUND else 1
        gain = f"{r['gain']:.{digits}f}"
        if r["gain_error"] is not None:
            gain += f" ± {r['gain_error']:.{digits}f}"
        marks.append("chosen" if r["chosen"] else "")
        rows.append(
            [
                r["name"],
                ", ".join(value_text(k, v, r["unit"][k]) for k, v in r["value"].items()),
                "low" if r["screen"] is None else f"{r['screen']:.{digits}f}",
                gain,
                f"< {_LEAST:g}" if r["p"] < _LEAST else f"{r['p']:.2g}",
                "" if r["probability"] is None else probability_text(r["probability"]),
            ]
        )
    head = ("candidate", "numbers", "score", "gain ± SE", "p", "probability")
    steps = "".join(f"<li>{escaped(step)}</li>" for step in result["steps"])
    return (
        table(head, rows, numbers=(2, 3, 4, 5), wrap=(1,), marks=marks)
        + '<p class="note">Each alone on the residual of the description, ranked by a linear'
        " score less what the numbers cost. Gain is the fall in deviance: by the linear score,"
        " and by the model itself with these numbers, where much less or less than nothing"
        " means that the score does not hold. The standard error is from run to run; p is the"
        " chance that the best of the whole library gains as much from noise. The probability"
        " is of the full fits, among all that could stand in the same place; empty where a"
        " candidate was not among those. <strong>Bold</strong>: in the answer.</p>"
        + (f"<p>Taken one by one, in full fits:</p><ol>{steps}</ol>" if steps else "")
    )


def _confusable(result: Result) -> str:
    text = "".join(f"<p>{escaped(e['sentence'])}</p>" for e in result["experiments"])
    for e in result["experiments"]:
        rows = [
            [a["where"], f"{a['likeness']:.3f}", f"{a['sigma']:.1f}"]
            for a in (*e["runs"], *(p for p in e["ports"] if p["sigma"] >= _VISIBLE))
        ]
        head = ("run or port", "likeness", "apart [standard deviations]")
        caption = f"{e['between'][0]} imitated by {e['between'][1]}"
        text += table(head, rows, numbers=(1, 2), caption=caption, kind="narrow")
    alike = result["likeness"]["classes"]
    if alike:
        text += "<p>Not to be told apart on these runs:</p><ul>"
        text += "".join(f"<li>{escaped(', '.join(names))}</li>" for names in alike) + "</ul>"
    elif result["likeness"]["names"]:
        text += "<p>No two of the candidates that do best are alike on these runs.</p>"
    if not result["likeness"]["names"]:
        return text or "<p>No candidate.</p>"
    return text + picture(
        likeness_figure(result["likeness"]),
        "matrix of the likeness of candidates",
        "How well the candidate of a column imitates that of a row at its usual size: the"
        " cosine between signatures, tolerances taken out. It does not depend on the residual."
        " One class where both imitate each other better than 0.95.",
        "narrow",
    )


def _gaps(result: Result) -> str:
    before, after, on_held_back = _chosen_gaps(result)
    sure = result["final_intervals" if on_held_back else "gap_intervals"]
    rows = [
        [
            *name.split("/", 1),
            f"{before[name]:.2f} ({range_text(sure[name]['before'])})",
            f"{after[name]:.2f} ({range_text(sure[name]['after'])})",
            _removed(before[name], after[name]),
        ]
        for name in sorted(before, key=lambda k: -before[k])
    ]
    where = "that were fitted"
    if on_held_back:
        where = f"held back ({', '.join(result['held_back'])}), which nothing before had seen"
    within = "within" if result["remaining"] <= result["remaining_allowed"] else "more than"
    head = ("port", "channel", "before", "after", "of the gap above noise removed")
    return (
        "<p>Root mean square in standard deviations of noise (noise alone: 1), on the runs"
        f" {escaped(where)}. What no name explains is worth {result['remaining']:.0f} in"
        f" deviance on the runs that were fitted: {within} the"
        f" {result['remaining_allowed']:.0f} of a good description. In brackets: 95 %"
        " intervals from a bootstrap over stretches of a"
        f" second.</p><p>{escaped(_worse_channels(result))}</p>"
        + table(head, rows, numbers=(2, 3, 4), kind="narrow")
    )


def _worse_channels(result: Result) -> str:
    """The harm that the added effects do elsewhere, in a sentence."""
    if not result["effects"]:
        return "Nothing is added to the description."
    if not result["worse"]:
        return "No channel is worse by more than 2 % of its gap, or of noise."
    sure = result["final_intervals"] or result["gap_intervals"]
    ratios = (f"{k} (after / before: {range_text(sure[k]['ratio'])})" for k in result["worse"])
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
    return (
        "<p>Measured less simulated, root mean square up to the band, when the loop as a whole"
        " is simulated from the log's start state with the references logged, no measured"
        f" signal fed in: {escaped(', '.join(free['runs']))}. A controller hides here what the"
        " ports show. The file written, read back, plays the same within"
        f" {max(free['difference'], result['replay_difference']):.0e}.</p>"
        + table(("channel", "unit", "before", "after", "noise"), rows, numbers=(2, 3, 4),
                 kind="narrow")
    )  # fmt: skip


def _untested(result: Result) -> str:
    lines = [
        f"port {port}: the logs lack {', '.join(lacks)}"
        for port, lacks in result["untestable"].items()
    ]
    lines += [f"{name}: the runs move too little to show it" for name in result["weak"]]
    lines += [f"held back, so opened last: {text}" for text in result.get("doubts", ())]
    if not lines:
        return (
            "<p>All ports could be tested, and the runs move enough to show what joints do.</p>"
        )
    return "<ul>" + "".join(f"<li>{escaped(text)}</li>" for text in lines) + "</ul>"


def _change(result: Result) -> str:
    diff = result.get("diff", "")
    if not diff:
        return "<p>None: the description stays as it is.</p>"
    tags: dict[str, Callable[[str], str]] = {
        "+": lambda text: f"<ins>{text}</ins>",
        "-": lambda text: f"<del>{text}</del>",
    }
    lines = [tags.get(text[:1], lambda text: text)(escaped(text)) for text in diff.splitlines()]
    notes = "".join(f"<li>{escaped(note)}</li>" for note in result.get("notes", ()))
    return (
        "<p>Read back and played again at every port, it leaves the same residuals within"
        f" {result['replay_difference']:.0e} of a channel's size.</p>"
        + (f"<ul>{notes}</ul>" if notes else "")
        + f"<pre>{chr(10).join(lines)}</pre>"
    )


def _provenance(result: Result) -> str:
    rows = [
        ["ves-gym", result.get("version", "")],
        ["command", result.get("command", "")],
        ["seed of the noise draws", str(result["seed"])],
        ["description (SHA-256)", result["described"]],
        ["better description (SHA-256)", result.get("better", "")],
        *(
            [f"{name}{' (held back)' if name in result['held_back'] else ''}", digest]
            for name, digest in result["logs"].items()
        ),
        *([f"time to {name} [s]", f"{s:.1f}"] for name, s in result["seconds"].items()),
        ["time in all [s]", f"{sum(result['seconds'].values()):.1f}"],
    ]
    return table(("what", "value"), [row for row in rows if row[1]], wrap=(1,))


def _signature(result: Result) -> str:
    return f"{result['schema']}; the same numbers stand in diagnosis.json beside this page."


# ----------------------------------------------------------------------- what they share


def _has_name(result: Result) -> bool:
    """True if the effects in the answer are meant as names of what is missing."""
    return bool(result["verdict"] != "not in the library")


def _chosen_gaps(result: Result) -> tuple[dict[str, float], dict[str, float], bool]:
    """Gaps before and after, of the runs held back where there are any."""
    on_held_back = bool(result["final_before"])
    key = "final" if on_held_back else "gap"
    return result[f"{key}_before"], result[f"{key}_after"], on_held_back


def _removed(before: float, after: float) -> str:
    """Share of what is above noise; nothing to say where hardly anything is."""
    above = before**2 - 1
    return "" if above < LABELLED - 1 else f"{1 - max(after**2 - 1, 0) / above:.1%}"
