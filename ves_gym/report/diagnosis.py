"""A diagnosis as one HTML file: no server, no network, no script, pictures inside."""

from __future__ import annotations

import base64
import html
import io
import itertools
import os
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ves_gym._util.params import ParameterError, write_text
from ves_gym.report.figures import _DPI, _panels
from ves_gym.report.pages import part
from ves_gym.report.planner_styles import COLOURS, css

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SCHEMA = "ves-diagnose/1"
Result = dict[str, Any]

_BEFORE, _AFTER = COLOURS[1], COLOURS[3]
_MOST = 1e3  # mean square at which the colour of the map ends, if nothing is above it
_LABELLED = 2.0  # mean square from which a cell of the map says its number
_VISIBLE = 0.05  # standard deviations
_LEAST = 1e-4  # p below which it is not told apart
_LINES = 12  # channels in the map over time
_ROUND = 100.0  # gain above which tenths do not matter
_SEEN = 0.001  # probability from which a hypothesis is listed
_STYLE = """
figure { margin: 0 0 1rem; }
figure img { display: block; width: 100%; background: #fff; border: 1px solid var(--line);
  border-radius: .5rem; }
figure.narrow { max-width: 48rem; }
figcaption { color: var(--soft); font-size: .875rem; margin: .4rem 0 0; max-width: 62rem; }
td.wrap { white-space: normal; min-width: 14rem; }
tr.chosen > * { font-weight: 650; }
pre { background: var(--card); border: 1px solid var(--line); border-radius: .5rem;
  padding: .7rem 1rem; overflow: auto; font-size: .82rem; line-height: 1.4;
  max-height: 30rem; }
ins { text-decoration: none; color: color-mix(in srgb, var(--s4) 60%, var(--ink)); }
del { text-decoration: none; color: color-mix(in srgb, var(--s5) 60%, var(--ink)); }
.scroll.narrow { max-width: 48rem; margin-bottom: 1rem; }
footer { padding-bottom: 2rem; }
"""


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
<title>{_text(f"Diagnosis: {result['verdict']}")}</title>
<style>
{css()}{part("page.css")}{_STYLE}</style>
</head>
<body>
<header class="top">
<p class="eyebrow">{_text(_eyebrow(result))}</p>
<h1>Where do data and description disagree, and what is missing?</h1>
<p class="verdict">{_text(result["sentence"])}</p>
<p class="note">{_text(result["null"]["sentence"])} {_text(_hypotheses(result))}</p>
</header>
<main>
{_tiles(result)}
{body}
</main>
<footer><p class="note">{_text(_signature(result))}</p></footer>
</body>
</html>
"""


# ---------------------------------------------------------------------------- figures


def where_figure(where: Sequence[Result], better: bool = True) -> Figure:
    """Draw the mean square of the residual, channels by ranges of frequency.

    Args:
        where: port, channel, range [Hz] and mean square over noise [1] of each cell.
        better: there is an after.

    Returns:
        The figure.
    """
    from matplotlib.colors import LinearSegmentedColormap, LogNorm

    channels = list(dict.fromkeys((g["port"], g["channel"]) for g in where))
    ranges = list(dict.fromkeys((g["low"], g["high"]) for g in where))
    heat = LinearSegmentedColormap.from_list("heat", ("white", "#f7c9a5", _BEFORE, "#4a1500"))
    width = max(11.0, 2.5 + 0.36 * len(channels))
    figure, panels = _panels(1 + better, width, 2.1 if better else 2.6, columns=1)
    top = max([_MOST, *(g["before"] for g in where), *(g["after"] for g in where)])
    for axes, key in zip(panels, ("before", "after"), strict=False):
        size = np.full((len(ranges), len(channels)), np.nan)
        for g in where:
            at = ranges.index((g["low"], g["high"])), channels.index((g["port"], g["channel"]))
            size[at] = g[key]
        image = axes.imshow(
            np.maximum(size, 1.0), cmap=heat, norm=LogNorm(1, top), aspect="auto",
            origin="lower",
        )  # fmt: skip
        for (i, j), v in np.ndenumerate(size):
            if v >= _LABELLED:
                colour = "white" if v > top**0.6 else "black"
                text = f"{v:.1f}" if v < 9.95 else f"{v:.0f}" if v < 1e3 else f"{v:.0e}"
                text = text.replace("e+0", "e")
                axes.text(j, i, text, ha="center", va="center", fontsize=6.5, color=colour)
        axes.set_yticks(range(len(ranges)), [f"{a:.2g} to {b:.2g} Hz" for a, b in ranges])
        axes.set_ylabel(key)
        axes.tick_params(length=0)
        axes.set_xticks(range(len(channels)), [_symbol(c) for _, c in channels])
        starts = [k for k in range(len(channels)) if k and channels[k][0] != channels[k - 1][0]]
        for k in starts:
            axes.axvline(k - 0.5, color="0.3", linewidth=1)
        axes.set_xticks(np.arange(0.5, len(channels)), minor=True)
        axes.set_yticks(np.arange(0.5, len(ranges)), minor=True)
        axes.grid(which="minor", color="0.9", linewidth=0.5)
        axes.tick_params(which="minor", length=0)
    for begin, end in zip([0, *starts], [*starts, len(channels)], strict=True):
        panels[0].text(
            (begin + end - 1) / 2, len(ranges) - 0.4, channels[begin][0], ha="center",
            va="bottom", fontweight="bold", fontsize="small",
        )  # fmt: skip
    figure.colorbar(image, ax=panels, label="mean square / noise", pad=0.01, aspect=30)
    return figure


def when_figure(when: Sequence[Result], better: bool) -> Figure:
    """Draw the mean square of the residual over the time elapsed, the channels that show most.

    Args:
        when: port, channel, run, step [s] and mean squares over noise [1] of each course.
        better: there is an after.

    Returns:
        The figure.
    """
    from matplotlib.colors import LinearSegmentedColormap, LogNorm

    loudest: dict[tuple[str, str], float] = {}
    for course in when:
        key = course["port"], course["channel"]
        loudest[key] = max(loudest.get(key, 0.0), *course["before"], *course["after"])
    channels = sorted(loudest, key=lambda k: -loudest[k])[:_LINES]
    runs = list(dict.fromkeys(course["run"] for course in when))
    heat = LinearSegmentedColormap.from_list("heat", ("white", "#f7c9a5", _BEFORE, "#4a1500"))
    top = max(_MOST, *loudest.values())
    figure, panels = _panels(1 + better, 11.0, 0.8 + 0.2 * len(channels), columns=1)
    for axes, side in zip(panels, ("before", "after"), strict=False):
        rows, ends, steps = [], [0.0], []
        for key in channels:
            by_run = {o["run"]: o for o in when if (o["port"], o["channel"]) == key}
            rows.append(np.concatenate([by_run[run][side] for run in runs]))
        for run in runs:
            course = next(o for o in when if o["run"] == run)
            ends.append(ends[-1] + len(course["before"]))
            steps.append(course["step"])
        image = axes.imshow(
            np.maximum(rows, 1.0), cmap=heat, norm=LogNorm(1, top), aspect="auto",
            interpolation="nearest", extent=(0, ends[-1], len(channels) - 0.5, -0.5),
        )  # fmt: skip
        axes.set_yticks(
            range(len(channels)), [f"{port}, {_symbol(name)}" for port, name in channels]
        )
        axes.set_ylabel(side)
        for end in ends[1:-1]:
            axes.axvline(end, color="0.3", linewidth=1)
        middle = [(a + b) / 2 for a, b in itertools.pairwise(ends)]
        names = [
            f"{run}: {(b - a) * step:.3g} s"
            for run, a, b, step in zip(runs, ends, ends[1:], steps, strict=False)
        ]
        axes.set_xticks(middle, names)
        axes.tick_params(length=0)
    figure.colorbar(image, ax=panels, label="mean square / noise", pad=0.01, aspect=30)
    return figure


def likeness_figure(likeness: Result) -> Figure:
    """Draw the likeness of candidates: of a column's imitation to a row's signature."""
    names, matrix = likeness["names"], np.array(likeness["matrix"])
    n = len(names)
    figure, (axes,) = _panels(1, 3.4 + 0.48 * n, 0.6 + 0.38 * n)
    image = axes.imshow(matrix, cmap="Greys", vmin=0, vmax=1, aspect="auto")
    for (i, j), v in np.ndenumerate(matrix):
        colour = "white" if v > 0.55 else "black"
        axes.text(j, i, f"{v:.2f}", ha="center", va="center", fontsize=7.5, color=colour)
    axes.set_yticks(range(n), [f"{name}  {k + 1}" for k, name in enumerate(names)])
    axes.set_xticks(range(n), [str(k + 1) for k in range(n)])
    axes.tick_params(length=0)
    axes.set_xlabel("imitated by")
    figure.colorbar(image, ax=axes, label="likeness")
    return figure


def overlay_figure(overlays: Sequence[Result], better: bool) -> Figure:
    """Draw residuals over time and their spectra in units of noise.

    Args:
        overlays: channel, t [s], residuals before and after, f [Hz] and spectra of each.
        better: there is an after.

    Returns:
        The figure, two panels per overlay.
    """
    from matplotlib.ticker import LogLocator

    figure, panels = _panels(2 * len(overlays), 6.0, 2.9, columns=2)
    for k, overlay in enumerate(overlays):
        time, spectrum = panels[2 * k : 2 * k + 2]
        for key, colour in (("before", _BEFORE), ("after", _AFTER))[: 1 + better]:
            time.plot(overlay["t"], overlay[key], color=colour, linewidth=0.9, label=key)
            spectrum.plot(
                overlay["f"], overlay[f"noise_{key}"], color=colour, linewidth=1, label=key
            )
        name = f"{overlay['port']}, {_symbol(overlay['channel'])}"
        time.set(xlabel="time [s]", ylabel=f"residual [{overlay['unit']}]")
        time.set_xlim(overlay["t"][0], overlay["t"][-1])
        time.set_title(
            f"{name}: {overlay['run']}, up to {overlay['top']:g} Hz", fontsize="medium"
        )
        spectrum.axhline(1.0, color="0.4", linewidth=0.8, linestyle=":")
        spectrum.set(xlabel="frequency [Hz]", ylabel="residual / noise", yscale="log")
        spectrum.set_ylim(bottom=0.05)
        spectrum.set_xlim(0, overlay["f"][-1])
        spectrum.yaxis.set_major_locator(LogLocator())
        spectrum.yaxis.set_major_formatter("{x:g}")
        spectrum.set_title(f"{name}: spectrum", fontsize="medium")
        for axes in (time, spectrum):
            axes.grid(alpha=0.3)
    _key(panels[0])
    return figure


def _key(axes: Axes) -> None:
    axes.legend(loc="upper right", ncols=2, frameon=False, fontsize="small")


def _symbol(channel: str) -> str:
    """A channel's name as a formula: phi_x -> $\\phi_x$."""
    name, _, index = channel.partition("_")
    greek = rf"\{name}" if name in ("tau", "phi") else name
    return f"${greek}_{{{index}}}$" if index else f"${greek}$"


