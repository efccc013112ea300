"""How far a command is: bars on a terminal, nothing in a pipe."""

from __future__ import annotations

import sys
from types import TracebackType
from typing import Any


class Bars:
    """What verbs take as `progress`: the last number it is called with is the fraction done.

    What stands before the fraction names a bar of its own, what is after it stands beside it.
    """

    def __init__(self, command: str) -> None:
        self.command = command
        self.bars: Any = None  # none before the first call
        self.tasks: dict[str, Any] = {}

    def __call__(self, *said: Any) -> None:
        if not sys.stderr.isatty():
            return
        at = max(k for k, word in enumerate(said) if isinstance(word, (int, float)))
        name = " ".join(map(str, (self.command, *said[:at])))
        note = " ".join(map(str, said[at + 1 :]))
        if self.bars is None:
            self.bars = _bars()
            self.bars.start()
        if name not in self.tasks:
            self.tasks[name] = self.bars.add_task(name, total=1.0, note=note)
        self.bars.update(self.tasks[name], completed=said[at], note=note)

    def __enter__(self) -> Bars:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self.bars is not None:
            self.bars.stop()


def _bars() -> Any:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}"),
    )
    return Progress(*columns, console=Console(stderr=True), transient=True)
