"""Pictures of a diagnosis: where and when the gap is, what is alike, before and after."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy

from ves_gym._util.params import Array
from ves_gym.diagnosis.inference.model_selection import Selection
from ves_gym.diagnosis.inference.whitened_residuals import VarianceGroup, WhitenedResiduals
from ves_gym.report.figures import panels_of, plain_log
from ves_gym.report.planner_styles import COLOURS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Result = dict[str, Any]

_BEFORE, _AFTER = COLOURS[1], COLOURS[3]
_MOST = 1e3  # mean square at which the colour of the map ends, if nothing is above it
LABELLED = 2.0  # mean square from which a cell of the map says its number
_LINES = 12  # channels in the map over time
_PAIR = 2  # channels in overlays
_LOUD = 2.0  # mean square of a range of frequencies that is more than noise
_FILTER = 4  # order of the low-pass that overlays go through


def where_figure(where: Sequence[Result], better: bool = True) -> Figure:
    """Draw the mean square of the residual over noise [1], channels of ports by ranges of
    frequency [Hz]; `better`: there is an after."""
    channels = list(dict.fromkeys((g["port"], g["channel"]) for g in where))
    ranges = list(dict.fromkeys((g["low"], g["high"]) for g in where))
    width, height = max(11.0, 2.5 + 0.36 * len(channels)), 2.1 if better else 2.6
    figure, panels = panels_of(1 + better, width, height, columns=1, grid=False)
    top = max([_MOST, *(g["before"] for g in where), *(g["after"] for g in where)])
    for axes, key in zip(panels, ("before", "after"), strict=False):
        size = np.full((len(ranges), len(channels)), np.nan)
        for g in where:
            at = ranges.index((g["low"], g["high"])), channels.index((g["port"], g["channel"]))
            size[at] = g[key]
        image = _heat(axes, size, top, origin="lower")
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
    """Draw the mean square of the residual over noise [1] over the time elapsed, the channels
    that show most; `better`: there is an after."""
    loudest: dict[tuple[str, str], float] = {}
    for course in when:
        key = course["port"], course["channel"]
        loudest[key] = max(loudest.get(key, 0.0), *course["before"], *course["after"])
    channels = sorted(loudest, key=lambda k: -loudest[k])[:_LINES]
    runs = list(dict.fromkeys(course["run"] for course in when))
    top, height = max(_MOST, *loudest.values()), 0.8 + 0.2 * len(channels)
    figure, panels = panels_of(1 + better, 11.0, height, columns=1, grid=False)
    for axes, side in zip(panels, ("before", "after"), strict=False):
        rows, ends, steps = [], [0.0], []
        for key in channels:
            by_run = {o["run"]: o for o in when if (o["port"], o["channel"]) == key}
            rows.append(np.concatenate([by_run[run][side] for run in runs]))
        for run in runs:
            course = next(o for o in when if o["run"] == run)
            ends.append(ends[-1] + len(course["before"]))
            steps.append(course["step"])
        extent = (0, ends[-1], len(channels) - 0.5, -0.5)
        image = _heat(axes, rows, top, interpolation="nearest", extent=extent)
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


def _heat(axes: Axes, values: Any, top: float, **options: Any) -> Any:
    """Mean squares from 1, which is noise and white, to `top`."""
    from matplotlib.colors import LinearSegmentedColormap, LogNorm

    heat = LinearSegmentedColormap.from_list("heat", ("white", "#f7c9a5", _BEFORE, "#4a1500"))
    floored = np.maximum(values, 1.0)
    return axes.imshow(floored, cmap=heat, norm=LogNorm(1, top), aspect="auto", **options)


def likeness_figure(likeness: Result) -> Figure:
    """Draw the likeness of candidates: of a column's imitation to a row's signature."""
    names, matrix = likeness["names"], np.array(likeness["matrix"])
    n = len(names)
    figure, (axes,) = panels_of(1, 3.4 + 0.48 * n, 0.6 + 0.38 * n, grid=False)
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
    """Draw `overlays`, two panels each: residuals over time and their spectra in units of
    noise."""
    figure, panels = panels_of(2 * len(overlays), 6.0, 2.9, columns=2)
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
        time.set_title(f"{name}: {overlay['run']}, up to {overlay['top']:g} Hz")
        spectrum.axhline(1.0, color="0.4", linewidth=0.8, linestyle=":")
        spectrum.set(xlabel="frequency [Hz]", ylabel="residual / noise", yscale="log")
        spectrum.set_ylim(bottom=0.05)
        spectrum.set_xlim(0, overlay["f"][-1])
        plain_log(spectrum.yaxis, (1,))
        spectrum.set_title(f"{name}: spectrum")
    panels[0].legend(loc="upper right", ncols=2, frameon=False, fontsize="small")
    return figure


def _symbol(channel: str) -> str:
    """A channel's name as a formula: phi_x -> $\\phi_x$."""
    name, _, index = channel.partition("_")
    greek = rf"\{name}" if name in ("tau", "phi") else name
    return f"${greek}_{{{index}}}$" if index else f"${greek}$"


