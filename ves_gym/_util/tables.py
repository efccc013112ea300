"""Tables as text, for results that print themselves."""

from __future__ import annotations

import io
import sys
from collections.abc import Iterable, Sequence

WIDTH = 120  # characters, where nothing says how wide the output is


def table(
    head: Sequence[str],
    rows: Iterable[Sequence[object] | None],
    *,
    title: str = "",
    left: Sequence[int] = (0,),
    width: int = WIDTH,
) -> str:
    """Return rows as text in columns, as wide as the terminal where there is one, `width` in a
    pipe.

    Columns of `left` begin at their left side; the others are of numbers. A row that is None is
    a line between two; without names of the columns the table has no head.
    """
    from rich.console import Console
    from rich.table import Table

    out = Table(title=title or None, show_header=bool(head))
    for k, name in enumerate(head):
        out.add_column(name, justify="left" if k in left else "right", overflow="fold")
    for row in rows:
        if row is None:
            out.add_section()
        else:
            out.add_row(*map(str, row))
    page = io.StringIO()
    wide = Console().width if sys.stdout.isatty() else width
    console = Console(file=page, width=wide, markup=False, emoji=False, highlight=False)
    if console.measure(out, options=console.options.update_width(10_000)).maximum > wide:
        out.padding = (0, 0)
    console.print(out)
    return page.getvalue().rstrip("\n")
