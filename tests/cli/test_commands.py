"""Every command: help, a small happy path, and bad input turned into one line."""

import json
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from tests.arms import six_joint_arm
from ves_gym.cli.main import COMMANDS, main
from ves_gym.mechanics.dynamics import joint_positions
from ves_gym.system.energy import log_energies
from ves_gym.system.runlog import RunLog
from ves_gym.system.system import System

ROOT = Path(__file__).parents[2]
SHORT = ("--duration", "0.4", "--settle", "0.2")


@pytest.mark.parametrize("command", [(), *((name,) for name in COMMANDS)])
def test_help_exits_0(command, capsys):
    with pytest.raises(SystemExit) as end:
        main([*command, "--help"])
    assert end.value.code == 0
    assert "usage: ves-gym" in capsys.readouterr().out


def test_runs_as_a_program_without_a_traceback():
    def program(*words):
        command = [sys.executable, "-m", "ves_gym.cli.main", *words]
        return subprocess.run(command, capture_output=True, text=True, cwd=ROOT)

    good = program("list", "commands")
    assert good.returncode == 0 and "benchmark" in good.stdout
    bad = program("list", "nothing")
    assert bad.returncode == 2 and bad.stdout == ""
    assert bad.stderr.startswith("ves-gym: error: ") and bad.stderr.count("\n") == 1


# ------------------------------------------------------------------------- simulate


def test_simulate_saves_a_log_that_gives_the_same_energies(call, tmp_path):
    status, out, err, result = call("simulate", "--goal", "-10,5,-15", *SHORT)
    assert status == 0 and "E_mean" in out and err == ""
    assert result["schema"] == "ves-simulate/1"

    log = RunLog.load(result["log"])
    assert result["digest"] == log.digest
    again = log_energies(log, tail=result["tail"]).to_dict()
    assert result["energies"] == pytest.approx(again)  # text keeps every bit
    assert result["ledger_residual"] < 1e-3  # quadrature at the physics step

    system = System.load(tmp_path / "out" / "system.toml")
    assert system.hash == result["system"] == System().hash
    np.testing.assert_allclose(log.q_cmd[-1], np.deg2rad([-10, 5, -15]))


def test_simulate_draws_a_picture(call, tmp_path):
    pytest.importorskip("matplotlib")
    status, _, _, result = call("simulate", "--goal", "20,10,-15", *SHORT)
    assert status == 0
    assert str(tmp_path / "out" / "run.png") in result["files"]
    assert (tmp_path / "out" / "run.png").read_bytes().startswith(b"\x89PNG")


def test_simulate_writes_parquet_at_the_asked_interval(call):
    pytest.importorskip("pyarrow")
    _, _, _, result = call("simulate", *SHORT, "--log", "a.parquet", "--record-dt", "0.0125")
    log = RunLog.load(result["log"])
    np.testing.assert_allclose(np.diff(log.t), 0.0125)


def test_simulate_warns_of_a_motion_that_is_too_fast(call):
    status, _, err, result = call("simulate", "--goal", "90,0,0", *SHORT)
    assert status == 0
    lines = err.splitlines()
    assert lines[0].startswith("ves-gym: warning: reference: velocity of joint 1 reaches ")
    assert lines[1].startswith("ves-gym: warning: reference: torque of joint 1 reaches ")
    assert lines[2].startswith("ves-gym: warning: simulated arm: velocity of joint 1 reaches ")
    assert len(result["warnings"]) == len(lines) == 3  # the motors keep within their torque
    assert not result["limits"]["reference"]["inside"]
    assert not result["limits"]["simulated"]["inside"]


def test_simulate_passes_way_points(call):
    """Way-points are met to the fit's 1e-3 rad (`Motion.through`) and the servo's lag."""
    _, _, _, result = call(
        "simulate", "--goal", "20,0,0", "--via", "10,10,0", "--drive", "prescribed", *SHORT
    )
    log = RunLog.load(result["log"])
    distance = np.linalg.norm(log.q - np.deg2rad([10, 10, 0]), axis=1)
    assert distance.min() < 0.02  # rad; records are 1.25 ms apart