def _picture(figure: Figure, words: str, caption: str, kind: str = "") -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=_DPI)
    data = base64.b64encode(buffer.getvalue()).decode("ascii")
    css = f' class="{kind}"' if kind else ""
    return (
        f'<figure{css}><img alt="{_text(words)}" src="data:image/png;base64,{data}">'
        f"<figcaption>{caption}</figcaption></figure>\n"
    )


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
        big = f"one of {len(rivals)}" if len(rivals) > 1 else _share(effect["probability"])
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
        f'<div class="who">{_text(who)}</div><div class="big">{_text(big)}</div>'
        f'<div class="detail">{_text(detail)}</div></div>'
        for k, (who, big, detail) in enumerate(tiles)
    )
    return f'<div class="tiles">{text}</div>'


def _missing(result: Result) -> str:
    effects = result["effects"] or result["closest"]
    if not effects:
        return f"<p>{_NO_EFFECT[_has_name(result)]}</p>" + _designed(result)
    named, rows = _has_name(result), []
    for effect in effects:
        for k, (name, value) in enumerate(effect["value"].items()):
            rows.append(
                [
                    effect["name"] if k == 0 else "",
                    name,
                    f"{value:.5g}",
                    _interval(effect["interval"][name]),
                    _unit(effect["unit"][name]),
                    _probability(effect["probability"]) if named and k == 0 else "",
                ]
            )
    head = ("effect", "number", "value", "90 % interval", "unit", "probability")
    return ("" if named else f"<p>{_NO_NAME}</p>") + (
        _table(head, rows, numbers=(2, 3, 5))
        + '<p class="note">Intervals are of the fit with tolerances carried along. The'
        " probability is that of the kind among everything that could stand in its place.</p>"
        + "".join(
            f"<p><b>Next experiment.</b> {_text(k)}</p>" for k in _next_experiments(result)
        )
        + _designed(result)
    )


