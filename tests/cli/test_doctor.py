"""`doctor`: finds what is broken, and stays quiet about what is not."""

import pytest
from packaging.requirements import Requirement

from ves_gym.cli import doctor
from ves_gym.cli.doctor import FAIL, NOTE, OK
from ves_gym.rendering.opengl import attempt


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


def test_missing_and_old_packages_are_named():
    missing = doctor.check_version(Requirement("no-such-package>=1.0"))
    assert missing.status == FAIL and "pip install 'no-such-package>=1.0'" in missing.detail
    old = doctor.check_version(Requirement("numpy>=99"))
    assert old.status == FAIL and "needs >=99" in old.detail
    needed = [Requirement("numpy>=1"), Requirement("no-such-package>=1.0")]
    extra = doctor.check_extra("dreams", needed)
    assert extra.status == NOTE and "ves-gym[dreams]" in extra.detail
    elsewhere = Requirement("no-such-package>=1.0; sys_platform == 'plan9'")
    check = doctor.check_version(elsewhere)  # without wheels here it is no failure
    assert check.status == NOTE and 'sys_platform == "plan9"' in check.detail


def test_requirements_are_those_of_the_installed_package(monkeypatch):
    """The core, each extra, and where a package is asked for."""
    lines = [
        "numpy<3,>=2.0",
        "ompl<3,>=2.0.1; sys_platform == 'linux' and python_version < '3.14'",
        "pin<5,>=4.0; (sys_platform != 'win32') and extra == 'pinocchio'",
        "pyarrow>=17; extra == 'parquet'",
        "pyarrow>=17; extra == 'dev'",
    ]
    monkeypatch.setattr(doctor.importlib.metadata, "requires", lambda name: lines)
    core, extras, python = doctor.requirements()
    assert [r.name for r in core] == ["numpy", "ompl"] and python.startswith(">=3")
    assert {k: [r.name for r in v] for k, v in extras.items()} == {
        "pinocchio": ["pin"],
        "parquet": ["pyarrow"],
    }


@pytest.mark.parametrize(
    ("code", "expected"),
    [
        ("import os; os.abort()", "it crashes (signal 6)"),
        ("import time; time.sleep(60)", "it hangs (gave up after 0.5 s)"),
        ("import no_such_module", "ModuleNotFoundError"),
    ],
)
def test_a_library_that_crashes_or_hangs_is_reported(code, expected):
    good, words = attempt(code, timeout=0.5 if "hangs" in expected else 20.0)
    assert not good and expected in words


def test_a_setting_that_stops_mujoco_from_loading_is_named(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "nonsense")
    check = doctor.check_import("mujoco")
    assert check.status == FAIL and "MUJOCO_GL is 'nonsense'" in check.detail
    assert doctor.check_opengl().status == NOTE


def test_a_folder_that_cannot_be_written_fails(tmp_path):
    assert doctor.check_folder(tmp_path / "new" / "deeper").status == OK
    (tmp_path / "file").touch()
    assert doctor.check_folder(tmp_path / "file" / "deeper").status == FAIL
