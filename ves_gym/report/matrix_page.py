"""The matrix as a Markdown page and a picture: where plans break and where feedback holds."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from ves_gym._util.statistics import Estimate
from ves_gym.experiments.matrix import Matrix, MatrixEntry, trainings
from ves_gym.report.figures import panels_of, plain_log
from ves_gym.report.pages import estimate_text, markdown_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MARKERS = "osD^vPX*"
_DECADE = 10.0
_LEGEND = 25  # characters in a row
_GAP = Estimate(float("nan"), 0.0, 0.0)


def matrix_page(matrix: Matrix, entries: Sequence[MatrixEntry], title: str) -> str:
    """Return the page: a table per task, methods down, machines across."""
    parts = [f"# {title}", _what(matrix)]
    for task in matrix.tasks:
        if any(e.task == task.env for e in entries):
            parts.append(f"## {task.env}\n\n{_table(matrix, entries, task.env)}")
    if lacking := _lacking(matrix, entries):
        parts.append(f"Not run yet: {'; '.join(lacking)}.")
    parts.append(
        "Each cell: success (Wilson's interval); interquartile mean of E_mean over that of the"
        " table's first method in the same episode. In brackets 95 % intervals, by bootstrap"
        " with seeds as strata."
    )
    return "\n\n".join(parts) + "\n"


def _machines(matrix: Matrix, entries: Sequence[MatrixEntry]) -> list[str]:
    """Names of the machines that anything ran on."""
    there = {e.machine for e in entries}
    return [m.name for m in matrix.machines if m.name in there]


def _lacking(matrix: Matrix, entries: Sequence[MatrixEntry]) -> list[str]:
    """Machines and, of the others, methods with their task that have no figures."""
    there = {(e.task, e.method, e.machine) for e in entries}
    names = _machines(matrix, entries)
    out = [f"machine {m.name}" for m in matrix.machines if m.name not in names]
    for task in matrix.tasks:
        for method in task.methods:
            without = [m for m in names if (task.env, method.name, m) not in there]
            if without:
                on = "" if without == names else f" on {', '.join(without)}"
                out.append(f"{task.env} {method.name}{on}")
    return out


def _what(matrix: Matrix) -> str:
    count = len(matrix.seeds) * matrix.episodes
    fewer = [
        f"{task.env} {method.name} {len(matrix.seeds) * matrix.episodes_of(method)}"
        for task in matrix.tasks
        for method in task.methods
        if matrix.episodes_of(method) < matrix.episodes
    ]
    steps = {
        f"{task} {method} {unit.identity['config']['total_timesteps']:,}": None
        for (task, method, _), unit in trainings(matrix).items()
    }
    trained = f"\n\nDecisions that a policy learned from: {', '.join(steps)}." * bool(steps)
    slow = f" Fewer, the first of them, for what is slow: {', '.join(fewer)}." * bool(fewer)
    machines = "\n".join(
        f"- **{m.name}**: {'emulated' if m.emulated else 'in space'}"
        + (f", {_plain(m.settings)}" if m.settings else "")
        for m in matrix.machines
    )
    return (
        f"{len(matrix.seeds)} seeds with {matrix.episodes} episodes each in every cell"
        f" ({count} episodes), the same for all methods. A trained method has a policy of its"
        f" own per seed.{slow} Machines:\n\n{machines}{trained}"
    )


def _plain(settings: Mapping[str, Any]) -> str:
    return ", ".join(
        f"{k} ({_plain(v)})" if isinstance(v, Mapping) else f"{k} {v}"
        for k, v in settings.items()
    )


def _table(matrix: Matrix, entries: Sequence[MatrixEntry], task: str) -> str:
    by = {(e.method, e.machine): e for e in entries if e.task == task}
    machines = _machines(matrix, entries)
    rows = [
        [method, *(_cell(by.get((method, machine))) for machine in machines)]
        for method in dict.fromkeys(k for k, _ in by)
    ]
    return markdown_table(("method", *machines), rows)


def _cell(e: MatrixEntry | None) -> str:
    if e is None:
        return "-"
    energy = "" if e.energy is None else f"<br>E {estimate_text(*e.energy, '.3g')}"
    return f"{estimate_text(*e.success, '.0%')}{energy}"


def crossover_figure(matrix: Matrix, entries: Sequence[MatrixEntry]) -> Figure:
    """Success and energy of every method against the machines, a column per task."""
    from matplotlib.ticker import MaxNLocator

    tasks = [t.env for t in matrix.tasks if any(e.task == t.env for e in entries)]
    machines = _machines(matrix, entries)
    place = {name: k for k, name in enumerate(dict.fromkeys(e.method for e in entries))}
    figure, panels = panels_of(2 * len(tasks), 3.6, 3.2, columns=len(tasks))
    for column, task in enumerate(tasks):
        success, energy = panels[column], panels[len(tasks) + column]
        task_entries = [e for e in entries if e.task == task]
        methods = list(dict.fromkeys(e.method for e in task_entries))
        for k, method in enumerate(methods):
            of = {e.machine: e for e in task_entries if e.method == method}
            shift = 0.08 * (k - (len(methods) - 1) / 2)
            x = [i + shift for i in range(len(machines))]
            at = place[method]  # a method looks alike in every column
            style = {"marker": _MARKERS[at % len(_MARKERS)], "color": f"C{at % 10}"}
            successes = [of[m].success if m in of else None for m in machines]
            _draw(success, x, successes, method, style)
            energies = [of[m].energy if m in of else None for m in machines]
            _draw(energy, x, energies, method, style)
        success.set_title(task)
        success.set_ylim(-0.03, 1.03)
        success.sharex(energy)
        success.label_outer()
        energy.set_yscale("log")
        plain_log(energy.yaxis)
        low, high = energy.get_ylim()
        if high <= _DECADE * low:  # however little it spans, a few numbers
            energy.yaxis.set_major_locator(MaxNLocator(5))
        energy.set_xticks(range(len(machines)), machines)
        for axes in (success, energy):
            axes.tick_params(labelsize=8)
            axes.tick_params(axis="x", labelsize=7)  # six names in a row
        below: dict[str, Any] = {
            "loc": "upper center",
            "bbox_to_anchor": (0.5, -0.1),
            "frameon": False,
        }
        labels = [fill(m, _LEGEND) for m in methods]  # wide legends would narrow the axes
        energy.legend(labels=labels, fontsize=7, ncols=2, **below)
    panels[0].set_ylabel("success", fontsize=9)
    panels[len(tasks)].set_ylabel("E_mean over the first method's", fontsize=9)
    return figure


def _draw(
    axes: Any,
    x: Sequence[float],
    values: Sequence[Estimate | None],
    label: str,
    style: Mapping[str, str],
) -> None:
    """Values with their intervals; those that are missing or infinite leave gaps."""
    drawn = [v if v is not None and math.isfinite(v.value) else _GAP for v in values]
    y, lower, upper = np.array(drawn).T
    if np.isnan(y).all():
        return
    upper = np.where(np.isinf(upper), 100 * np.nanmax(y), upper)  # beyond the picture
    low, high = np.maximum(y - lower, 0.0), np.maximum(upper - y, 0.0)
    axes.errorbar(x, y, yerr=[low, high], label=label, markersize=4, capsize=2, lw=1.1, **style)
