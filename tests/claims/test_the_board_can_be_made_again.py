"""Claim: what stands on the committed board is what anybody gets who repeats it.

The page is that of the entries; one of them, another at every commit's
day, answers again and has its results: 95 % of planners' scores within 1 %, others to the
digits that a file holds.
"""

import json
import random
import re
from datetime import date
from pathlib import Path

import pytest

from ves_gym.leaderboard.board import make_board, read_board
from ves_gym.leaderboard.verify import verify_entry

PLACE = Path(__file__).parents[2] / "docs" / "leaderboard"


def test_the_page_is_that_of_the_entries():
    text = (PLACE / "index.html").read_text("utf-8")
    data = re.search(r'<script type="application/json"[^>]*>(.*?)</script>', text, re.S)
    board = make_board(read_board(PLACE / "entries"))
    assert json.loads(data[1]) == json.loads(json.dumps(board))
    assert board["tracks"] and not board["shown"]


@pytest.mark.slow
def test_an_entry_drawn_by_the_day_is_repeated():
    drawn = random.Random(date.today().toordinal())
    files = sorted((PLACE / "entries").glob("*.json"))
    # peers need libraries that are not installed here
    file = drawn.choice([file for file in files if "_peer_" not in file.name])
    assert verify_entry(file).level == "reproduced", file.name


def test_the_board_is_small():
    files = [p for p in PLACE.rglob("*") if p.is_file()]
    assert sum(p.stat().st_size for p in files) <= 3_000_000
