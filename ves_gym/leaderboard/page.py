"""The board as one HTML file: no server, no network, nothing beside it."""

from __future__ import annotations

import os
from typing import Any

from ves_gym._util.params import write_text
from ves_gym.leaderboard.board import SCHEMA
from ves_gym.report.pages import page, require_schema


def write_page(board: dict[str, Any], path: str | os.PathLike[str]) -> None:
    """Write the page of a board, completely or not at all.

    Raises:
        ParameterError: another schema, or a number that JSON has not.
    """
    write_text(path, render_page(board))


def render_page(board: dict[str, Any]) -> str:
    """The text of the page."""
    require_schema(board, SCHEMA, "board")
    return page(
        "leaderboard/page.html",
        title="Leaderboard of ves_gym",
        styles=("leaderboard/page.css",),
        scripts=("report/dom.js", "leaderboard/page.js"),
        data=board,
    )
