"""Arms by the names of packages that hold robots of others."""

import re
import sys

import pytest

from tests.three_links import CHAIN, robot
from ves_gym._util.params import ParameterError
from ves_gym.mechanics.arm_library import get_arm
from ves_gym.system.system import System

DESCRIPTIONS = """
class Known:
    def __init__(self, robot, has_mjcf):
        self.robot, self.has_mjcf = robot, has_mjcf

DESCRIPTIONS = {
    "good_description": Known("Good", False),
    "good_mj_description": Known("Good", True),
    "macro_description": Known("Good", False),
    "far_description": Known("Far", False),
}
"""


@pytest.fixture
def descriptions(tmp_path, monkeypatch):
    """A package like robot_descriptions, whose robots lie here."""
    folder = tmp_path / "robot_descriptions"
    folder.mkdir()
    get_arm("ur5e").to_urdf(tmp_path / "good.urdf")
    get_arm("ur5e").to_mjcf(tmp_path / "good.xml")
    for name, text in {
        "__init__": DESCRIPTIONS,
        "good_description": f"print('Cloning')\nURDF_PATH = {str(tmp_path / 'good.urdf')!r}",
        "good_mj_description": f"MJCF_PATH = {str(tmp_path / 'good.xml')!r}",
        "macro_description": "XACRO_PATH = 'good.xacro'",
        "far_description": "raise OSError('could not resolve host')",
    }.items():
        (folder / f"{name}.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    for name in [k for k in sys.modules if k.startswith("robot_descriptions")]:
        monkeypatch.delitem(sys.modules, name)
    yield
    for name in [k for k in sys.modules if k.startswith("robot_descriptions")]:
        del sys.modules[name]


@pytest.mark.parametrize("name", ["good_description", "good_mj_description"])
def test_a_name_of_robot_descriptions_is_an_arm(descriptions, name, capsys):
    """Stands beside what the package itself has; what it prints is no answer."""
    file = {"good_description": "good.urdf", "good_mj_description": "good.xml"}[name]
    arm = get_arm(name)
    assert arm.n == 6 and get_arm(f"{name}#tool") == arm
    assert arm.source.startswith(f"read from {file}")
    assert capsys.readouterr().out == ""
    assert System(arm=name).arm == arm


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("god_description", 'did you mean "good_description"?: `python -m robot_desc'),
        ("macro_description", "is a xacro, no URDF: take good_mj_description, or make a URDF"),
        ("far_description", "robot_descriptions cannot fetch it: could not resolve host"),
    ],
)
def test_a_description_that_cannot_be_had_is_a_sentence(descriptions, name, said):
    with pytest.raises(ParameterError, match=re.escape(said)):
        get_arm(name)


def test_a_description_without_the_package_says_what_to_install(monkeypatch):
    monkeypatch.setattr("ves_gym._util.optional.installed", lambda module: False)
    with pytest.raises(ParameterError, match=r"pip install 'ves-gym\[robots\]'"):
        get_arm("panda_description")


def test_a_name_of_example_robot_data_is_an_arm(tmp_path, monkeypatch):
    """A distribution of files alone, found by its list of these."""
    files = ["share/robots/one/slim.urdf", "share/robots/one/twin.urdf", "share/two/twin.urdf"]
    for name in files:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(robot(CHAIN))
    about = tmp_path / "example_robot_data-6.0.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: example-robot-data\n")
    (about / "RECORD").write_text("".join(f"{name},,\n" for name in files))
    monkeypatch.syspath_prepend(tmp_path)
    assert get_arm("slim").links == get_arm(tmp_path / files[0]).links
    assert get_arm("slim#l2").n == 2
    with pytest.raises(ParameterError, match=r"twin is several files: take one of .*two/twin"):
        get_arm("twin")
    with pytest.raises(ParameterError, match="arm must be one of"):
        get_arm("thin")
