"""The matrix as a page of Markdown: a small table per question."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from ves_gym.experiments.matrix import Matrix, MatrixEntry
from ves_gym.report.pages import markdown_table


def matrix_page(matrix: Matrix, entries: Sequence[MatrixEntry], title: str) -> str:
    """Return the page: how often, and at what energy, methods down, machines across."""
    widest = max(e.success.high - e.success.low for e in entries) / 2
    return "\n\n".join(
        [
            f"# {title}",
            _what(matrix),
            "## How many of 100 episodes are solved",
            _table(matrix, entries, lambda e: f"{100 * e.success.value:.0f}"),
            "## At what energy",
            "E_mean over that of a task's first method in the same episode, interquartile"
            " mean.",
            _table(matrix, entries, lambda e: f"{e.energy.value:.2g}" if e.energy else "-"),
            f"95 % intervals of the shares are within {100 * widest:.0f} points to either side"
            " (Wilson); those of every number, and returns, are in `--json`.",
        ]
    )


def _what(matrix: Matrix) -> str:
    count = len(matrix.seeds) * matrix.episodes
    fewer = [
        f"{task.env} {method.name} {len(matrix.seeds) * matrix.episodes_of(method)}"
        for task in matrix.tasks
        for method in task.methods
        if matrix.episodes_of(method) < matrix.episodes
    ]
    slow = f" Fewer, the first of them, for what is slow: {', '.join(fewer)}." * bool(fewer)
    machines = "\n".join(
        f"- **{m.name}**: {'emulated' if m.emulated else 'in space'}"
        + (f", {_plain(m.settings)}" if m.settings else "")
        for m in matrix.machines
    )
    return f"{count} episodes in every cell, the same for all methods.{slow}\n\n{machines}"


def _plain(settings: Mapping[str, Any]) -> str:
    return ", ".join(
        f"{k} ({_plain(v)})" if isinstance(v, Mapping) else f"{k} {v}"
        for k, v in settings.items()
    )


def _table(
    matrix: Matrix, entries: Sequence[MatrixEntry], figure: Callable[[MatrixEntry], str]
) -> str:
    by = {(e.task, e.method, e.machine): figure(e) for e in entries}
    machines = [machine.name for machine in matrix.machines]
    rows: list[list[str]] = []
    for task in matrix.tasks:
        rows.append([f"**{task.env}**", *("" for _ in machines)])
        for method in task.methods:
            cells = [by[task.env, method.name, machine] for machine in machines]
            rows.append([method.name, *cells])
    return markdown_table(("", *machines), rows)
