"""How results draw themselves and what a notebook shows of them: one function per class.

`Viewable.plot` loads this file on first use; matplotlib is imported when something is drawn.
"""

from __future__ import annotations

import contextlib
import textwrap
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ves_gym._util.optional import lacking, require
from ves_gym._util.params import ParameterError
from ves_gym._util.views import Viewable, draw, facts, picture
from ves_gym.baselines.comparison import ControllerComparison
from ves_gym.baselines.train import TrainingResult
from ves_gym.diagnosis.diagnose import Diagnosis
from ves_gym.planners.comparison import Comparison
from ves_gym.planners.coupling_map import CouplingMap
from ves_gym.planners.query import Plan
from ves_gym.planners.scenes import map_data
from ves_gym.report.figures import darker, draw_map, png_text
from ves_gym.report.planner_styles import COLOURS, line_style
from ves_gym.simulation.stability import EmulationCheck
from ves_gym.system.energy import log_base_energy, log_energies, motion_end
from ves_gym.system.energy_balance import EnergyBalance
from ves_gym.system.runlog import RunLog
from ves_gym.system.system import System

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_JOINTS = (COLOURS[3], COLOURS[1], COLOURS[4], COLOURS[2], COLOURS[5], COLOURS[6], COLOURS[0])
_BEFORE, _AFTER = COLOURS[1], COLOURS[3]
_CHANNELS = 12  # of a diagnosis, those with the largest gap
_DPI = 80  # of a notebook's picture


def _axes(ax: Any, titles: Sequence[str], size: tuple[float, float]) -> list[Axes]:
    """Return one axes per panel, with a grid: those of the caller, or of a new figure."""
    require("drawing", "matplotlib")
    import matplotlib.pyplot as plt

    if ax is None:
        _, ax = plt.subplots(len(titles), 1, figsize=size, layout="constrained", sharex=True)
    panels = np.atleast_1d(np.asarray(ax, object)).ravel().tolist()
    if len(panels) not in (1, len(titles)):
        raise ParameterError(
            f"ax must be one axes or {len(titles)} ({', '.join(titles)}), got {len(panels)}"
        )
    for axes in panels:
        axes.grid(alpha=0.3)
    return panels


def _key(axes: Axes, columns: int) -> None:
    """Put the legend above the axes, where it hides nothing."""
    style: dict[str, Any] = {
        "bbox_to_anchor": (1.0, 1.0),
        "borderaxespad": 0.2,
        "ncols": columns,
    }
    axes.legend(loc="lower right", frameon=False, fontsize="small", **style)


# ------------------------------------------------------------------------- run logs


@draw.register
def _(log: RunLog, ax: Any = None, **options: Any) -> Any:
    """Base energy, joint angles and torques over time; one axes gets the energy alone."""
    titles: tuple[str, ...] = ("base energy", "joint angles", "torques")
    system = System.from_dict(log.meta["system"]) if "system" in log.meta else None
    if log.tau is None:
        titles = titles[:2]
    panels = _axes(ax, titles, (8.0, 2.3 * len(titles) + 0.6))
    _draw_energy(panels[0], log, system, **options)
    low = high = most = None
    if system is not None:
        low, high = (np.rad2deg(system.arm.column(name)) for name in ("q_min", "q_max"))
        most = system.arm.column("tau_max")
    if len(panels) > 1:
        _draw_per_joint(
            panels[1], log.t, np.rad2deg(log.q), low, high, "q", np.rad2deg(log.q_cmd)
        )
        panels[1].set_ylabel("joint angle [deg]")
    if len(panels) > 2:
        least = None if most is None else -most
        _draw_per_joint(panels[2], log.t, log.tau, least, most, "\\tau", shade=0.0)
        panels[2].set_ylabel("motor torque [N m]")
    for axes in panels:
        axes.axvspan(log.t[0], log.t[0] + motion_end(log), color="0.93", zorder=0)
        axes.set_xlim(log.t[0], log.t[-1])
    panels[-1].set_xlabel("time [s]; shaded: the motion")
    return panels[0] if len(panels) == 1 else np.array(panels)


def _draw_energy(axes: Axes, log: RunLog, system: System | None, **style: Any) -> None:
    if system is None:
        axes.plot(log.t, 1e3 * np.linalg.norm(log.y[:, :3], axis=1), **style)
        axes.set_ylabel("base displacement [mm]")
        return
    parts = log_base_energy(log, system)
    axes.plot(log.t, parts.total, label="total", **{"color": COLOURS[3], "lw": 1.3, **style})
    if not style:
        axes.plot(log.t, parts.strain, color=COLOURS[1], lw=0.9, label="strain")
        _key(axes, 2)
    axes.set_ylim(bottom=0)
    axes.set_ylabel("base energy [J]")