def test_simulate_starts_from_a_displaced_base(call):
    _, _, _, result = call(
        "simulate", "--goal", "0,0,0", "--disturb", "0.01,0,0,0,0,1", "--gains", "free", *SHORT
    )
    log = RunLog.load(result["log"])
    np.testing.assert_allclose(log.y[0], [0.01, 0, 0, 0, 0, np.deg2rad(1)])
    assert np.abs(log.tau).max() == 0  # no servo


def test_simulate_takes_gains_as_numbers(call):
    _, _, _, result = call("simulate", "--gains", "100/10", "--no-feedforward", *SHORT)
    controller = RunLog.load(result["log"]).meta["controller"]
    assert controller == {"kp": [100.0] * 3, "kd": [10.0] * 3, "feedforward": False}


# ------------------------------------------------------------------------- benchmark

BENCHMARK = ("benchmark", "--suite", "thesis", "--vehicle", "straight-horizontal-thesis")
BENCHMARK += ("--planners", "straight", "--workers", "1")


def test_benchmark_shows_the_emulation_error_in_mode_emulated_only(call):
    status, out, _, ideal = call(*BENCHMARK, "--no-figures")
    assert status == 0 and "emulation" not in out and "machine" not in ideal
    status, out, _, result = call(*BENCHMARK, "--no-figures", "--mode", "emulated")
    assert status == 0 and result["schema"] == ideal["schema"] == "ves-benchmark/1"
    assert "emulation" in out and "operation: microgravity" in out
    (here,), (space,) = result["rows"], ideal["rows"]
    assert here["E_mean_ideal"] == pytest.approx(space["E_mean"])
    assert f"{here['emulation_error']:+.2%}" in out and f"{here['base_error']:.2%}" in out


def test_benchmark_names_a_stop_and_draws_it(call, tmp_path):
    pytest.importorskip("matplotlib")
    status, out, _, result = call(
        *BENCHMARK, "--mode", "emulated", "--effect", "gravity/scale:error=0.1"
    )
    assert status == 0
    assert result["rows"][0]["stopped"] in out
    for name in ("report.html", "base_motion_emulated.png", "strain_energy_emulated.png"):
        assert (tmp_path / "out" / name).exists()


# ------------------------------------------------------------------------------ plan


def test_plan_is_what_simulate_plays_back(call, tmp_path):
    """The plan's energy is found again from its motion file.

    Tolerance: quadrature of records 12.5 ms apart against 1.25 ms.
    """
    status, out, _, plan = call("plan", "--goal", "-30,20,-15", "--duration", "1")
    assert status == 0 and plan["feasible"] and "inside the limits" in out
    assert plan["schema"] == "ves-plan/1"
    np.testing.assert_allclose(np.rad2deg(plan["path"][-1]), [-30, 20, -15])
    mean = plan["simulated"]["E_mean"]
    assert mean < plan["straight"]["E_mean"]
    assert plan["predicted"]["E_mean"] == pytest.approx(mean, rel=0.05)

    words = ("--motion", tmp_path / "out" / "motion.json", "--record-dt", "0.00625")
    _, _, _, played = call("simulate", *words)
    assert played["energies"]["E_mean"] == pytest.approx(mean, rel=1e-3)


def test_plan_to_a_tool_position(call):
    options = ("--tool", "0.5,0.3,1.2", "--planner", "straight", "--duration", "3")
    status, out, _, result = call("plan", *options)
    assert status == 0 and out.startswith("goal: ")
    goal = np.array(result["path"][-1])
    tool = joint_positions(System().arm, goal)[-1]
    np.testing.assert_allclose(tool, (0.5, 0.3, 1.2), atol=2e-6)
    np.testing.assert_allclose(result["info"]["tool"]["goal"], goal)


def test_plan_that_breaks_a_limit_is_a_negative_verdict(call):
    words = ("--planner", "straight", "--goal", "60,0,0", "--duration", "0.5")
    status, out, _, result = call("plan", *words, "--v-max", "82,54,122")
    assert status == 1 and not result["feasible"] and "NOT feasible" in out


# ------------------------------------------------------------------------------- map


