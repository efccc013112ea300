"""Figures: how they are made and written, and those of a benchmark."""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ves_gym._util.optional import require
from ves_gym._util.params import write_bytes
from ves_gym.report.planner_styles import COLOURS, colour_of, line_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

    from ves_gym._util.params import Array

BASELINE = "straight"
_PIECE = 3  # points of a line that share their shade
_COLUMNS = 3  # panels side by side
_DPI = 150
_BESIDE: dict[str, Any] = {"textcoords": "offset points", "fontsize": "small"}
IN_SPACE: dict[str, Any] = {"linewidth": 0.8, "dashes": (6, 4)}
_UNDATED = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
_STYLE: Any = {"svg.hashsalt": "ves-gym", "pdf.fonttype": 42}  # fonts that journals take
FORMATS = ("png", "svg", "pdf")
Result = dict[str, Any]


def write_figures(figures: Mapping[Path, Figure], form: str = "png") -> list[Path]:
    """Write figures by the name of the file without its suffix, each completely or not at all,
    and return the files; same figure, same bytes."""
    import matplotlib

    files = []
    for stem, figure in figures.items():
        buffer = io.BytesIO()
        with matplotlib.rc_context(_STYLE):
            figure.savefig(buffer, format=form, dpi=_DPI, metadata=_UNDATED.get(form))
        files.append(stem.with_name(f"{stem.name}.{form}"))
        write_bytes(files[-1], buffer.getvalue())
    return files


def png_text(figure: Figure, dpi: int = _DPI) -> str:
    """A picture as base64 text."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi)
    return base64.b64encode(buffer.getvalue()).decode("ascii")


def png_address(figure: Figure) -> str:
    """A picture as what stands in the `src` of an image."""
    return f"data:image/png;base64,{png_text(figure)}"


def panels_of(
    count: int, width: float, height: float, columns: int = _COLUMNS, *, grid: bool = True
) -> tuple[Figure, list[Axes]]:
    """A figure of `count` axes of a size [inch], without touching pyplot's state."""
    require("drawing", "matplotlib")
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    columns = min(columns, count)
    rows = math.ceil(count / columns)
    figure = Figure(figsize=(width * columns, height * rows + 0.5), layout="constrained")
    FigureCanvasAgg(figure)
    with matplotlib.rc_context(
        {"axes.grid": grid, "grid.alpha": 0.3, "axes.titlesize": "medium"}
    ):
        axes = figure.subplots(rows, columns, squeeze=False).ravel().tolist()
    for spare in axes[count:]:
        spare.remove()
    return figure, axes[:count]


def plain_log(axis: Any, subs: Sequence[float] = (1, 2, 5)) -> None:
    """Plain numbers beside a logarithmic axis."""
    from matplotlib.ticker import LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=subs))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


def darker(colour: str) -> str:
    """A colour #rrggbb at 45 % of its brightness."""
    channels = [int(colour[k : k + 2], 16) for k in (1, 3, 5)]
    return "#" + "".join(f"{int(0.45 * c):02x}" for c in channels)


# ------------------------------------------------------------------- of a benchmark


def benchmark_figures(result: Result) -> dict[str, Figure]:
    """Return the figures that a result has data for, by name: ratio, energy, coupling,
    prediction and pareto; in mode emulated also base_motion_emulated and
    strain_energy_emulated."""
    rows, traces = result.get("rows"), result.get("traces")
    emulated = traces and result.get("mode") == "emulated"
    summary = result.get("summary", ())
    traded = any(s.get(f"{k}_ratio_median") for s in summary for k in TRADED)
    kinds: dict[str, tuple[Any, Callable[[], Figure]]] = {
        "ratio": (rows, lambda: ratio_figure(result)),
        "energy": (traces, lambda: time_figure(result, "E")),
        "coupling": (
            result.get("maps"),
            lambda: coupling_figure(result["maps"], _planners(result)),
        ),
        "prediction": (rows, lambda: prediction_figure(result)),
        "pareto": (traded, lambda: pareto_figure(result)),
        "base_motion_emulated": (emulated, lambda: time_figure(result, "distance")),
        "strain_energy_emulated": (emulated, lambda: time_figure(result, "strain")),
    }
    return {name: draw() for name, (data, draw) in kinds.items() if data}


