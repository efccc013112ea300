"""`teleop`: scripted keys without a display, a window with one."""

import io
import subprocess
import sys
import time

import pytest

from tests.display import type_keys, virtual_display
from ves_gym.rendering import opengl as gl
from ves_gym.system.runlog import RunLog

SCRIPT = "0.1 q 0.5\n0.7 escape\n"


@pytest.fixture
def keys(tmp_path):
    path = tmp_path / "keys.txt"
    path.write_text(SCRIPT)
    return path


@pytest.mark.parametrize("mode", ["ideal", "emulated"])
def test_a_script_is_driven_and_recorded(call, keys, tmp_path, mode):
    words = ("--mode", mode, "--start", "0,60,-90", "--log", "run.csv")
    status, out, err, result = call("teleop", "--keys", keys, *words)
    assert status == 0 and err == ""
    assert result["schema"] == "ves-teleop/1" and result["mode"] == mode
    assert result["seconds"] == pytest.approx(0.7) and result["E_peak"] > 0
    log = RunLog.load(tmp_path / "out" / "run.csv")
    assert result["digest"] == log.digest and len(log) == 57
    assert log.q[-1, 0] > 0.05 and "written" in out


def test_readings_are_printed_for_as_long_as_the_script(call, keys, monkeypatch):
    monkeypatch.setattr(sys, "stdin", io.StringIO("0.5 p\n"))
    status, out, err, result = call("teleop", "--keys", "-", "--mode", "emulated", "--zero")
    assert status == 0 and result["log"] is None
    lines = out.splitlines()
    assert len(lines) == 2 and lines[0].startswith("  1.00 s")  # 2 s after the last key
    assert "measured" in lines[0] and "estimated" in lines[0] and "panic button" in lines[0]
    assert "panic button" in err
    assert [event["reason"] for event in result["events"]] == ["panic button"]
    *_, result = call("teleop", "--keys", keys, "--duration", "0.25")
    assert result["seconds"] == pytest.approx(0.25)


def test_without_a_display_a_script_is_suggested(refused, monkeypatch):
    monkeypatch.setattr(gl.platform, "system", lambda: "Linux")
    line = refused("teleop")
    assert "DISPLAY" in line and "--keys" in line


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--keys", "keys.txt", "--log", "run.gif"], ".parquet"),
        (["--keys", "keys.txt", "--duration", "0"], "--duration"),
        (["--keys", "keys.txt", "--start", "0,120,0"], "joint 2"),
        (["--keys", "keys.txt", "--zero"], "--mode emulated"),
    ],
)
def test_bad_options_are_one_line(words, expected, refused, keys):
    assert expected in refused("teleop", *words)


def test_a_bad_key_names_file_and_line(refused, keys):
    keys.write_text("0.1 q\n0.2 Q\n")
    line = refused("teleop", "--keys", "keys.txt")
    assert "keys.txt, line 2" in line and "'Q'" in line


def test_a_window_is_driven_with_keys(tmp_path):
    """For real: an X server, a window, keys that go down and up."""
    log = tmp_path / "run.csv"
    words = [sys.executable, "-m", "ves_gym.cli.main", "teleop", "--log", str(log)]
    with virtual_display():
        run = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        try:
            type_keys("ves-gym teleop", "keydown q")
            time.sleep(5.0)  # a busy machine shows less than real time
            type_keys("ves-gym teleop", "keyup q", "key Escape")
            out, err = run.communicate(timeout=60)
        finally:
            run.kill()
            run.wait()
    assert run.returncode == 0, err
    assert "joint 1 +" in out and "escape" in out  # the key map
    assert RunLog.load(log).q[-1, 0] > 0.05