def test_map_arrays_and_result_agree(call, tmp_path):
    status, out, _, result = call("map", "--joints", "1,3", "--points", "7", "--duration", "2")
    assert status == 0 and "joints 1 and 3" in out
    assert result["schema"] == "ves-map/1" and result["duration"] == 2.0
    (section,) = result["maps"]
    with np.load(tmp_path / "out" / "map.npz") as arrays:
        np.testing.assert_array_equal(arrays["q1_q3_most"], section["most"])
        np.testing.assert_array_equal(arrays["q1_q3_first"], section["q"][0])
    assert np.shape(section["direction"]) == (7, 7, 2)


def test_map_draws_every_pair(call, tmp_path):
    pytest.importorskip("matplotlib")
    status, _, _, result = call("map", "--points", "9", "--format", "svg")
    assert status == 0 and [m["joints"] for m in result["maps"]] == [[1, 2], [1, 3], [2, 3]]
    assert "<svg" in (tmp_path / "out" / "map.svg").read_text()


def test_map_of_a_six_joint_arm_with_the_others_chosen(call, tmp_path):
    System(arm=six_joint_arm()).save(tmp_path / "six.toml")
    options = ("--system", str(tmp_path / "six.toml"), "--joints", "2,3", "--points", "5")
    status, out, _, result = call("map", *options, "--others", "least")
    assert status == 0 and "joints 2 and 3" in out
    assert result["others"] == "least"
    assert np.shape(result["maps"][0]["angles"]) == (5, 5, 6)
    with np.load(tmp_path / "out" / "map.npz") as arrays:
        np.testing.assert_array_equal(arrays["q2_q3_angles"], result["maps"][0]["angles"])


# ------------------------------------------------------------------------------ list


def test_list_names_everything(call):
    status, out, _, result = call("list")
    assert status == 0
    unnamed = ("schema", "wires")
    names = {kind: {row["name"] for row in result[kind]} for kind in result.keys() - unnamed}
    assert {"bent", "free-floating"} <= names["vehicles"]
    assert {"straight", "direct"} <= names["planners"]
    assert {"reach100", "thesis"} <= names["suites"]
    engines = {"auto", "kernel", "mujoco", "gpu-kernel", "gpu-kernel-float32"}
    assert names["backends"] == engines
    assert names["commands"] == set(COMMANDS)
    assert "ves/PumaDamp-v0" in {row["environment"] for row in result["policies"]}
    assert "[Hz]" in out  # a unit in a heading is not markup


def test_list_environments(call):
    """The spaces and lengths listed are those of the environments, one line each."""
    status, out, _, result = call("list", "environments")
    assert status == 0
    rows = {row["name"]: row for row in result["environments"]}
    assert set(rows) == {k for k in gym.registry if k.startswith("ves/")}
    for id, row in rows.items():
        env = gym.make(id)
        space = env.observation_space
        if isinstance(space, gym.spaces.Dict):
            assert row["observation"] == {k: list(v.shape) for k, v in space.items()}
        else:
            assert row["observation"] == list(space.shape)
        assert row["action"] == list(env.action_space.shape)
        assert row["max_episode_steps"] == env.unwrapped.task.steps
        assert row["task"] == env.unwrapped.task.kind and row["version"] == env.spec.version
        assert sum(f" {id} " in line for line in out.splitlines()) == 1
    assert "max episode steps" in out


def test_list_blocks(call):
    """One line per wire, of the system that the options describe; a file says its own mode."""
    status, out, _, result = call("list", "blocks")
    assert status == 0 and set(result) == {"schema", "blocks", "wires"}
    rows = {row["name"]: row for row in result["blocks"]}
    assert rows["admittance"]["parameters"]["M"] == [6, 6]
    assert rows["force_sensor"]["memory"]["filter"] == [6, 2]
    assert rows["force_sensor"]["runs"] == "after engine" and rows["platform"]["compiles"]
    wires = {(w["from"], w["to"], w["signal"]): w for w in result["wires"]}
    late = wires["force_sensor", "admittance", "reading"]
    assert (late["shape"], late["unit"], late["when"]) == ([6], "N, N m", "a period later")
    assert wires["admittance", "computing_delay", "motion"]["when"] == "at once"
    assert wires["platform", "gravity_estimate", "y_measured"]["when"] == "at once"
    assert wires["engine", "force_sensor", "wrench"]["shape"] == [11, 6]
    assert wires["engine_input", "engine", "acceleration"]["unit"] == "m/s^2, rad/s^2"
    for start, end, name in wires:
        lines = [k for k in out.splitlines() if all(f" {w} " in k for w in (start, end, name))]
        assert lines, (start, end, name)

    status, out, _, result = call(
        "list", "blocks", "--no-compensation", "--operation", "admittance", "--platform", "8"
    )
    names = [row["name"] for row in result["blocks"]]
    assert status == 0 and "payload_compensation" not in names
    assert "gravity_estimate" not in names and " zero " in out
    status, _, _, result = call("list", "blocks", "--platform", "filtered")
    (legs,) = [row for row in result["blocks"] if row["name"] == "platform"]
    assert status == 0 and legs["times"] > 1 and legs["memory"]["pose"] == [6]
    status, _, _, result = call("list", "blocks", "--effect", "platform/bandwidth:error=0.1")
    assert status == 0 and "platform_model" in [row["name"] for row in result["blocks"]]