def ratio_figure(result: Result) -> Figure:
    """E_mean over the straight line's, every query a dot, the median a bar."""
    names, ratios = _planners(result), _ratios(result["rows"])
    vehicles = {r["vehicle"]: sorted({k for v, k in ratios if v == r["vehicle"]})
                for r in result["rows"]}  # fmt: skip
    columns = max(map(len, vehicles.values()))
    figure, panels = panels_of(len(vehicles), 2.4 + 2.1 * columns, 3.8, columns=1)
    jitter = np.random.default_rng(0)
    for axes, (vehicle, durations) in zip(panels, vehicles.items(), strict=True):
        axes.axhline(1.0, color=COLOURS[0], linewidth=1)
        for place, duration in enumerate(durations):
            for k, name in enumerate(names):
                if values := ratios[vehicle, duration].get(name):
                    at = place + 0.8 * ((k + 0.5) / len(names) - 0.5)
                    colour = colour_of(name, names)
                    _strip(axes, at, np.array(values), 0.5 / len(names), colour, jitter)
        axes.set(yscale="log", ylabel="E_mean / straight line's", title=vehicle)
        plain_log(axes.yaxis)
        axes.margins(y=0.12)
        axes.set_xticks(range(len(durations)), [f"T = {d:g} s" for d in durations])
        axes.grid(visible=False, axis="x")
    planner_legend(figure, names)
    return figure


CURVES = {  # key of a series -> axis label, factor from SI
    "E": ("E [J]", 1.0),
    "strain": ("strain energy [J]", 1.0),
    "distance": ("base displacement [mm]", 1e3),
}


def time_figure(result: Result, key: str) -> Figure:
    """Draw a quantity of `CURVES` against time, a panel per query of a benchmark with traces;
    shaded while the arm moves.

    Mode emulated: dashed and darker the same motion in space, a cross where a run stopped.
    """
    names, (label, factor) = _planners(result), CURVES[key]
    emulated = result.get("mode") == "emulated"
    size = (9.0, 3.2, 1) if emulated else (4.6, 3.0, _COLUMNS)
    figure, panels = panels_of(len(result["traces"]), *size, grid=False)
    for axes, trace in zip(panels, result["traces"], strict=True):
        axes.axvspan(0, trace["duration"], color="0.93")
        end = max(s.get("ideal", s)["t"][-1] for s in trace["series"])
        for series in trace["series"]:
            colour, values = colour_of(series["planner"], names), factor * np.array(series[key])
            style = line_style(series["planner"], names)
            axes.plot(series["t"], values, linewidth=2.2 if emulated else 1.3, **style)
            if "ideal" not in series:
                continue
            if series["t"][-1] < end - 0.1:
                axes.plot(series["t"][-1], values[-1], "x", color=colour, markersize=7)
            space = series["ideal"]
            values = factor * np.array(space[key])
            axes.plot(space["t"], values, color=darker(colour), **IN_SPACE)
        axes.set(xlabel="time [s]", ylabel=label, xlim=(0, end))
        axes.set_ylim(bottom=0)
        axes.set_title(f"{trace['vehicle']}, T = {trace['duration']:g} s, {trace['query']}")
    planner_legend(figure, names, in_space=emulated)
    return figure


def coupling_figure(maps: Sequence[Result], planners: Sequence[str]) -> Figure:
    """Draw minimum-energy lines, darker where the base couples more, and the paths across them.

    The picture of thesis figure 4-1, a panel per map (`planners.scenes.map_data`).
    """
    figure, panels = panels_of(len(maps), 4.6, 4.0, grid=False)
    for axes, section in zip(panels, maps, strict=True):
        draw_map(figure, axes, section, planners)
    if planners:
        planner_legend(figure, planners)
    return figure


