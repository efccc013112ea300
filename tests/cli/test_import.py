"""`--import`: what a file of one's own registers goes by its name in every command."""

import sys

import pytest

from ves_gym._util.own import IMPORTED
from ves_gym.planners.registry import PLANNERS
from ves_gym.system.effect import EFFECTS

MINE = '''
import numpy as np
import ves_gym as vg

@vg.register_planner
class Mine:
    name, summary = "mine", "the straight line"

    def find(self, query, seed):
        return query.straight, {}

@vg.register_effect("joint/mine")
class Drag(vg.effects.TorqueEffect):
    """Drag that grows with the angle."""

    drag: tuple[float, ...] = vg.parameter("N m/rad^2", bounds=(0.0, 50.0), shape=(None,))

    def law(self, q, v, tau):
        return -self.drag * q**2 * np.tanh(v / 0.01)
'''


@pytest.fixture
def mine(tmp_path, monkeypatch):
    """Path of a file with a planner and an effect, neither known before or after."""
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "mine.py").write_text(MINE)
    yield tmp_path / "mine.py"
    IMPORTED.clear()
    sys.modules.pop("mine", None)
    PLANNERS.pop("mine", None)
    EFFECTS.pop("joint/mine", None)


def test_planner_and_effect_have_their_names(call, mine):
    words = ("plan", "--goal", "20,10,10", "--planner", "mine", "--import", mine)
    status, out, err, plan = call(*words, "--effect", "joint/mine:drag=0,5,0")
    assert (status, err, plan["planner"]) == (0, "", "mine")
    assert f"next: ves-gym simulate --case {mine.parent}/out/case.toml --import {mine}" in out


def test_processes_that_plan_import_it_too(call, mine):
    words = ("benchmark", "--planners", "straight,mine", "--durations", "4", "--first", "1")
    status, _, err, result = call(*words, "--no-figures", "--workers", 2, "--import", "mine")
    assert (status, err) == (0, "")
    rows = {row["planner"]: row["E_mean"] for row in result["rows"]}
    assert rows["mine"] == rows["straight"]


@pytest.mark.parametrize(
    ("text", "named", "said"),
    [
        ("import nope", "bad.py", "No module named 'nope' (bad.py, line 1)"),
        ("x = 1\ny = z", "bad.py", "NameError: name 'z' is not defined (bad.py, line 2)"),
        ("x = 1\ny = x +", "bad.py", "SyntaxError: invalid syntax (bad.py, line 2)"),
        ("", "missing.py", "No module named 'missing'"),
        ("", "json.py", "json/__init__.py; rename the file"),
    ],
)
def test_what_cannot_be_imported_is_one_line(refused, mine, text, named, said):
    (mine.parent / ("json.py" if named == "json.py" else "bad.py")).write_text(text)
    err = refused("plan", "--goal", "20,10,10", "--import", named)
    assert f"cannot import {named}: " in err and said in err
