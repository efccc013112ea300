"""The laboratory from the command line: check, weigh, calibrate, run, learn, and stop."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from ves_gym._util.params import to_plain
from ves_gym.cli.main import main
from ves_gym.mechanics.motion import Motion
from ves_gym.system.runlog import RunLog
from ves_gym.system.system import System

LAB = ("--mode", "emulated")
SHORT = ("--duration", "0.4", "--settle", "0.2")


# ---------------------------------------------------------------------- emulation-check


def test_check_of_a_stable_emulation(call):
    status, out, _, result = call("emulation-check", "--vehicle", "bent-thesis", "--no-figures")
    assert status == 0 and "stable" in out and "UNSTABLE" not in out
    assert result["schema"] == "ves-emulation-check/1"
    assert result["stable"] and result["spectral_radius"] <= 1
    assert result["payload_ratio"] == pytest.approx(1.105, abs=0.01)
    assert result["max_bandwidth"] > 20
    assert len(result["modes"]) >= 6


def test_check_of_a_beam_with_internal_modes(call):
    """Almost all its mass is in them: the arm outweighs what moves with the flange."""
    status, out, _, result = call("emulation-check", "--no-search", "--no-figures")
    assert status == 0 and result["stable"] and "UNSTABLE" not in out
    assert result["payload_ratio"] > 50
    assert len(result["modes"]) >= 11


def test_check_of_an_unstable_emulation_exits_1(call):
    status, out, _, result = call(
        "emulation-check", "--no-compensation", "--no-figures", "--no-search"
    )
    assert status == 1 and "UNSTABLE" in out
    assert not result["stable"] and result["spectral_radius"] > 1.005


def test_check_draws_loop_and_legs(call, tmp_path):
    pytest.importorskip("matplotlib")
    words = ("--platform", "filtered", "--no-search", "--format", "pdf")
    status, _, _, result = call("emulation-check", *words)
    assert status == 0
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {
        *(f"loop_{k}.pdf" for k in ("poles", "bode", "step")),
        *(f"leg_{k}.pdf" for k in ("open", "closed", "step", "poles")),
    }
    assert len(result["files"]) == 7


# ----------------------------------------------------------------------------- simulate


@pytest.mark.parametrize("vehicle", ["bent-thesis", "bent"])
def test_simulate_shows_the_laboratory_beside_space(call, vehicle):
    words = ("--duration", "1.5", "--settle", "0.5", "--goal", "20,10,-10")
    status, out, err, result = call("simulate", *LAB, *words, "--vehicle", vehicle)
    assert status == 0 and err == ""
    assert "in space" in out and "base position off by" in out
    log = RunLog.load(result["log"])
    assert log.w is not None and log.wg is not None and log.y_cmd is not None
    assert log.w[0, 2] == pytest.approx(-919, abs=2)  # N, the weight
    assert abs(log.wg[0, 2]) < 1e-6
    assert result["stopped"] is None and result["base_error"] < 0.1
    ratio = result["energies"]["E_mean"] / result["energies_in_space"]["E_mean"]
    print(f"{vehicle}: E_mean over that in space {ratio:.4f}")
    assert ratio == pytest.approx(1, abs=0.02)
    assert log.meta["events"] == []


def test_a_stop_keeps_the_log_and_says_why(call):
    status, _, err, result = call("simulate", *LAB, *SHORT, "--disturb", "2,0,0,0,0,0")
    assert status == 1
    assert "platform frozen at t = 0.0000 s: leg" in err and "outside the workspace" in err
    assert result["energies"] is None and "workspace" in result["stopped"]["reason"]
    log = RunLog.load(result["log"])
    assert len(log) >= 2 and log.meta["events"][0]["reason"] == result["stopped"]["reason"]


def test_an_unstable_run_warns_in_one_line(tmp_path):
    words = [
        "simulate",
        *LAB,
        *SHORT,
        "--vehicle",
        "straight-horizontal-thesis",
        "--no-compensation",
    ]
    done = subprocess.run(
        [sys.executable, "-m", "ves_gym.cli.main", *words],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
    )
    assert done.returncode == 1
    first = done.stderr.splitlines()[0]
    assert first.startswith("ves-gym: warning: unstable emulation") and ".py" not in done.stderr


def test_platform_follows_a_motion(call, tmp_path):
    tilt = Motion.straight(np.zeros(6), np.deg2rad([0, 0, 0, 5.0, 0, 0]), 0.4)
    path = tmp_path / "tilt.json"
    path.write_text(json.dumps({"format": "ves-motion/1", **to_plain(tilt)}))
    status, _, _, result = call(
        "simulate", *LAB, *SHORT, "--operation", "position", "--platform-motion", path
    )
    assert status == 0
    assert RunLog.load(result["log"]).y[-1, 3] == pytest.approx(np.deg2rad(5), abs=1e-3)


def test_learning_reports_every_repetition(call):
    status, out, _, result = call("simulate", *LAB, *SHORT, "--learn", "2")
    assert status == 0
    assert "repetition 1" in out and "repetition 2" in out
    assert result["base_error"] < 0.5


def test_weigh_then_calibrate_then_run(call, tmp_path):
    noise = "sensor/noise:force=[0.2,0.2,0.2],moment=[0.1,0.1,0.1]"
    status, out, _, _ = call(
        "simulate", *LAB, "--poses", "30", "--log", "poses.csv", "--effect", noise
    )
    assert status == 0 and "ves-gym calibrate" in out
    status, _, _, found = call("calibrate", tmp_path / "out" / "poses.csv")
    assert status == 0 and found["M_total"] == pytest.approx(93.7, abs=2.0)
    status, _, _, result = call(
        "simulate", *LAB, *SHORT, "--calibration", tmp_path / "out" / "calibration.toml"
    )
    assert status == 0 and result["base_error"] < 0.3
    system = System.load(tmp_path / "out" / "system.toml")
    assert system.emulator_settings.gravity.mass == pytest.approx(found["M_total"])


def test_friction_in_space(call):
    slow = ("--goal", "20,10,-10", "--duration", "1", "--settle", "0.2")
    _, _, _, free = call("simulate", *slow)
    status, _, _, result = call("simulate", *slow, "--effect", "joint/viscous:damping=[5,5,5]")
    assert status == 0 and result["ledger_residual"] < 1e-3
    assert result["energies"]["E_mean"] != free["energies"]["E_mean"]


# ---------------------------------------------------------------------------- bad input

BAD = {
    "platform": (["emulation-check", "--platform", "fast"], "low-gains, filtered"),
    "platform in space": (["simulate", "--platform", "8"], "--mode emulated"),
    "check of space": (["emulation-check", "--mode", "ideal"], "--mode emulated"),
    "check of position control": (["emulation-check", "--operation", "position"], "no loop"),
    "operation": (["simulate", *LAB, "--operation", "fly"], "microgravity, admittance"),
    "motion without position control": (["simulate", *LAB, "--platform-motion", "x.json"],
                                        "--operation position"),
    "effect": (["simulate", *LAB, "--effect", "gravity/scal:error=0.1"], "gravity/scale"),
    "effect syntax": (["simulate", *LAB, "--effect", "gravity/scale:error"], "like gravity"),
    "effect bounds": (["simulate", *LAB, "--effect", "gravity/scale:error=5"], "[-0.2, 0.2]"),
    "effect in space": (["simulate", "--effect", "sensor/lag:error=1"], "mode emulated"),
    "friction of two joints": (["simulate", "--effect", "joint/viscous:damping=[1,1]"], "3"),
    "learning in space": (["simulate", "--learn", "2"], "--mode emulated"),
    "learning nothing": (["simulate", *LAB, "--learn", "0"], ">= 1"),
    "learning from elsewhere": (["simulate", *LAB, "--learn", "2", "--disturb", "0,0,0,0,0,0"],
                                "--disturb"),
    "no poses": (["simulate", *LAB, "--poses", "0"], ">= 1"),
    "two experiments": (["simulate", *LAB, "--poses", "5", "--learn", "2"], "one of them"),
    "leg clock": (["simulate", *LAB, "--platform", "filtered", "--control-dt", "0.0125"],
                  "whole number"),
    "record interval": (["simulate", *LAB, "--record-dt", "0.00125"], "control periods"),
    "calibration": (["simulate", *LAB, "--calibration", "none.toml"], "none.toml"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_line_and_writes_nothing(case, tmp_path, capsys, monkeypatch):
    words, expected = BAD[case]
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    text = capsys.readouterr()
    assert text.out == "" and text.err.startswith("ves-gym: error: ")
    assert text.err.count("\n") == 1 and expected in text.err
    assert not list(tmp_path.iterdir())
