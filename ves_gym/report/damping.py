"""Joint gains that damp the base, as pictures: poles, responses, map (thesis 4-4 to 4-7)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.integrate import cumulative_trapezoid

from ves_gym.damping.configurations import DampingMap
from ves_gym.damping.free_vibration import FreeVibration
from ves_gym.damping.gain_comparison import GainComparison
from ves_gym.damping.plant import Complexes
from ves_gym.report.figures import IN_SPACE, darker, key_below, panels_of
from ves_gym.report.planner_styles import COLOURS
from ves_gym.simulation.stability import poles_in_space

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ves_gym._util.params import Array

_TICKS = (-1e4, -3e3, -1e3, -300, -100, -30, -10, -3, -1, -0.5, 0)  # 1/s
_RESPONSE_TIME = 10.0  # s, of the responses


def damping_figures(comparison: GainComparison) -> dict[str, Figure]:
    """Return the figures of a comparison of gains by name: poles, responses, configurations."""
    rows = comparison.rows
    mass, base = comparison.plant.mass, comparison.system.base
    locked = poles_in_space(mass, *base.full()[1:])
    names = [row.name for row in rows]
    figures = {
        "pped_poles": pole_figure([(row.name, row.damping.poles) for row in rows], locked),
        "pped_responses": response_figure(names, comparison.linear, comparison.simulated),
    }
    if comparison.maps:
        figures["pped_configurations"] = map_figure(comparison.maps)
    return figures


def pole_figure(sets: Sequence[tuple[str, Complexes]], locked: Complexes) -> Figure:
    """Draw poles [1/s] of arm and base, a panel per named set of gains; rings: the base, joints
    locked.

    The upper half of the s-plane (the lower one mirrors it). The real axis is linear up to 1/s
    and logarithmic beyond: joints may have poles far from those of the base.
    """
    figure, panels = panels_of(len(sets), 4.2, 3.8)
    every = np.concatenate([locked, *(poles for _, poles in sets)])
    slowest = min(-10.0, 1.6 * every.real.min())
    top = 1.08 * every.imag.max()
    for k, (axes, (name, poles)) in enumerate(zip(panels, sets, strict=True)):
        axes.axvline(0, color="0.6", lw=1)
        rings = locked[locked.imag >= 0]
        axes.plot(
            rings.real, rings.imag, "o", mfc="none", color="0.45", ms=9, label="joints locked"
        )
        upper = poles[poles.imag >= 0]
        axes.plot(upper.real, upper.imag, "x", color=_colour(k), mew=1.8, clip_on=False)
        axes.set_xscale("symlog", linthresh=1.0, linscale=1.0)
        axes.set_xticks([tick for tick in _TICKS if tick >= slowest], minor=False)
        axes.set_xticks([], minor=True)
        axes.xaxis.set_major_formatter("{x:g}")
        axes.set(xlim=(slowest, 0.1), ylim=(0, top), xlabel="1/s", ylabel="rad/s")
        axes.set_title(name, color=darker(_colour(k)))
    panels[0].legend(loc="lower left", fontsize="small")
    return figure


def response_figure(
    names: Sequence[str], linear: FreeVibration, simulated: FreeVibration | None = None
) -> Figure:
    """Draw translation [mm], strain energy [J] and its integral [J s] after the release under
    named sets of gains, by the linear model and, if there are any, the simulator's
    responses."""
    from matplotlib.lines import Line2D

    figure, panels = panels_of(3, 8.4, 2.9, columns=1)
    labels = ("translation [mm]", "strain energy [J]", "its integral [J s]")
    end = min(_RESPONSE_TIME, linear.t[-1])
    for axes, label in zip(panels, labels, strict=True):
        axes.set(ylabel=label, xlim=(0, end))
    for k in range(len(names)):
        if simulated is not None:
            _draw_response(panels, simulated, k, color=_colour(k), linewidth=2.0)
            dashed: dict[str, Any] = {"color": darker(_colour(k)), **IN_SPACE}
        else:
            dashed = {"color": _colour(k), "linewidth": 1.6}
        _draw_response(panels, linear, k, **dashed)
    for axes in panels:
        axes.set_ylim(bottom=0)
    panels[-1].set_xlabel("time after release [s]")
    lines = {name: Line2D([], [], color=_colour(k), lw=3) for k, name in enumerate(names)}
    if simulated is not None:
        lines["by the linear model"] = Line2D([], [], color="black", **IN_SPACE)
    key_below(figure, lines, 2)
    return figure


def map_figure(maps: Sequence[DampingMap]) -> Figure:
    """Draw a column per cross-section: raw coupling, its promise mode by mode, the tuned gains.

    The star is the configuration that the sections go through.
    """
    from matplotlib.ticker import MaxNLocator

    figure, panels = panels_of(3 * len(maps), 4.4, 3.7, columns=len(maps), grid=False)
    rows = (
        ("coupling", "trace of raw Q [J/rad²]", "Greys"),
        ("estimated", "promised by the modal coupling [J s]", "viridis_r"),
        ("tuned", "left by the best gains [J s]", "viridis_r"),
    )
    for r, (key, label, colours) in enumerate(rows):
        values = [getattr(m, key) for m in maps]
        ends = min(v.min() for v in values), max(v.max() for v in values)
        levels = MaxNLocator(14).tick_values(*ends)  # one scale along a row
        for c, section in enumerate(maps):
            axes = panels[r * len(maps) + c]
            x, y = (np.rad2deg(a) for a in section.axes)
            drawn = axes.contourf(x, y, values[c].T, levels=levels, cmap=colours)
            i, j = section.joints
            at = np.rad2deg(section.fixed)
            axes.plot(at[i], at[j], "*", ms=13, color="#c8541a", mec="white")
            axes.set(xlabel=f"joint {i + 1} [deg]", ylabel=f"joint {j + 1} [deg]")
            axes.set_title(_fixed(section), fontsize="small")
        figure.colorbar(drawn, ax=panels[r * len(maps) : (r + 1) * len(maps)], label=label)
    return figure


def _fixed(section: DampingMap) -> str:
    others = [k for k in range(len(section.fixed)) if k not in section.joints]
    return ", ".join(f"joint {k + 1} at {np.rad2deg(section.fixed[k]):.0f}°" for k in others)


def _draw_response(panels: Sequence[Axes], run: FreeVibration, k: int, **style: Any) -> None:
    distance: Array = 1e3 * np.linalg.norm(run.y[k, :, :3], axis=-1)
    total = cumulative_trapezoid(run.strain[k], run.t, initial=0.0)
    for axes, values in zip(panels, (distance, run.strain[k], total), strict=True):
        axes.plot(run.t, values, **style)


def _colour(k: int) -> str:
    return COLOURS[k % len(COLOURS)]