def _draw_per_joint(
    axes: Axes,
    t: Any,
    x: Any,
    low: Any,
    high: Any,
    symbol: str,
    command: Any = None,
    shade: float = 0.12,
) -> None:
    """Draw a line per joint, its limits dashed, and what lies beyond them shaded."""
    for k in range(x.shape[1]):
        colour = _JOINTS[k % len(_JOINTS)]
        axes.plot(t, x[:, k], color=colour, lw=1.2, label=f"${symbol}_{k + 1}$")
        if command is not None:
            axes.plot(t, command[:, k], color=darker(colour), lw=0.8, ls=":")
    bottom, top = axes.get_ylim()
    margin = 0.06 * (top - bottom)
    for k in range(x.shape[1] if low is not None else 0):
        colour = _JOINTS[k % len(_JOINTS)]
        near = 0.3 * (high[k] - low[k])  # farther limits would flatten everything else
        if x[:, k].max() > high[k] - near:
            top = max(top, high[k] + margin)
        if x[:, k].min() < low[k] + near:
            bottom = min(bottom, low[k] - margin)
        for limit, beyond in ((high[k], 1e4), (low[k], -1e4)):
            axes.axhspan(limit, limit + beyond, color=colour, alpha=shade, lw=0)
            axes.axhline(limit, color=colour, lw=0.8, ls="--")
    axes.set_ylim(bottom, top)
    _key(axes, min(x.shape[1], 7))


@facts.register
def _(log: RunLog) -> Iterable[tuple[str, str]]:
    """Size, and the energies where the log is long enough."""
    yield "samples", f"{len(log)} over {log.duration:g} s, {log.n_joints} joints"
    if "system" in log.meta:
        yield "system", repr(System.from_dict(log.meta["system"])).strip("<>")
        with contextlib.suppress(ParameterError):  # it ends before the energies' time does
            yield "energies", str(log_energies(log))
    for event in log.meta.get("events", ()):
        yield "stopped", f"at {event['time']:g} s: {event['reason']}"


@draw.register
def _(balance: EnergyBalance, ax: Any = None) -> Any:
    """Work of the drives and where it went, over time."""
    (axes,) = _axes(ax, ("energy balance",), (8.0, 3.6))
    parts = (
        ("work", balance.work, COLOURS[3]),
        ("kinetic", balance.kinetic, COLOURS[1]),
        ("strain", balance.strain, COLOURS[4]),
        ("dissipated", balance.dissipated, COLOURS[2]),
        ("residual", balance.residual, COLOURS[0]),
    )
    for name, values, colour in parts:
        axes.plot(balance.t, values, color=colour, lw=1.2, label=name)
    axes.set(xlabel="time [s]", ylabel="energy [J]", xlim=(balance.t[0], balance.t[-1]))
    _key(axes, 5)
    return axes


# --------------------------------------------------------------------------- planning


@draw.register
def _(plan: Plan, ax: Any = None) -> Any:
    """Joint angles over time with their limits; dotted: the straight line."""
    (axes,) = _axes(ax, ("joint angles",), (8.0, 3.6))
    arm, duration = plan.query.system.arm, plan.query.duration
    t = np.linspace(0.0, duration, 301)
    low, high = (np.rad2deg(arm.column(name)) for name in ("q_min", "q_max"))
    angles, straight = (np.rad2deg(m.at(t).q) for m in (plan.motion, plan.query.straight))
    _draw_per_joint(axes, t, angles, low, high, "q", straight)
    axes.set(xlabel="time [s]; dotted: straight line", ylabel="joint angle [deg]")
    axes.set_xlim(0.0, duration)
    title = repr(plan).removeprefix("<Plan: ").removesuffix(">")
    axes.set_title(textwrap.fill(title, 60), fontsize="medium", loc="left")
    return axes


@facts.register
def _(plan: Plan) -> Iterable[tuple[str, str]]:
    """Query, prediction and planning time."""
    yield "query", plan.query.ends_in_words
    yield "system", repr(plan.query.system).strip("<>")
    if plan.found:
        values = plan.predicted.to_dict()
        yield "predicted", ", ".join(f"{name} {x:.4g} J" for name, x in values.items())
    yield "planned in", f"{plan.seconds:.2f} s"