def prediction_figure(result: Result) -> Figure:
    """E_mean as the planners predict it against the simulated one, and the relative error.

    Both of the space system, in mode emulated too: that is what planners predict.
    """
    names = _planners(result)
    figure, (level, error) = panels_of(2, 5.0, 4.4, grid=False)
    rows = [{**r, "E_mean": r.get("E_mean_ideal", r["E_mean"])} for r in result["rows"]]
    rows = [
        r for r in rows if r["predicted"] is not None and min(r["E_mean"], r["predicted"]) > 0
    ]
    for name in names:
        x = np.array([r["E_mean"] for r in rows if r["planner"] == name])
        y = np.array([r["predicted"] for r in rows if r["planner"] == name])
        if len(x):
            style: dict[str, Any] = {"color": colour_of(name, names), "alpha": 0.6}
            level.plot(x, y, ".", **style)
            error.plot(x, 100 * (y / x - 1), ".", **style)
    if rows:
        both = [r[key] for r in rows for key in ("E_mean", "predicted")]
        low, high = min(both) / 1.3, max(both) * 1.3
        level.plot([low, high], [low, high], color="0.4", linewidth=0.8, zorder=0)
        level.set(xscale="log", yscale="log", xlim=(low, high), ylim=(low, high))
        error.set(xscale="log", xlim=(low, high))
        middle = float(np.median([abs(r["predicted"] / r["E_mean"] - 1) for r in rows]))
        error.set_title(f"median {100 * middle:.2g} %")
    level.set(xlabel="simulated E_mean [J]", ylabel="predicted E_mean [J]")
    error.axhline(0.0, color="0.4", linewidth=0.8, zorder=0)
    error.set(xlabel="simulated E_mean [J]", ylabel="error of the prediction [%]")
    planner_legend(figure, names)
    return figure


TRADED = {  # measure -> axis label
    "acceleration_peak": "largest acceleration / straight line's",
    "angular_peak": "largest angular acceleration / straight line's",
}


