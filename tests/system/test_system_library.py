"""Systems by name."""

import pytest

from ves_gym._util.params import ParameterError
from ves_gym.envs.build import build_task
from ves_gym.system.system import System
from ves_gym.system.system_library import SYSTEMS, get_system


@pytest.mark.parametrize(("name", "joints", "bends"), [
    ("macro-micro", 9, 10),
    ("macro-micro-braked", 6, 13),
    ("macro-micro-reduced", 6, 0),
])  # fmt: skip
def test_shipped_systems_survive_files(name, joints, bends, tmp_path):
    system = get_system(name)
    assert (system.arm.n, system.arm.bends) == (joints, bends)
    system.save(tmp_path / "system.toml")
    assert (
        get_system(tmp_path / "system.toml") == system == System.load(tmp_path / "system.toml")
    )


def test_every_shipped_system_is_checked():
    assert sorted(SYSTEMS) == ["macro-micro", "macro-micro-braked", "macro-micro-reduced"]


def test_an_environment_takes_one():
    assert build_task("track", system="macro-micro-reduced").system.arm.n == 6
    with pytest.raises(ParameterError, match="task track takes links for rigid"):
        build_task("track", system="macro-micro")


def test_an_unknown_name_is_refused():
    with pytest.raises(
        ParameterError, match=r"system must be one of macro-micro,.*did you mean"
    ):
        get_system("macro-mikro")
