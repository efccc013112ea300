"""`Viewable`: a result that draws itself and shows itself in a notebook.

How each class looks is defined in one file (`report/views.py`), which is loaded when the first
picture is drawn: the class knows nothing of matplotlib, and its room imports nothing above
itself.
"""

from __future__ import annotations

import html
from collections.abc import Iterable
from functools import singledispatch
from typing import Any

from ves_gym._util.on_demand import load
from ves_gym._util.params import ParameterError


@singledispatch
def draw(result: Any, ax: Any, **options: Any) -> Any:
    """Draw a result into matplotlib axes, or a new figure's, and return them; one function per
    class."""
    raise ParameterError(f"{type(result).__name__} has no picture")


@singledispatch
def facts(result: Any) -> Iterable[tuple[str, str]]:
    """Return rows (name, value) of the table that a notebook shows under the title."""
    return ()


@singledispatch
def picture(result: Any) -> str | None:
    """Return the drawing of a result as base64 PNG, or None where it cannot be drawn."""
    return None


class Viewable:
    """A result with `plot` and a notebook view; its `repr` is the view's title."""

    def plot(self, ax: Any = None, **options: Any) -> Any:
        """Draw into matplotlib axes (a new figure without them) and return the axes.

        Args:
            ax: matplotlib axes, as many as the picture has panels; None for a new figure.
            options: of the class, see `docs/api.md`.

        Raises:
            ParameterError: matplotlib is not installed, or the number of axes is another one.
        """
        load("views")
        return draw(self, ax, **options)

    def _repr_html_(self) -> str:
        load("views")
        rows = "".join(
            f"<tr><td>{html.escape(name)}</td><td>{html.escape(value)}</td></tr>"
            for name, value in facts(self)
        )
        image = picture(self)
        title = html.escape(repr(self).strip("<>"))
        return (
            f"<div><p><b>{title}</b></p>"
            + (f"<table>{rows}</table>" if rows else "")
            + (f'<img alt="{title}" src="data:image/png;base64,{image}">' if image else "")
            + "</div>"
        )
