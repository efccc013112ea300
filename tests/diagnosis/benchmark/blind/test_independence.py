"""The generator shares no physics with what it is used to judge."""

import ast
from pathlib import Path

import pytest

import ves_gym.diagnosis.benchmark.blind

PACKAGE = Path(ves_gym.diagnosis.benchmark.blind.__file__).parent
ROOT = PACKAGE.parents[2]
SHARED = {
    "ves_gym._util.optional",
    "ves_gym._util.on_demand",
    "ves_gym._util.params",
    "ves_gym._util.suggest",
    "ves_gym._util.views",
    "ves_gym.system.runlog",
    "ves_gym.system.runlog_files",
}
# what `machine.py` may read: the description, from which it copies numbers
NOMINAL = ("ves_gym._util.", "ves_gym.mechanics.", "ves_gym.hardware.", "ves_gym.system.")
OUTSIDE = {"numpy", "scipy", "numba"}
STANDARD = {
    "__future__",
    "collections",
    "functools",
    "hashlib",
    "math",
    "os",
    "pathlib",
    "secrets",
    "typing",
}


def imported(path):
    """Dotted names that one file imports."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name}: say ves_gym, not a relative import"
            yield node.module
            if node.module in ("ves_gym", "ves_gym.diagnosis", "ves_gym.diagnosis.benchmark"):
                yield from (f"{node.module}.{alias.name}" for alias in node.names)


@pytest.mark.parametrize("path", sorted(PACKAGE.glob("*.py")), ids=lambda p: p.name)
def test_file_imports_nothing_of_simulator_or_selector(path):
    for name in imported(path):
        top = name.partition(".")[0]
        own = (
            name.startswith("ves_gym.diagnosis.benchmark.blind") or name == "ves_gym.diagnosis"
        )
        nominal = path.name == "machine.py" and name.startswith(NOMINAL)
        fine = top in OUTSIDE | STANDARD or name in SHARED or own or nominal
        assert fine, f"{path.name} imports {name}"


def test_what_is_shared_brings_no_physics_along():
    for name in SHARED:
        path = ROOT / Path(*name.split(".")[1:]).with_suffix(".py")
        for other in imported(path):
            if other.startswith("ves_gym"):
                assert other in SHARED, f"{name} imports {other}"


def test_only_machine_knows_systems():
    for path in PACKAGE.glob("*.py"):
        if path.name != "machine.py":
            assert "ves_gym.diagnosis.benchmark.blind.machine" not in set(imported(path)), (
                path.name
            )
