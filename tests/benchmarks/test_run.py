"""Every part of `make bench` runs, at its smallest size, and gives figures."""

import json

import pytest

from benchmarks.run import PARTS

LONG = {"environments", "kernel", "resets", "startup", "training"}  # seconds each


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    "name", [pytest.param(k, marks=pytest.mark.slow) if k in LONG else k for k in PARTS]
)
def test_a_part_runs(name, capsys):
    figures = PARTS[name](small=True)
    assert figures and json.dumps(figures, default=float)
    assert capsys.readouterr().out
