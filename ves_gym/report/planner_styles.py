"""One colour and stroke per planner, in every figure and on every page.

The only table of colours: figures read it, and `pages` puts it into every page.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

# Palette, light and dark scheme; the first is the straight line's. The colour-blind see any two
# of them as different (tests/report/test_planner_styles.py).
COLOURS = ("#7b828c", "#c8541a", "#9e47e7", "#0a7bb5", "#1f8a58", "#b3316d", "#6c571c")
DARK = ("#9aa3ad", "#dd7e3e", "#de5df3", "#8ec9f4", "#60f09b", "#fa4675", "#f7cf45")
DASHES = ("", "8 3", "2.5 2.5", "10 3 2 3")  # as in SVG


class Style(NamedTuple):
    """Colour and stroke of a planner."""

    colour: int  # place in the palette
    dash: str = ""  # lengths of strokes and gaps; solid without


STYLES: dict[str, Style] = {
    "straight": Style(0),
    "smooth-jerk": Style(0, DASHES[1]),
    "hotspot-q": Style(1),
    "bad-path": Style(1, DASHES[2]),
    "hotspot-qt": Style(2),
    "reaction-null": Style(2, DASHES[2]),
    "calm": Style(6),
    "direct": Style(3),
    "damp": Style(3, DASHES[1]),
    "refined": Style(4),
    "refined-long": Style(4, DASHES[1]),
    "robust": Style(4, DASHES[2]),
    "robust-worst": Style(4, DASHES[3]),
    "ompl-qt": Style(5),
    "ompl-q": Style(5, DASHES[1]),
    "ompl-time": Style(5, DASHES[2]),
    "shaped-zv": Style(0, DASHES[2]),
    "shaped-zvd": Style(0, DASHES[3]),
}
OTHERS = [Style(k, dash) for dash in (DASHES[3], DASHES[2]) for k in (6, 3, 4, 1, 2)]


def style_of(planner: str, names: Sequence[str] = ()) -> Style:
    """Return how a planner is drawn; one that the table does not have takes a style that none
    of it has, by its place among all that are drawn together."""
    if planner in STYLES:
        return STYLES[planner]
    unlisted = [name for name in names if name not in STYLES]
    place = unlisted.index(planner) if planner in unlisted else 0
    return OTHERS[place % len(OTHERS)]


def colour_of(planner: str, names: Sequence[str] = ()) -> str:
    """Return the colour of a planner in the light scheme, as `style_of` finds it."""
    return COLOURS[style_of(planner, names).colour]


def line_style(planner: str, names: Sequence[str] = ()) -> dict[str, Any]:
    """Return colour and stroke as matplotlib's keywords, as `style_of` finds them."""
    style = style_of(planner, names)
    if not style.dash:
        return {"color": COLOURS[style.colour], "linestyle": "-"}
    lengths = tuple(float(length) / 2 for length in style.dash.split())
    return {"color": COLOURS[style.colour], "linestyle": (0, lengths)}
