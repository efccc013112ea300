"""`doctor`: finds what is broken, and stays quiet about what is not."""

import pytest

from ves_gym.cli import doctor
from ves_gym.cli.doctor import FAIL, NOTE, OK


def test_this_machine_runs_the_core(call):
    status, out, _, result = call("doctor")
    assert status == 0 and result["ok"] and "the core works" in out
    assert result["schema"] == "ves-doctor/1"
    found = {check["name"]: check for check in result["checks"]}
    for name in ("python", "mujoco", "import pinocchio", "import ompl.geometric"):
        assert found[name]["status"] == OK
    assert "us per physics step" in found["batch stepping"]["detail"]
    assert found["OpenGL"]["status"] in (OK, NOTE) and "MUJOCO_GL" in found["OpenGL"]["detail"]
    assert found["extra report"]["status"] in (OK, NOTE)


def test_a_core_failure_is_a_negative_verdict(call, monkeypatch):
    bad = doctor.Check("import mujoco", FAIL, "crashes with signal 4")
    monkeypatch.setattr(doctor, "_checks", lambda out: [(1.0, bad)])
    status, out, _, result = call("doctor")
    assert status == 1 and not result["ok"] and "import mujoco" in out


@pytest.mark.parametrize(
    ("version", "ranges", "expected"),
    [
        ("4.0.0", ">=4.0,<5", True),
        ("3.9.9", ">=4.0,<5", False),
        ("5", ">=4.0,<5", False),
        ("2.0.1", ">=2.0.1,<3", True),
        ("2.0", ">=2.0.1,<3", False),
        ("2.10.0+cpu", ">=2.4", True),
        ("1.0", "", True),
    ],
)
def test_version_ranges(version, ranges, expected):
    assert doctor.inside(version, ranges) is expected


def test_missing_and_old_packages_are_named():
    missing = doctor.check_version("no-such-package>=1.0")
    assert missing.status == FAIL and "pip install 'no-such-package>=1.0'" in missing.detail
    old = doctor.check_version("numpy>=99")
    assert old.status == FAIL and "needs >=99" in old.detail
    extra = doctor.check_extra("dreams", ["numpy>=1", "no-such-package>=1.0"])
    assert extra.status == NOTE and "ves-gym[dreams]" in extra.detail


@pytest.mark.parametrize(
    ("marker", "expected"),
    [
        ("", True),
        ("sys_platform == 'linux'", True),
        ("sys_platform != 'win32'", True),
        ("(sys_platform == 'linux' and python_version < '3.14')", False),
        ('python_version >= "3.9"', True),
    ],
)
def test_environment_markers(marker, expected, monkeypatch):
    monkeypatch.setattr(doctor.sys, "platform", "linux")
    monkeypatch.setattr(doctor.platform, "python_version", lambda: "3.14.0")
    assert doctor.applies(marker) is expected


def test_every_declared_marker_is_understood():
    core, extras, _ = doctor.requirements()
    texts = [*core, *(text for extra in extras.values() for text in extra)]
    markers = [text.partition(";")[2] for text in texts if ";" in text]
    assert len(markers) == 2
    for marker in markers:
        doctor.applies(marker)
    with pytest.raises(ValueError, match="got \"os_name == 'nt'\""):
        doctor.applies("os_name == 'nt'")


def test_a_package_without_wheels_here_is_no_failure():
    check = doctor.check_version("no-such-package>=1.0; sys_platform == 'plan9'")
    assert check.status == NOTE and "sys_platform == 'plan9'" in check.detail


def test_requirements_of_an_installed_wheel(monkeypatch, tmp_path):
    """Without pyproject.toml: the core, each extra, and where a package is asked for."""
    monkeypatch.setattr(doctor, "_ROOT", tmp_path)
    lines = [
        "numpy<3,>=2.0",
        "ompl<3,>=2.0.1; sys_platform == 'linux' and python_version < '3.14'",
        "pin<5,>=4.0; (sys_platform != 'win32') and extra == 'pinocchio'",
        "pyarrow>=17; extra == 'parquet'",
        "pyarrow>=17; extra == 'dev'",
    ]
    monkeypatch.setattr(doctor.importlib.metadata, "requires", lambda name: lines)
    core, extras, python = doctor.requirements()
    assert core == lines[:2] and python.startswith(">=3")
    assert extras == {
        "pinocchio": ["pin<5,>=4.0; sys_platform != 'win32'"],
        "parquet": ["pyarrow>=17"],
    }


@pytest.mark.parametrize(
    ("code", "expected"),
    [
        ("import os; os.abort()", "crashes with signal 6"),
        ("import time; time.sleep(60)", "hangs"),
        ("import no_such_module", "ModuleNotFoundError"),
    ],
)
def test_a_library_that_crashes_or_hangs_is_reported(code, expected):
    good, words = doctor._child(code, timeout=0.5 if expected == "hangs" else 20.0)
    assert not good and expected in words


def test_a_setting_that_stops_mujoco_from_loading_is_named(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "nonsense")
    check = doctor.check_import("mujoco", "mujoco")
    assert check.status == FAIL and "MUJOCO_GL is 'nonsense'" in check.detail
    assert doctor.check_opengl().status == NOTE


def test_a_folder_that_cannot_be_written_fails(tmp_path, monkeypatch):
    assert doctor.check_folder(tmp_path / "new" / "deeper").status == OK

    def refuse(**options):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(doctor.tempfile, "NamedTemporaryFile", refuse)
    assert doctor.check_folder(tmp_path).status == FAIL
