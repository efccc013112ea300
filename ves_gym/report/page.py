"""The benchmark as one HTML file: no server, no network, nothing beside it."""

from __future__ import annotations

import html
import os
from typing import Any

from ves_gym._util.params import ParameterError, write_text
from ves_gym.report.pages import assemble, embedded, part
from ves_gym.report.planner_styles import css, script

SCHEMA = "ves-benchmark/1"
_SCRIPTS = (
    "dom.js",
    "drawing.js",
    "page.js",
    "tables.js",
    "charts.js",
    "scene.js",
    "platform.js",
    "player.js",
    "scenes.js",
)  # one module, in this order


def write_page(result: dict[str, Any], path: str | os.PathLike[str]) -> None:
    """Write the HTML report of a benchmark result, completely or not at all.

    Raises:
        ParameterError: the result has another schema, or holds a number JSON has not.
    """
    write_text(path, render_page(result))


def render_page(result: dict[str, Any]) -> str:
    """The text of the page: template, style, scripts and data in one."""
    if result.get("schema") != SCHEMA:
        raise ParameterError(f"result.schema must be {SCHEMA!r}, got {result.get('schema')!r}")
    parts = {
        "title": html.escape(f"Energy in the base: {result.get('suite', 'benchmark')}"),
        "style": css() + part("page.css"),
        "scene_controls": part("scene_controls.html"),
        "script": "\n".join([script(), *(part(name) for name in _SCRIPTS)]),
        "data": embedded(result),
    }
    return assemble(part("page.html"), parts)
