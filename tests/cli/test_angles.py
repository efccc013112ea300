"""Angles are degrees; those that look like radians are asked about, on stderr and once."""

import numpy as np
import pytest

from ves_gym.cli.motions import radians_note
from ves_gym.system.runlog import RunLog

SHORT = ("--duration", "0.4", "--settle", "0.2")


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("1.57,0,0", "90,0,0"),
        ("0.785,-1.571,0.5", "45,-90,28.6"),
        ("-2.36,0,0", "-135,0,0"),
        ("3.14159,0,0", "180,0,0"),
        ("0.26,0,0", "15,0,0"),
    ],
)
def test_round_angles_in_radians_are_noticed(text, meant):
    note = radians_note(text, "--start")
    assert note.startswith(
        f"--start {text} looks like radians; angles are degrees: did you mean {meant}?"
    )


@pytest.mark.parametrize(
    "text", ["0,0,0", "1,1,1", "5,5,5", "1.5,0,0", "0.25,0,0", "1.2,-0.7,0.4", "90,1.57,0",
             "0.01,0,0", "1e-3,0,0", "6.5,0,0"]
)  # fmt: skip
def test_small_angles_are_angles(text):
    assert radians_note(text, "--start") is None


def test_the_question_is_a_line_on_stderr_and_nowhere_else(call):
    words = ("simulate", "--goal", "1.57,0,0", *SHORT)
    status, out, err, result = call(*words)
    assert status == 0 and err.count("\n") == 1 and "did you mean 90,0,0?" in err
    assert err.startswith("ves-gym: note: --goal 1.57,0,0 looks like radians")
    assert "radians" not in out and "radians" not in str(result)
    goal = RunLog.load(result["log"]).q_cmd[-1, 0]
    assert goal == pytest.approx(np.deg2rad(1.57))  # asked about, not changed
    _, _, err, same = call(*words, "--degrees")
    assert err == "" and same["energies"] == result["energies"]


def test_radians_are_taken_as_they_are(call):
    slow = ("--duration", "4", "--settle", "0.2")
    quarter = ("--goal", "1.5707963267948966,0,0", "--radians")
    status, _, err, result = call("simulate", *quarter, *slow)
    assert status == 0 and err == ""
    _, _, _, degrees = call("simulate", "--goal", "90,0,0", *slow)
    assert result["energies"] == pytest.approx(degrees["energies"])


@pytest.mark.parametrize("command", ["plan --goal", "map --at", "emulation-check --at"])
def test_out_of_range_and_words_name_the_unit(refused, command):
    words = command.split()
    assert "3 angles in radians, like" in refused(*words, "a,0,0", "--radians")
    far = refused(*words, "90,0,0", "--radians")
    assert "joint 1 must be within -160.0 to 160.0 deg, got 5156.6 deg" in far
