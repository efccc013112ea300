"""The matrix as a Markdown page and a picture: where plans break and where feedback holds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from textwrap import fill
from typing import TYPE_CHECKING, Any

from ves_gym._util.statistics import Estimate
from ves_gym.experiments.matrix import Matrix, MatrixEntry, trainings

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MARKERS = "osD^vPX*"
_DECADE = 10.0
_LEGEND = 25  # characters in a row
_GAP = Estimate(float("nan"), 0.0, 0.0)


def matrix_page(
    matrix: Matrix,
    entries: Sequence[MatrixEntry],
    title: str,
) -> str:
    """Return the page: a table per task, methods down, machines across.

    Args:
        matrix: what was compared.
        entries: its figures.
        title: of the page.
    """
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
    lines = ["| method | " + " | ".join(machines) + " |", "|---" * (len(machines) + 1) + "|"]
    for method in dict.fromkeys(k for k, _ in by):
        cells = (_cell(by.get((method, machine))) for machine in machines)
        lines.append(f"| {method} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _cell(e: MatrixEntry | None) -> str:
    if e is None:
        return "-"
    energy = "" if e.energy is None else f"<br>E {_estimate(e.energy, '.3g')}"
    return f"{_estimate(e.success, '.0%')}{energy}"


def _estimate(e: Estimate, form: str) -> str:
    return f"{e.value:{form}} ({e.low:{form}} to {e.high:{form}})"


def crossover_figure(matrix: Matrix, entries: Sequence[MatrixEntry]) -> Figure:
    """Success and energy of every method against the machines, a column per task."""
    from matplotlib.figure import Figure

    tasks = [t.env for t in matrix.tasks if any(e.task == t.env for e in entries)]
    machines = _machines(matrix, entries)
    place = {name: k for k, name in enumerate(dict.fromkeys(e.method for e in entries))}
    figure = Figure(figsize=(1.0 + 3.6 * len(tasks), 6.8), layout="constrained")
    axes = figure.subplots(2, len(tasks), squeeze=False, sharex="col")
    for column, task in enumerate(tasks):
        task_entries = [e for e in entries if e.task == task]
        methods = list(dict.fromkeys(e.method for e in task_entries))
        for k, method in enumerate(methods):
            of = {e.machine: e for e in task_entries if e.method == method}
            shift = 0.08 * (k - (len(methods) - 1) / 2)
            x = [i + shift for i in range(len(machines))]
            at = place[method]  # a method looks alike in every column
            look = {"marker": _MARKERS[at % len(_MARKERS)], "color": f"C{at % 10}"}
            successes = [of[m].success if m in of else None for m in machines]
            _draw(axes[0][column], x, successes, method, look)
            energies = [of[m].energy if m in of else None for m in machines]
            _draw(axes[1][column], x, energies, method, look)
        axes[0][column].set_title(task, fontsize=10)
        axes[0][column].set_ylim(-0.03, 1.03)
        _logarithmic(axes[1][column])
        axes[1][column].set_xticks(range(len(machines)), machines)
        for row in (0, 1):
            axes[row][column].grid(alpha=0.3)
            axes[row][column].tick_params(labelsize=8)
            axes[row][column].tick_params(axis="x", labelsize=7)  # six names in a row
        below = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.1), "frameon": False}
        labels = [fill(m, _LEGEND) for m in methods]  # wide legends would narrow the axes
        axes[1][column].legend(labels=labels, fontsize=7, ncols=2, **below)
    axes[0][0].set_ylabel("success", fontsize=9)
    axes[1][0].set_ylabel("E_mean over the first method's", fontsize=9)
    return figure


def _logarithmic(axes: Any) -> None:
    """A logarithmic scale with a few plain numbers, however little it spans."""
    from matplotlib.ticker import FormatStrFormatter, LogLocator, MaxNLocator, NullFormatter

    axes.set_yscale("log")
    low, high = axes.get_ylim()
    wide = high > _DECADE * low
    ticks = axes.yaxis
    ticks.set_major_locator(LogLocator(subs=(1, 2, 5)) if wide else MaxNLocator(5))
    ticks.set_major_formatter(FormatStrFormatter("%g"))
    ticks.set_minor_formatter(NullFormatter())


def _draw(
    axes: Any,
    x: Sequence[float],
    values: Sequence[Estimate | None],
    label: str,
    look: Mapping[str, str],
) -> None:
    """Values with their intervals; those that are missing or infinite leave gaps."""
    shown = [v if v is not None and v.value < float("inf") else _GAP for v in values]
    finite = [v.value for v in shown if v is not _GAP]
    if not finite:
        return
    y, top = [v.value for v in shown], 100 * max(finite)  # in place of an infinite end
    ends = [v.high if v.high < float("inf") else top for v in shown]
    low = [max(v.value - v.low, 0.0) for v in shown]
    high = [max(end - value, 0.0) for end, value in zip(ends, y, strict=True)]
    axes.errorbar(x, y, yerr=[low, high], label=label, markersize=4, capsize=2, lw=1.1, **look)
