"""One HTML file per page, with nothing to load beside it; tables and numbers as text.

A page is `frame.html` around the template of its kind, whose places {{name}} are filled; data
stand in it as JSON, and scripts draw them.
"""

from __future__ import annotations

import html
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from importlib.resources import files
from typing import Any

from ves_gym._util.params import ParameterError, to_plain
from ves_gym.report.planner_styles import COLOURS, DARK, DASHES, OTHERS, STYLES


def page(
    template: str,
    *,
    title: str,
    styles: Sequence[str] = (),
    scripts: Sequence[str] = (),
    data: Any = None,
    **parts: str,
) -> str:
    """Return the text of a page.

    Args:
        template: file of its body, as "report/page.html".
        title: of the window.
        styles: style sheets beside the one that all pages have.
        scripts: files that become one module, in this order; none: the page runs nothing.
        data: what they find in the element `data`.
        parts: markup for the places of the template.
    """
    end = ""
    if scripts:
        module = "\n".join(map(part, scripts))
        if "report/drawing.js" in scripts:
            module = f"{_style_constants()}{module}"
        end = (
            f'<script type="application/json" id="data">{embedded(data)}</script>\n'
            f'<script type="module">\n{module}\n</script>\n'
        )
    return _assembled(
        part("report/frame.html"),
        {
            "title": escaped(title),
            "allowed": "script-src 'unsafe-inline'" if scripts else "img-src data:",
            "style": _palette() + "".join(map(part, ("report/page.css", *styles))),
            "body": _assembled(part(template), parts),
            "scripts": end,
        },
    )


def part(name: str) -> str:
    """Read a template, style sheet or script of the package, as "report/page.css"."""
    return files("ves_gym").joinpath(name).read_text(encoding="utf-8")


def _assembled(template: str, parts: Mapping[str, str]) -> str:
    """Fill the places, in one pass: what looks like a place inside a part stays as it is."""
    return re.sub(r"\{\{(\w+)\}\}", lambda match: parts[match[1]], template)


def embedded(data: Any) -> str:
    """JSON that cannot end or disturb the script element it stands in."""
    try:
        text = json.dumps(to_plain(data), separators=(",", ":"), allow_nan=False)
    except ValueError as error:
        raise ParameterError(f"the result must be finite to become a page: {error}") from None
    return text.replace("<", "\\u003c")  # thereby no `</` and no `<!--`


def require_schema(result: Mapping[str, Any], schema: str, name: str = "result") -> None:
    """Raise a ParameterError where data are of another kind than the page."""
    if result.get("schema") != schema:
        actual = str(result.get("schema"))[:80]
        raise ParameterError(f"{name}.schema must be {schema!r}, got {actual!r}")


def _palette() -> str:
    """Colours of planners as variables --s0, --s1, ... of a style sheet, both schemes."""
    light, dark = (
        " ".join(f"--s{k}: {colour};" for k, colour in enumerate(palette))
        for palette in (COLOURS, DARK)
    )
    return (
        f":root {{ {light} }}\n@media (prefers-color-scheme: dark) {{ :root {{ {dark} }} }}\n"
    )


def _style_constants() -> str:
    """The table for `drawing.js`: STYLES[planner] is [place in the palette, dash]."""
    return (
        f"const STYLES = {embedded(STYLES)};\n"
        f"const OTHER_STYLES = {embedded(OTHERS)};\n"
        f"const DASHES = {embedded(DASHES)};\n"
    )


# ---------------------------------------------------------------------------- text


def escaped(text: object) -> str:
    """Return text that cannot become markup."""
    return html.escape(str(text), quote=True)


def html_table(
    head: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    numbers: Sequence[int] = (),
    wrap: Sequence[int] = (),
    bold: Sequence[bool] = (),
    caption: str = "",
    kind: str = "",
) -> str:
    """Make a table of a class `kind` that scrolls where it is wider than the page, with columns
    of `numbers` and columns whose text may `wrap`, and rows that are `bold`."""

    def cells(tag: str, texts: Sequence[str]) -> str:
        classes = [
            " ".join(["number"] * (k in numbers) + ["wrap"] * (k in wrap))
            for k in range(len(texts))
        ]
        return "".join(
            f'<{tag} class="{css}">{escaped(text)}</{tag}>'
            for css, text in zip(classes, texts, strict=True)
        )

    lines = [
        f'<tr class="{"chosen" if i < len(bold) and bold[i] else ""}">{cells("td", row)}</tr>'
        for i, row in enumerate(rows)
    ]
    label = f"<caption>{escaped(caption)}</caption>" if caption else ""
    return (
        f'<div class="scroll {kind}"><table>{label}<thead><tr>{cells("th", head)}</tr></thead>'
        f"<tbody>{''.join(lines)}</tbody></table></div>\n"
    )


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Make a table of Markdown; cells hold no bars."""
    lines = [f"| {' | '.join(row)} |" for row in (head, *rows)]
    return "\n".join([lines[0], "|" + "---|" * len(head), *lines[1:]])


def estimate_text(value: float | None, low: float | None, high: float | None, form: str) -> str:
    """Write an estimate and its interval; "-" where there is none, None at an end is no end."""
    if value is None:
        return "-"
    ends = ("inf" if end is None else format(end, form) for end in (low, high))
    return f"{value:{form}} ({' to '.join(ends)})"