# ------------------------------------------------------------------------- bad input

BAD = {
    "unknown command": (["frobnicate"], "frobnicate"),
    "unknown option": (["simulate", "--frobnicate"], "--frobnicate"),
    "unknown vehicle": (["simulate", "--vehicle", "boat"], "bent"),
    "unknown planner": (["plan", "--goal", "1,1,1", "--planner", "magic"], "direct"),
    "unknown mode": (["simulate", "--mode", "dream"], "ideal"),
    "unknown gains": (["simulate", "--gains", "soft"], "pped"),
    "unknown kind": (["list", "unicorns"], "vehicles"),
    "blocks of no emulation": (["list", "blocks", "--mode", "ideal"], "--mode emulated"),
    "options of another list": (["list", "vehicles", "--platform", "8"], "`list blocks`"),
    "NaN angle": (["simulate", "--goal", "nan,0,0"], "finite"),
    "word for an angle": (["plan", "--goal", "a,0,0"], "angles in degrees"),
    "joint out of range": (["simulate", "--goal", "0,0,136"], "joint 3"),
    "negative joint out of range": (["plan", "--goal", "-161,0,0"], "joint 1"),
    "two joints": (["simulate", "--start", "0,0"], "3 angles"),
    "way-points out of range": (["simulate", "--goal", "0,109,0", "--via", "0,108,9",
                                 "--via", "90,110,0"], "position"),
    "control period": (["simulate", "--control-dt", "0.003"], "0.003"),
    "physics step too long": (["simulate", "--physics-dt", "0.5", "--control-dt", "0.5",
                               "--vehicle", "straight-vertical-thesis"], "physics_dt"),
    "record interval": (["simulate", "--record-dt", "0.002"], "record_dt"),
    "record interval 0": (["simulate", "--record-dt", "0"], "--record-dt"),
    "duration": (["simulate", "--duration", "-1"], "--duration"),
    "settle": (["simulate", "--settle", "nan"], "--settle"),
    "disturb": (["simulate", "--disturb", "1,2,3"], "six"),
    "log name": (["simulate", "--log", "run.txt"], ".parquet"),
    "gains for a prescribed drive": (["simulate", "--drive", "prescribed", "--gains", "high"],
                                     "prescribed"),
    "via without goal": (["simulate", "--via", "1,1,1"], "--goal"),
    "seed": (["plan", "--goal", "1,1,1", "--seed", "-1"], "whole number"),
    "speed limit": (["plan", "--goal", "1,1,1", "--v-max", "1,0,1"], "v_max"),
    "map joints": (["map", "--joints", "1,1"], "from 1 to 3"),
    "map duration": (["map", "--duration", "soon"], "raw"),
    "plan tool": (["plan", "--tool", "0.5,0.3"], "three lengths in m"),
    "plan tool far": (["plan", "--tool", "5,0,0"], "must be within reach of puma560"),
    "map others": (["map", "--others", "best", "--points", "5"], "given, least, most"),
    "map points": (["map", "--points", "2"], "--points"),
    "missing log": (["view", "nowhere.csv"], "nowhere"),
    "log suffix": (["view", "nowhere.txt"], ".parquet"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_line_and_writes_nothing(case, refused):
    words, expected = BAD[case]
    assert expected in refused(*words)


def test_a_run_that_does_not_stay_bounded_is_one_line(refused):
    """A beam that is released 1 km from where it is at rest."""
    words = ("--vehicle", "bent-thesis", "--disturb", "1000,0,0,0,0,0")
    assert "diverged" in refused("simulate", *words)


NOT_DEFINITE = """
kind = "matrices"
M = {M}
D = {D}
K = {D}
"""


def test_vehicle_that_is_not_positive_definite_is_named(refused, tmp_path):
    path = tmp_path / "boat.toml"
    eye = np.eye(6)
    bad = eye.copy()
    bad[2, 2] = -3.0
    path.write_text(NOT_DEFINITE.format(M=bad.tolist(), D=eye.tolist()))
    line = refused("simulate", "--vehicle", path)
    assert "MatrixVehicle.M" in line and "-3" in line


def motion_text(duration="1", control=((0.0,) * 3,) * 6, extra=""):
    rows = json.dumps(control)
    return f'{{"format": "ves-motion/1", "duration": {duration}, "control": {rows}{extra}}}'


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("{", "JSON"),
        ("[]", "table"),
        ('{"duration": 1}', "format"),
        ('{"format": "ves-motion/1", "duration": 1}', "control"),
        (motion_text(control=[[0, 0], [0]]), "equal length"),
        (motion_text(control=[[0, 0, 0]]), "shape"),
        (motion_text(control=[[0, 0]] * 6), "3 joints"),
        (motion_text(duration="NaN"), "> 0"),
        (motion_text(extra=', "x": 1'), "'x'"),
    ],
)
def test_bad_motion_file_is_named(text, expected, refused, tmp_path):
    path = tmp_path / "motion.json"
    path.write_text(text)
    line = refused("simulate", "--motion", path)
    assert expected in line and "motion.json" in line


