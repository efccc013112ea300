"""docs/laboratory-cost.md is what scripts/laboratory_cost.py makes of its data."""

import json

import numpy as np

from scripts import laboratory_cost as cost


def test_the_page_is_up_to_date():
    """Else: `python scripts/laboratory_cost.py`."""
    cells = json.loads(cost.DATA.read_text("utf-8"))
    assert cost.PAGE.read_text("utf-8") == cost.page(cells, 100)


def test_a_cell_is_the_episodes_of_its_environment():
    """Five of its hundred, run again: to the digits that are stored."""
    cells = json.loads(cost.DATA.read_text("utf-8"))
    place = "PumaRestToRest", "straight-horizontal-thesis", "zero"
    for where in ("ideal", "lab"):
        again = cost._run(*place, where, 5)
        stored = cells[" ".join((*place, where))]
        np.testing.assert_allclose(again["E_mean"], stored["E_mean"][:5], rtol=2e-5)
        assert again["success"] == stored["success"][:5]