def overlays(selection: Selection, residuals: WhitenedResiduals) -> list[dict[str, Any]]:
    """Return residuals of the channel whose gap falls most and, of the others, of that with the
    largest gap, each over the run that shows it most.

    Per channel: port, channel, unit, run; t [s], before, after: the residual under the
    description and the better one, up to `top` [Hz], where the gap is; f [Hz], noise_before,
    noise_after: its spectrum in standard deviations of noise, tolerances taken off.
    """
    null, fit = selection.null, selection.fit
    adjusted = [f.residual + residuals.slopes @ f.nuisances for f in (null, fit)]
    gap: dict[tuple[str, int], list[VarianceGroup]] = {}
    for group in residuals.groups:
        gap.setdefault((group.port, group.channel), []).append(group)

    def size(groups: list[VarianceGroup], z: Array) -> float:
        return float(np.mean(np.concatenate([z[g.part] for g in groups]) ** 2))

    largest = sorted(gap, key=lambda k: -size(gap[k], adjusted[0]))
    first = max(largest, key=lambda k: size(gap[k], adjusted[0]) - size(gap[k], adjusted[1]))
    channels = [first, *(k for k in largest if k != first)][:_PAIR]

    models = [residuals.machine.nominal, residuals.machine.model(fit.effects)]
    out = []
    for name, channel in channels:
        groups = gap[name, channel]
        power_by_run = [
            sum(float(adjusted[0][g.runs[i]] @ adjusted[0][g.runs[i]]) for g in groups)
            for i in range(len(residuals.runs))
        ]
        i = int(np.argmax(power_by_run))
        run = residuals.runs[i]
        port = next(p for p in residuals.ports if p.name == name)
        x = residuals.machine.residuals(run, models, [name])[name][..., channel]
        loud = [g.high for g in groups if size([g], adjusted[0]) > _LOUD]
        top = max(loud, default=run.band)  # above it is nothing but noise, and much of it
        low = scipy.signal.butter(_FILTER, top, fs=1 / run.dt, output="sos")
        skip = run.window.skip
        inner = scipy.signal.sosfiltfilt(low, x, axis=-1)[:, skip : run.length - skip]
        t = (skip + np.arange(inner.shape[1])) * run.dt
        spectra = [np.concatenate([_power(z[g.runs[i]]) for g in groups]) for z in adjusted]
        out.append(
            {
                "port": name,
                "channel": port.channels[channel],
                "unit": port.units[channel],
                "run": run.name,
                "top": top,
                "t": t.tolist(),
                "before": inner[0].tolist(),
                "after": inner[1].tolist(),
                "f": run.window.frequencies[: len(spectra[0])].tolist(),
                "noise_before": np.sqrt(spectra[0]).tolist(),
                "noise_after": np.sqrt(spectra[1]).tolist(),
            }
        )
    return out


def _power(z: Array) -> Array:
    """(K,) mean square per frequency of numbers (2 K,): real parts, then imaginary ones."""
    return np.asarray((z.reshape(2, -1) ** 2).mean(axis=0))
