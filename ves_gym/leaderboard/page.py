"""The board as one HTML file: no server, no network, nothing beside it."""

from __future__ import annotations

import os
from typing import Any

from ves_gym._util.params import ParameterError, write_text
from ves_gym.leaderboard.board import SCHEMA
from ves_gym.report.pages import assemble, embedded, part
from ves_gym.report.planner_styles import css

_HERE = "ves_gym.leaderboard"


def write_page(board: dict[str, Any], path: str | os.PathLike[str]) -> None:
    """Write the page of a board, completely or not at all.

    Raises:
        ParameterError: another schema, or a number that JSON has not.
    """
    write_text(path, render_page(board))


def render_page(board: dict[str, Any]) -> str:
    """The text of the page: template, style, scripts and data in one."""
    if board.get("schema") != SCHEMA:
        raise ParameterError(
            f"board.schema must be {SCHEMA!r}, got {str(board.get('schema'))[:80]!r}"
        )
    parts = {
        "style": css() + part("page.css") + part("page.css", _HERE),
        "script": part("dom.js") + part("page.js", _HERE),
        "data": embedded(board),
    }
    return assemble(part("page.html", _HERE), parts)