def _designed(result: Result) -> str:
    """Return the motion designed, what it separates and the commands that run it."""
    design = result.get("next_motion")
    if not design:
        return ""
    shares = ", ".join(f"{k} {100 * x:.0f} %" for k, x in design["limits"].items())
    return (
        f"<p><b>Designed experiment.</b> {_text(design['sentence'])} Of its limits it takes, as"
        f" simulated: {_text(shares)}. The motion is in {_text(', '.join(design['files']))}; in"
        f" simulation <code>{_text(design['simulate'])}</code>, afterwards"
        f" <code>{_text(design['diagnose'])}</code>.</p>"
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
    return _picture(
        where_figure(result["where"], bool(result["effects"])),
        "map of the mean square residual by channel and frequency, before and after",
        "Mean square of the residual of each port in units of the noise there, on the runs that"
        " were fitted: 1 (white) is noise. Tolerances of the description are taken off in both."
        " Each port is a part of the machine run alone on its measured input, so a gap shows"
        " where it arises.",
    )


def _when(result: Result) -> str:
    return _picture(
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
    return _picture(
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
    shown = [f"{k} {_probability(p)}" for k, p in result["hypotheses"].items() if p >= _SEEN]
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
                ", ".join(_value(k, v, r["unit"][k]) for k, v in r["value"].items()),
                "low" if r["screen"] is None else f"{r['screen']:.{digits}f}",
                gain,
                f"< {_LEAST:g}" if r["p"] < _LEAST else f"{r['p']:.2g}",
                "" if r["probability"] is None else _probability(r["probability"]),
            ]
        )
    head = ("candidate", "numbers", "score", "gain ± SE", "p", "probability")
    steps = "".join(f"<li>{_text(step)}</li>" for step in result["steps"])
    return (
        _table(head, rows, numbers=(2, 3, 4, 5), wrap=(1,), marks=marks)
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
    text = "".join(f"<p>{_text(e['sentence'])}</p>" for e in result["experiments"])
    for e in result["experiments"]:
        rows = [
            [a["where"], f"{a['likeness']:.3f}", f"{a['sigma']:.1f}"]
            for a in (*e["runs"], *(p for p in e["ports"] if p["sigma"] >= _VISIBLE))
        ]
        head = ("run or port", "likeness", "apart [standard deviations]")
        caption = f"{e['between'][0]} imitated by {e['between'][1]}"
        text += _table(head, rows, numbers=(1, 2), caption=caption, kind="narrow")
    alike = result["likeness"]["classes"]
    if alike:
        text += "<p>Not to be told apart on these runs:</p><ul>"
        text += "".join(f"<li>{_text(', '.join(names))}</li>" for names in alike) + "</ul>"
    elif result["likeness"]["names"]:
        text += "<p>No two of the candidates that do best are alike on these runs.</p>"
    if not result["likeness"]["names"]:
        return text or "<p>No candidate.</p>"
    return text + _picture(
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
            f"{before[name]:.2f} ({_range(sure[name]['before'])})",
            f"{after[name]:.2f} ({_range(sure[name]['after'])})",
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
        f" {_text(where)}. What no name explains is worth {result['remaining']:.0f} in deviance"
        f" on the runs that were fitted: {within} the {result['remaining_allowed']:.0f} of a"
        " good description. In brackets: 95 % intervals from a bootstrap over stretches of a"
        f" second.</p><p>{_text(_worse_channels(result))}</p>"
        + _table(head, rows, numbers=(2, 3, 4), kind="narrow")
    )


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
        return f"<p>Not simulated: {_text(free['why_not'])}.</p>"
    rows = [
        [g["channel"], g["unit"], *(f"{g[k]:.3g}" for k in ("before", "after", "noise"))]
        for g in free["gaps"]
    ]
    return (
        "<p>Measured less simulated, root mean square up to the band, when the loop as a whole"
        " is simulated from the log's start state with the references logged, no measured"
        f" signal fed in: {_text(', '.join(free['runs']))}. A controller hides here what the"
        " ports show. The file written, read back, plays the same within"
        f" {max(free['difference'], result['replay_difference']):.0e}.</p>"
        + _table(("channel", "unit", "before", "after", "noise"), rows, numbers=(2, 3, 4),
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
    return "<ul>" + "".join(f"<li>{_text(text)}</li>" for text in lines) + "</ul>"


def _change(result: Result) -> str:
    diff = result.get("diff", "")
    if not diff:
        return "<p>None: the description stays as it is.</p>"
    tags: dict[str, Callable[[str], str]] = {
        "+": lambda text: f"<ins>{text}</ins>",
        "-": lambda text: f"<del>{text}</del>",
    }
    lines = [tags.get(text[:1], lambda text: text)(_text(text)) for text in diff.splitlines()]
    notes = "".join(f"<li>{_text(note)}</li>" for note in result.get("notes", ()))
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
    return _table(("what", "value"), [row for row in rows if row[1]], wrap=(1,))


def _signature(result: Result) -> str:
    return f"{result['schema']}; the same numbers stand in diagnosis.json beside this page."


# ----------------------------------------------------------------------------- pieces


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
    return "" if above < _LABELLED - 1 else f"{1 - max(after**2 - 1, 0) / above:.1%}"


def _table(
    head: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    numbers: Sequence[int] = (),
    wrap: Sequence[int] = (),
    marks: Sequence[str] = (),
    caption: str = "",
    kind: str = "",
) -> str:
    def cell(tag: str, k: int, text: str) -> str:
        css = " ".join(["number"] * (k in numbers) + ["wrap"] * (k in wrap))
        return f"<{tag}{f' class={chr(34)}{css}{chr(34)}' if css else ''}>{_text(text)}</{tag}>"

    lines = [
        (f'<tr class="{marks[i]}">' if marks and marks[i] else "<tr>")
        + "".join(cell("td", k, text) for k, text in enumerate(row))
        + "</tr>"
        for i, row in enumerate(rows)
    ]
    top = "".join(cell("th", k, text) for k, text in enumerate(head))
    label = f"<caption>{_text(caption)}</caption>" if caption else ""
    return (
        f'<div class="{f"scroll {kind}".strip()}"><table>{label}<thead><tr>{top}</tr></thead>'
        f"<tbody>{''.join(lines)}</tbody></table></div>\n"
    )


def _interval(ends: Sequence[float] | None) -> str:
    return "not known" if ends is None else f"{ends[0]:.5g} to {ends[1]:.5g}"


def _value(name: str, value: float, unit: str) -> str:
    return f"{name} {value:.3g} {_unit(unit)}".rstrip()


def _range(ends: Sequence[float]) -> str:
    return f"{ends[0]:.2f} to {ends[1]:.2f}"


def _share(p: float) -> str:
    return "> 99 %" if p > 0.99 else f"{100 * p:.0f} %"


def _probability(p: float) -> str:
    return "> 0.999" if p > 0.999 else "< 0.001" if p < 0.001 else f"{p:.3f}"


def _unit(unit: str) -> str:
    return "" if unit == "1" else unit


def _text(text: str) -> str:
    return html.escape(str(text), quote=True)