def pareto_figure(result: Result) -> Figure:
    """Draw energy against acceleration of the base, medians by planner; a panel each.

    Planners with a bound on a disturbance measure are joined in the order of the bounds; that
    without has 1.
    """
    names = _planners(result)
    cases = list(dict.fromkeys((r["vehicle"], r["duration"]) for r in result["summary"]))
    figure, panels = panels_of(len(TRADED) * len(cases), 5.0, 4.2, columns=len(TRADED))
    for k, axes in enumerate(panels):
        case, measure = cases[k // len(TRADED)], list(TRADED)[k % len(TRADED)]
        key = f"{measure}_ratio_median"
        points = {
            row["planner"]: (row["ratio_median"], row[key])
            for row in result["summary"]
            if (row["vehicle"], row["duration"]) == case
            and None not in (row["ratio_median"], row[key])
        }
        _tradeoff(axes, points, names)
        axes.set(xlabel="E_mean / straight line's", ylabel=TRADED[measure])
        axes.set_title(f"{case[0]}, T = {case[1]:g} s")
    lines = {str(curve.get_label()): curve for axes in panels for curve in axes.lines}
    lines = {name: curve for name, curve in lines.items() if not name.startswith("_")}
    key_below(figure, lines, min(3, len(lines) or 1))
    return figure


def _tradeoff(axes: Axes, points: dict[str, tuple[float, float]], names: Sequence[str]) -> None:
    """Draw planners as labelled points, those of one kind and measure joined by a line."""
    families: dict[tuple[str, str], list[tuple[float, str]]] = {}
    for name in points:
        plain, _, bounds = name.partition(":")
        measure, _, bound = bounds.rpartition("=")
        if bounds and "+" not in bounds:
            families.setdefault((plain, measure), []).append((float(bound), name))
    joined: set[str] = set()
    for k, ((plain, measure), members) in enumerate(families.items()):
        joined.update(name for _, name in members)
        members += [(1.0, plain)] if plain in points else []
        at = np.array([points[name] for _, name in sorted(members)])
        colour = COLOURS[1 + k % (len(COLOURS) - 1)]
        axes.plot(*at.T, "-o", color=colour, markersize=4, label=f"{plain}, bound on {measure}")
        for value, name in members:
            axes.annotate(f"{value:g}", points[name], (5, 4), color=colour, **_BESIDE)
    for name, point in points.items():
        if name not in joined:
            axes.plot(*point, "o", color=colour_of(name, names), markersize=7, label=name)
    axes.axhline(1.0, color="0.6", linewidth=0.8, zorder=0)
    axes.axvline(1.0, color="0.6", linewidth=0.8, zorder=0)
    axes.set(xscale="log", yscale="log")
    axes.margins(0.12)
    for axis, values in ((axes.xaxis, 0), (axes.yaxis, 1)):
        drawn = [1.0, *(point[values] for point in points.values())]
        wide = max(drawn) > 12 * min(drawn)
        plain_log(axis, (1, 2, 5) if wide else (1, 1.5, 2, 3, 5, 7))


# ---------------------------------------------------------------------------- pieces


def _ratios(rows: Sequence[Result]) -> dict[tuple[str, float], dict[str, list[float]]]:
    """Positive ratios to the straight line's energy, by vehicle and duration, then planner."""
    straight = {
        (r["vehicle"], r["query"]): r["E_mean"] or 0.0 for r in rows if r["planner"] == BASELINE
    }
    out: dict[tuple[str, float], dict[str, list[float]]] = {}
    for r in rows:
        ratios = out.setdefault((r["vehicle"], r["duration"]), {}).setdefault(r["planner"], [])
        base = straight.get((r["vehicle"], r["query"]), 0.0)
        if base > 0 and r["E_mean"] is not None and r["E_mean"] > 0:
            ratios.append(r["E_mean"] / base)
    return out


def _strip(
    axes: Axes, at: float, values: Array, width: float, colour: str, rng: np.random.Generator
) -> None:
    spread = rng.uniform(-0.5, 0.5, len(values)) * width
    axes.plot(at + spread, values, ".", color=colour, alpha=0.35, markersize=5)
    median = float(np.median(values))
    axes.plot([at - width * 0.8, at + width * 0.8], [median] * 2, color=colour, linewidth=2.5)
    axes.annotate(
        f"{median:.2g}", (at, median), (0, 4), textcoords="offset points", ha="center",
        fontsize="x-small", color=colour, fontweight="bold",
    )  # fmt: skip


def draw_map(
    figure: Figure | SubFigure, axes: Axes, section: Result, names: Sequence[str]
) -> None:
    """Draw one coupling map (`planners.scenes.map_data`) into axes of a figure, which gets a
    colour bar, with the paths of the planners that its data hold."""
    from matplotlib.collections import LineCollection
    from scipy.interpolate import RegularGridInterpolator

    x, y, most = (np.array(section[key]) for key in ("x", "y", "most"))
    # the pieces of a line are shaded one by one, at their middle
    pieces = [
        np.array(curve[k : k + _PIECE + 1])
        for curve in section["lines"]
        for k in range(0, len(curve) - 1, _PIECE)
    ]
    middles = np.array([piece.mean(axis=0) for piece in pieces]).reshape(-1, 2)
    value = RegularGridInterpolator((x, y), most, bounds_error=False, fill_value=None)
    lines = LineCollection(pieces, cmap="Greys", linewidths=0.9)
    lines.set_array(value(middles))
    lines.set_clim(0, most.max())
    shade = {"cmap": "Greys", "alpha": 0.2, "vmin": 0, "vmax": most.max()}
    axes.pcolormesh(x, y, most.T, rasterized=True, **shade)  # else thousands of paths
    axes.add_collection(lines)
    for path in section["paths"]:
        points = np.array(path["points"])
        axes.plot(*points.T, color="white", linewidth=3.6)
        axes.plot(*points.T, linewidth=2, **line_style(path["planner"], names))
    for end, marker in (("goal", "s"), ("start", "o")):
        if section.get(end):
            axes.plot(
                *section[end], marker, color="black", markeredgecolor="white", markersize=8
            )
    i, j = section["joints"]
    axes.set(xlabel=f"joint {i} [deg]", ylabel=f"joint {j} [deg]")
    axes.set(xlim=(x[0], x[-1]), ylim=(y[0], y[-1]))
    axes.set_title(f"{section['vehicle']}, {section['title']}", fontsize="small")
    figure.colorbar(lines, ax=axes, label="coupling [J/rad²]")


def _planners(result: Result) -> list[str]:
    names = [p["name"] for p in result.get("planners", ())]
    return names or list(dict.fromkeys(r["planner"] for r in result.get("rows", ())))


def planner_legend(figure: Figure, names: Sequence[str], *, in_space: bool = False) -> None:
    """Put the planners below a figure."""
    from matplotlib.lines import Line2D

    lines = {name: Line2D([], [], linewidth=3, **line_style(name, names)) for name in names}
    if in_space:
        lines["the same in space"] = Line2D([], [], color="black", **IN_SPACE)
    wide = max(1.6, 0.09 * max(map(len, lines)))  # inch per name
    key_below(figure, lines, max(1, int(figure.get_figwidth() / wide)))


def key_below(figure: Figure, lines: Mapping[str, Any], columns: int) -> None:
    """Put a legend below a figure: lines by what they are of."""
    place: dict[str, Any] = {"loc": "outside lower center", "frameon": False}
    figure.legend(list(lines.values()), list(lines), ncols=columns, **place)
