"""The benchmark as one HTML file: no server, no network, nothing beside it."""

from __future__ import annotations

import html
import json
import os
import re
from importlib.resources import files
from typing import Any

from ves_gym.core.params import ParameterError, to_plain, write_text

SCHEMA = "ves-benchmark/1"
_SCRIPTS = (
    "page.js",
    "tables.js",
    "charts.js",
    "scene.js",
    "player.js",
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
        "style": _read("page.css"),
        "script": "\n".join(_read(name) for name in _SCRIPTS),
        "data": _embedded(result),
    }
    # in one pass: text that looks like a placeholder inside the data stays as it is
    return re.sub(r"\{\{(\w+)\}\}", lambda match: parts[match[1]], _read("page.html"))


def _embedded(result: dict[str, Any]) -> str:
    """JSON that cannot end or disturb the script element it stands in."""
    try:
        text = json.dumps(to_plain(result), separators=(",", ":"), allow_nan=False)
    except ValueError as error:
        raise ParameterError(f"the result must be finite to become a page: {error}") from None
    return text.replace("<", "\\u003c")  # thereby no `</` and no `<!--`


def _read(name: str) -> str:
    return files("ves_gym.report").joinpath(name).read_text(encoding="utf-8")