def test_motion_file_excludes_the_ends(refused, tmp_path):
    assert "--goal" in refused("simulate", "--motion", "m.json", "--goal", "1,1,1")


def test_result_may_not_replace_the_log_s_metadata(tmp_path, capsys):
    words = ["simulate", "--out", str(tmp_path), "--json", str(tmp_path / "run.json")]
    assert main(words) == 2
    assert "metadata" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_result_is_plain_json_without_nan(call, tmp_path):
    """A base at rest has no ledger and never settles: null, not NaN or Infinity."""
    _, _, _, result = call("simulate", "--goal", "0,0,0", *SHORT)
    assert result["ledger_residual"] is None
    assert "NaN" not in json.dumps(result) and "Infinity" not in json.dumps(result)


# ---------------------------------------------------------------- files that are written


def _files(folder):
    return {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()}


@pytest.mark.parametrize(
    ("words", "log", "system"),
    [
        ((), "out/simulate/run.csv", "out/simulate/system.toml"),
        (("--log", "a.csv"), "a.csv", "a.system.toml"),
        (("--log", "deep/er/a.parquet"), "deep/er/a.parquet", "deep/er/a.system.toml"),
        (("--out", "o"), "o/run.csv", "o/system.toml"),
        (("--out", "o", "--log", "sub/a.csv"), "o/sub/a.csv", "o/system.toml"),
    ],
)
def test_simulate_names_every_file_it_writes(words, log, system, tmp_path, capsys, monkeypatch):
    """What is there afterwards is what was told, and the log is where `--log` says."""
    monkeypatch.chdir(tmp_path)
    assert main(["simulate", *SHORT, *words]) == 0
    out = capsys.readouterr().out
    told = {line.removeprefix("written: ") for line in out.splitlines() if "written: " in line}
    assert set(told.pop().split("  ")) == _files(tmp_path)
    assert {log, system} <= _files(tmp_path)
    assert RunLog.load(log).digest and System.load(system) == System()


def test_an_absolute_log_goes_where_it_says(call, tmp_path):
    status, _, _, result = call("simulate", *SHORT, "--log", tmp_path / "there" / "a.csv")
    assert status == 0 and result["log"] == str(tmp_path / "there" / "a.csv")
    assert set(result["files"]) == {str(tmp_path / f) for f in _files(tmp_path)}


def test_weighing_names_its_files_too(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["simulate", "--mode", "emulated", "--poses", "3", "--log", "w/poses.csv"]
    assert main(words) == 0
    assert "written: w/poses.csv  w/poses.json" in capsys.readouterr().out
    assert _files(tmp_path) == {"w/poses.csv", "w/poses.json"}
