"""docs/laboratory-cost.md is what scripts/laboratory_cost.py makes of its data."""

import importlib.util
import json
from pathlib import Path

import numpy as np

from ves_gym.leaderboard.protocol import ENVIRONMENTS

ROOT = Path(__file__).parents[2]


def script():
    path = ROOT / "scripts" / "laboratory_cost.py"
    spec = importlib.util.spec_from_file_location("laboratory_cost", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_page_is_up_to_date_and_holds_every_environment():
    """Else: `python scripts/laboratory_cost.py`."""
    cost = script()
    cells = json.loads(cost.DATA.read_text("utf-8"))
    assert cost.PAGE.read_text("utf-8") == cost.page(cells, 100)
    assert set(cost.SHIPPED) == set(ENVIRONMENTS)


def test_a_cell_is_the_episodes_of_its_environment():
    """Five of its hundred, run again: to the digits that are stored."""
    cost = script()
    cells = json.loads(cost.DATA.read_text("utf-8"))
    place = "PumaRestToRest", "straight-horizontal-thesis", "zero"
    for where in ("ideal", "lab"):
        again = cost._run(*place, where, 5)
        stored = cells[" ".join((*place, where))]
        np.testing.assert_allclose(again["E_mean"], stored["E_mean"][:5], rtol=2e-5)
        assert again["success"] == stored["success"][:5]
