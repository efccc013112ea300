"""Pieces of the page of a diagnosis: tables, pictures, and numbers as text."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from ves_gym.report.figures import _DPI

if TYPE_CHECKING:
    from matplotlib.figure import Figure


STYLE = """
figure { margin: 0 0 1rem; }
figure img { display: block; width: 100%; background: #fff; border: 1px solid var(--line);
  border-radius: .5rem; }
figure.narrow { max-width: 48rem; }
figcaption { color: var(--soft); font-size: .875rem; margin: .4rem 0 0; max-width: 62rem; }
td.wrap { white-space: normal; min-width: 14rem; }
tr.chosen > * { font-weight: 650; }
pre { background: var(--card); border: 1px solid var(--line); border-radius: .5rem;
  padding: .7rem 1rem; overflow: auto; font-size: .82rem; line-height: 1.4;
  max-height: 30rem; }
ins { text-decoration: none; color: color-mix(in srgb, var(--s4) 60%, var(--ink)); }
del { text-decoration: none; color: color-mix(in srgb, var(--s5) 60%, var(--ink)); }
.scroll.narrow { max-width: 48rem; margin-bottom: 1rem; }
footer { padding-bottom: 2rem; }
"""


def picture(figure: Figure, words: str, caption: str, kind: str = "") -> str:
    """Put a figure into the page, with a caption and words in its place.

    Args:
        figure: drawn.
        words: what a reader gets who does not see it.
        caption: below it, markup.
        kind: class of the element.
    """
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=_DPI)
    data = base64.b64encode(buffer.getvalue()).decode("ascii")
    css = f' class="{kind}"' if kind else ""
    return (
        f'<figure{css}><img alt="{escaped(words)}" src="data:image/png;base64,{data}">'
        f"<figcaption>{caption}</figcaption></figure>\n"
    )


def table(
    head: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    numbers: Sequence[int] = (),
    wrap: Sequence[int] = (),
    marks: Sequence[str] = (),
    caption: str = "",
    kind: str = "",
) -> str:
    """Make a table that scrolls where it is wider than the page.

    Args:
        head: of the columns.
        rows: text of the cells.
        numbers: columns of numbers.
        wrap: columns whose text may go on below.
        marks: class of each row.
        caption: above it.
        kind: class of the element.
    """

    def cell(tag: str, k: int, text: str) -> str:
        css = " ".join(["number"] * (k in numbers) + ["wrap"] * (k in wrap))
        return (
            f"<{tag}{f' class={chr(34)}{css}{chr(34)}' if css else ''}>{escaped(text)}</{tag}>"
        )

    lines = [
        (f'<tr class="{marks[i]}">' if marks and marks[i] else "<tr>")
        + "".join(cell("td", k, text) for k, text in enumerate(row))
        + "</tr>"
        for i, row in enumerate(rows)
    ]
    top = "".join(cell("th", k, text) for k, text in enumerate(head))
    label = f"<caption>{escaped(caption)}</caption>" if caption else ""
    return (
        f'<div class="{f"scroll {kind}".strip()}"><table>{label}<thead><tr>{top}</tr></thead>'
        f"<tbody>{''.join(lines)}</tbody></table></div>\n"
    )


def interval_text(ends: Sequence[float] | None) -> str:
    """Write the ends of an interval, if there is one."""
    return "not known" if ends is None else f"{ends[0]:.5g} to {ends[1]:.5g}"


def value_text(name: str, value: float, unit: str) -> str:
    """Write a number with its name and unit."""
    return f"{name} {value:.3g} {unit_text(unit)}".rstrip()


def range_text(ends: Sequence[float]) -> str:
    """Write the ends of a range of gaps."""
    return f"{ends[0]:.2f} to {ends[1]:.2f}"


def share_text(p: float) -> str:
    """Write a share in percent."""
    return "> 99 %" if p > 0.99 else f"{100 * p:.0f} %"


def probability_text(p: float) -> str:
    """Write a probability."""
    return "> 0.999" if p > 0.999 else "< 0.001" if p < 0.001 else f"{p:.3f}"


def unit_text(unit: str) -> str:
    """Write a unit; nothing where there is none."""
    return "" if unit == "1" else unit


def escaped(text: str) -> str:
    """Return text that cannot become markup."""
    return html.escape(str(text), quote=True)
