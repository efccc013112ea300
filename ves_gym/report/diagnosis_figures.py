"""Pictures of a diagnosis: where and when the gap is, what is alike, before and after."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ves_gym.report.figures import _panels
from ves_gym.report.planner_styles import COLOURS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Result = dict[str, Any]

_BEFORE, _AFTER = COLOURS[1], COLOURS[3]
_MOST = 1e3  # mean square at which the colour of the map ends, if nothing is above it
LABELLED = 2.0  # mean square from which a cell of the map says its number
_LINES = 12  # channels in the map over time


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
            if v >= LABELLED:
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