@draw.register
def _(comparison: Comparison, ax: Any = None, log: bool = False) -> Any:
    """Base energy over time, a line per planner; `log`: a logarithmic axis."""
    (axes,) = _axes(ax, ("base energy",), (8.0, 3.8))
    names = [row.planner for row in comparison]
    axes.axvspan(0.0, comparison.duration, color="0.93", zorder=0)
    for row in comparison:
        if row.energy is None:
            continue
        label = row.planner + ("" if row.ratio is None else f" ({row.ratio:.2f})")
        style = line_style(row.planner, names)
        axes.plot(comparison.t, row.energy, lw=1.4, label=label, **style)
    axes.set(xlabel="time [s]; shaded: the motion", ylabel="base energy [J]")
    axes.set_xlim(0.0, comparison.t[-1])
    if log:
        axes.set_yscale("log")
    else:
        axes.set_ylim(bottom=0)
    axes.set_title(comparison.name, fontsize="medium")
    title = "E_mean / straight line's"
    axes.legend(title=title, loc="upper right", ncols=2, fontsize="small", framealpha=0.8)
    return axes


@facts.register
def _(comparison: Comparison) -> Iterable[tuple[str, str]]:
    """One row per planner."""
    for row in comparison:
        parts = []
        if row.simulated is not None:
            parts.append(f"E_mean {row.simulated.E_mean:.4g} J")
        if row.ratio is not None:
            parts.append(f"{row.ratio:.3f} of the straight line's")
        if row.failure is not None:
            parts.append(row.failure)
        yield row.planner, ", ".join((*parts, f"planned in {row.seconds:.2f} s"))


@draw.register
def _(section: CouplingMap, ax: Any = None, paths: Sequence[Plan] = ()) -> Any:
    """Minimum-energy lines over the coupling, and the `paths` of plans across them."""
    (axes,) = _axes(ax, ("coupling",), (6.4, 5.2))
    axes.grid(visible=False)
    plans = [plan for plan in paths if plan.found]
    names = list(dict.fromkeys(plan.planner for plan in plans))
    data = map_data("", section, plans)
    draw_map(axes.figure, axes, data, names)
    axes.set_title(data["title"], fontsize="medium")
    for name in names:
        axes.plot([], [], lw=2, label=name, **line_style(name, names))
    if names:
        axes.legend(loc="best", fontsize="small")
    return axes


@facts.register
def _(section: CouplingMap) -> Iterable[tuple[str, str]]:
    """Ranges of the coupling."""
    for name, values in (("worst direction", section.most), ("best", section.least)):
        yield name, f"{values.min():.4g} to {values.max():.4g} J/rad²"


# -------------------------------------------------------------------------- diagnosis


@draw.register
def _(diagnosis: Diagnosis, ax: Any = None) -> Any:
    """Gap of each channel in standard deviations of the noise, before and after."""
    gaps = sorted(diagnosis.final or diagnosis.gaps, key=lambda g: -g.before)[:_CHANNELS]
    (axes,) = _axes(ax, ("gaps",), (8.0, 1.4 + 0.34 * len(gaps)))
    at = np.arange(len(gaps))[::-1]
    for side, shift, colour in (("before", 0.19, _BEFORE), ("after", -0.19, _AFTER)):
        values = [getattr(gap, side) for gap in gaps]
        axes.barh(at + shift, values, 0.36, color=colour, label=side)
        ends = np.array([getattr(gap, f"{side}_interval") for gap in gaps])
        if np.isfinite(ends).all():
            axes.hlines(at + shift, ends[:, 0], ends[:, 1], color=darker(colour), lw=1.2)
    axes.set_yticks(at, [f"{gap.port}: {gap.channel}" for gap in gaps])
    axes.axvline(1.0, color="0.4", lw=0.8, ls=":")
    if max(gap.before for gap in gaps) > 20:
        axes.set_xscale("log")
        axes.set_xlim(left=0.3)
    runs = "runs held back" if diagnosis.final else "runs fitted"
    axes.set_xlabel(f"gap / noise on the {runs}; dotted: noise alone")
    axes.set_title(textwrap.fill(diagnosis.sentence, 90), fontsize="medium")
    axes.legend(loc="lower right", fontsize="small")
    axes.grid(visible=False, axis="y")
    return axes


@facts.register
def _(diagnosis: Diagnosis) -> Iterable[tuple[str, str]]:
    """Effects with intervals, and the verdict."""
    yield "verdict", diagnosis.verdict
    for effect in diagnosis.to_dict()["effects"]:
        numbers = []
        for name, value in effect["value"].items():
            ends = effect["interval"][name]
            interval = "" if ends is None else f" ({ends[0]:.4g} to {ends[1]:.4g})"
            numbers.append(f"{name} {value:.4g}{interval} {effect['unit'][name]}")
        yield effect["name"], f"{', '.join(numbers)}; p = {effect['probability']:.2f}"
    for port, lacks in diagnosis.untestable.items():
        yield "not tested", f"{port}: the logs lack {', '.join(lacks)}"


