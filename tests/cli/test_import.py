"""`--import`: what a file of one's own registers goes by its name in every command."""

import sys

import pytest

from ves_gym._util.own import CALLED, IMPORTED
from ves_gym.planners.registry import PLANNERS
from ves_gym.system.effect import EFFECTS

OWN = """
import numpy as np

class Mine:
    name, summary = "mine", "the straight line"

    def find(self, query, seed):
        return query.straight, {}

class Unfiled(Mine):
    summary = None

class Narrow(Mine):
    def find(self, query):
        return query.straight, {}

class Sized(Mine):
    def __init__(self, size):
        self.size = size

class Brake:
    name, privileged = "brake", True

    def reset(self, env, ids): ...

    def act(self, env, observation):
        return np.clip(-env.batch.scene.v, -1.0, 1.0)
"""
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
    (tmp_path / "own_file.py").write_text(OWN)
    yield tmp_path / "mine.py"
    IMPORTED.clear()
    CALLED.clear()
    for name in ("mine", "own_file"):
        sys.modules.pop(name, None)
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


@pytest.mark.parametrize("word", ["own_file:Mine", "own_file.py:Mine", "mine:Mine"])
def test_a_planner_goes_by_module_and_class(call, mine, word):
    """Of a file in the current folder, whether the file registers it or not."""
    status, _, err, plan = call("plan", "--goal", "20,10,10", "--planner", word)
    assert (status, err, plan["planner"]) == (0, "", "mine")


def test_processes_that_plan_know_it_too(call, mine):
    words = ("benchmark", "--planners", "own_file:Mine", "--durations", "4", "--first", "1")
    status, _, err, result = call(*words, "--no-figures", "--workers", 2)
    assert (status, err) == (0, "")
    rows = {row["planner"]: row["E_mean"] for row in result["rows"]}
    assert rows["mine"] == rows["straight"] is not None


def test_a_controller_goes_by_module_and_class(call, mine):
    """Its table is cut nowhere and no wider than 80 characters, as the benchmark's is."""
    words = ("evaluate", "PumaDamp-v0", "--episodes", "2", "--controller")
    status, out, err, _ = call(*words, "zero,own_file:Brake")
    assert (status, err) == (0, "") and "brake" in out
    assert max(map(len, out.split("written: ")[0].split("\n"))) <= 80 and "…" not in out


def test_installed_packages_bring_planners_and_controllers(call, mine):
    """By entry points, as a wheel's metadata has them."""
    about = mine.parent / "own-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: own\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(
        "[ves_gym.planners]\nfrom-package = own_file:Mine\n"
        "[ves_gym.controllers]\nbrakes = own_file:Brake\n"
    )
    sys.path.append(str(mine.parent))
    assert call("plan", "--goal", "20,10,10", "--planner", "from-package")[0] == 0
    words = ("evaluate", "PumaDamp-v0", "--episodes", "2", "--controller", "brakes")
    assert call(*words)[0] == 0
    for kind, word in (("planners", "from-package"), ("controllers", "brakes")):
        assert word in {row["name"] for row in call("list", kind)[3][kind]}


PLAN = ("plan", "--goal", "20,10,10", "--planner")
EVALUATE = ("evaluate", "PumaDamp-v0", "--controller")
REFUSED = [
    (PLAN, "nowhere:Mine", "cannot import nowhere: ModuleNotFoundError"),
    (PLAN, "own_file:Mime", 'own_file has nothing called Mime; did you mean "Mine"?'),
    (PLAN, "own_file:Sized", "cannot be made without arguments: TypeError: Sized.__init__()"),
    (PLAN, "own_file:Unfiled", "find(query, seed), got Unfiled without summary"),
    (PLAN, "own_file:Narrow", "got Narrow without find(query, seed)"),
    (PLAN, "own_file:Brake", "got Brake without summary"),
    (EVALUATE, "nowhere:Brake", "cannot import nowhere: ModuleNotFoundError"),
    (EVALUATE, "own_file:Mine", "a controller needs name, reset(env, ids) and"),
]


@pytest.mark.parametrize(("words", "word", "expected"), REFUSED)
def test_what_is_no_planner_or_controller_is_refused(refused, mine, words, word, expected):
    assert expected in refused(*words, word)