# ------------------------------------------------------------- policies and emulation


@draw.register
def _(comparison: ControllerComparison, ax: Any = None, measure: str = "return") -> Any:
    """Values of every episode and the interquartile mean of each controller."""
    (axes,) = _axes(ax, (measure,), (8.0, 1.2 + 0.5 * len(comparison)))
    jitter = np.random.default_rng(0)
    for k, evaluation in enumerate(comparison):
        colour = COLOURS[1 + k % (len(COLOURS) - 1)]
        values = np.concatenate([v.ravel() for v in evaluation.values(measure)])
        values = values[np.isfinite(values)]
        spread = jitter.uniform(-0.2, 0.2, len(values))
        axes.plot(values, k + spread, ".", color=colour, alpha=0.35, ms=5)
        estimate = evaluation.summary()[measure]["iqm"]
        axes.plot([estimate.low, estimate.high], [k, k], color=darker(colour), lw=2)
        axes.plot(estimate.value, k, "o", color=darker(colour), ms=6)
    axes.set_yticks(range(len(comparison)), [evaluation.name for evaluation in comparison])
    axes.invert_yaxis()
    axes.set_xlabel(f"{measure}: episodes, interquartile mean with its 95 % interval")
    axes.set_title(comparison.evaluations[0].id, fontsize="medium")
    axes.grid(visible=False, axis="y")
    return axes


@facts.register
def _(comparison: ControllerComparison) -> Iterable[tuple[str, str]]:
    """One row per controller."""
    for evaluation in comparison:
        s = evaluation.summary()
        mean = s["return"]["iqm"]
        yield (
            evaluation.name,
            f"return {mean.value:.3f} ({mean.low:.3f} to {mean.high:.3f}), success"
            f" {s['success'].value:.0%}, E_mean {s['E_mean']['median'].value:.3g} J",
        )


@draw.register
def _(result: TrainingResult, ax: Any = None) -> Any:
    """Return on the validation episodes over the steps, a line per seed."""
    (axes,) = _axes(ax, ("return",), (8.0, 3.6))
    for k, (seed, rows) in enumerate(result.curves.items()):
        colour = COLOURS[1 + k % (len(COLOURS) - 1)]
        steps, low, value, high = (
            np.array([row[key] for row in rows], float)
            for key in ("steps", "return_low", "return", "return_high")
        )
        axes.plot(steps, value, color=colour, lw=1.4, label=f"seed {seed}")
        axes.fill_between(steps, low, high, color=colour, alpha=0.12, lw=0)
    axes.set(xlabel="steps", ylabel="return")
    axes.set_title(f"{result.config.env}, {result.config.label}", fontsize="medium")
    axes.legend(loc="lower right", fontsize="small")
    return axes


@draw.register
def _(check: EmulationCheck, ax: Any = None) -> Any:
    """Modes of arm and base, damping over frequency: in space and as emulated."""
    (axes,) = _axes(ax, ("modes",), (6.4, 4.2))
    for mode in check.modes:
        x = (mode.frequency, mode.emulated_frequency)
        z = (100 * mode.damping, 100 * mode.emulated_damping)
        axes.plot(x, z, color="0.6", lw=0.8, zorder=1)
        axes.plot(x[0], z[0], "o", color=COLOURS[3], ms=10, mfc="none", mew=1.8, zorder=2)
        axes.plot(x[1], z[1], "X", color=COLOURS[1], zorder=2)
    axes.plot([], [], "o", color=COLOURS[3], ms=10, mfc="none", mew=1.8, label="in space")
    axes.plot([], [], "X", color=COLOURS[1], label="emulated")
    axes.axhline(0.0, color="0.4", lw=0.8, ls=":")
    axes.set(xlabel="frequency [Hz]", ylabel="damping [%]")
    title = repr(check).removeprefix("<EmulationCheck: ").removesuffix(">")
    axes.set_title(textwrap.fill(title, 60), fontsize="medium")
    axes.legend(loc="best", fontsize="small")
    return axes


# --------------------------------------------------------------------------- notebooks


@picture.register
def _(result: Viewable) -> str | None:
    """Draw a result without touching the figures of the session."""
    if lacking("drawing", "matplotlib"):
        return None
    import matplotlib.pyplot as plt

    before = set(plt.get_fignums())
    try:
        axes = np.atleast_1d(np.asarray(result.plot(), object))[0]
        return png_text(axes.figure, _DPI)
    except ParameterError:  # a plan without a motion
        return None
    finally:
        for number in set(plt.get_fignums()) - before:
            plt.close(number)
