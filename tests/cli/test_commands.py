"""Every command once: what it prints, writes and returns."""

import json
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import ves_gym as vg
from tests.arms import six_joint_arm
from ves_gym._util.params import to_plain, write_table
from ves_gym.cli.main import COMMANDS, main
from ves_gym.damping.plant import GainMatrices, analyse, plant_at
from ves_gym.mechanics.kinematics import joint_positions
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.vehicle import BENT_THESIS, DECOUPLED
from ves_gym.planners.obstacles import Box, Surroundings, collisions
from ves_gym.simulation.gravity_calibration import read_calibration

ROOT = Path(__file__).parents[2]
SHORT = ("--duration", "0.4", "--settle", "0.2")
LAB = ("--mode", "emulated")
COULOMB = "joint/coulomb:torque=3,0,0"


def test_runs_as_a_program_without_a_traceback():
    def program(*words):
        command = [sys.executable, "-m", "ves_gym", *words]
        return subprocess.run(command, capture_output=True, text=True, cwd=ROOT)

    good = program("list", "commands", "--json", "-")
    assert good.returncode == 0 and json.loads(good.stdout)["schema"] == "ves-list/1"
    bad = program("list", "nothing")
    assert bad.returncode == 2 and bad.stdout == ""
    assert bad.stderr.startswith("ves-gym: error: ") and bad.stderr.count("\n") == 1


# ------------------------------------------------------------------------- simulate


def test_simulate_saves_a_log_that_gives_the_same_energies(call, tmp_path):
    status, out, err, result = call("simulate", "--goal", "-10,5,-15", *SHORT)
    assert (status, err, result["schema"]) == (0, "", "ves-simulate/1") and "E_mean" in out
    log, case = vg.RunLog.load(result["log"]), vg.load_case(tmp_path / "out" / "run.case.toml")
    assert result["digest"] == log.digest and case.log == result["log"]
    again = vg.energy(log, tail=result["tail"]).to_dict()
    assert result["energies"] == pytest.approx(again)  # text keeps every bit
    assert result["ledger_residual"] < 1e-3  # quadrature at the physics step
    assert case.system.hash == result["system"] == vg.System().hash
    np.testing.assert_allclose(log.q_cmd[-1], np.deg2rad([-10, 5, -15]))
    assert {Path(f).name for f in result["files"]} >= {"run.csv", "run.json", "run.case.toml"}
    assert all(str(Path(f)) in out for f in result["files"])
    assert (tmp_path / "out" / "run.png").read_bytes().startswith(b"\x89PNG")


def test_simulate_warns_of_a_motion_that_is_too_fast(call):
    """The same extremes whatever is recorded: the joints are looked at at every step. Torque
    that is sent ahead is looked at where it is recorded."""
    fast = ("simulate", "--goal", "90,0,0", "--duration", "0.5", "--settle", "0.5")
    status, _, err, fine = call(*fast)
    assert status == 0 and len(fine["warnings"]) == 3  # motors keep within their torque
    warned = ("reference: velocity", "reference: torque", "simulated arm: velocity")
    for line, what in zip(err.splitlines(), warned, strict=True):
        assert line.startswith(f"ves-gym: warning: {what} of joint 1 reaches ")
    coarse = call(*fast, "--record-dt", "0.0625", "--log", "a.parquet")[3]
    np.testing.assert_allclose(np.diff(vg.RunLog.load(coarse["log"]).t), 0.0625)
    asked, other = (r["limits"]["reference"]["extremes"] for r in (fine, coarse))
    assert {**asked, "torque": other["torque"]} == other
    for kind in ("velocity", "torque"):
        ours, theirs = (r["limits"]["simulated"]["extremes"][kind] for r in (fine, coarse))
        assert ours == theirs


def test_simulate_takes_way_points_gains_and_a_displaced_base(call):
    """Way-points are met to the fit's 1e-3 rad (`Motion.through`) and the servo's lag."""
    via = ("--goal", "20,0,0", "--via", "10,10,0", "--drive", "prescribed")
    log = vg.RunLog.load(call("simulate", *via, *SHORT)[3]["log"])
    assert np.linalg.norm(log.q - np.deg2rad([10, 10, 0]), axis=1).min() < 0.02  # rad
    words = ("--goal", "0,0,0", "--disturb", "0.01,0,0,0,0,1", "--gains", "free")
    log = vg.RunLog.load(call("simulate", *words, *SHORT)[3]["log"])
    np.testing.assert_allclose(log.y[0], [0.01, 0, 0, 0, 0, np.deg2rad(1)])
    assert np.abs(log.tau).max() == 0  # no servo
    words = ("--gains", "100/10", "--no-feedforward", "--vehicle", "servicer")
    _, out, _, result = call("simulate", *words, *SHORT)
    controller = vg.RunLog.load(result["log"]).meta["controller"]
    assert controller == {"kp": [100.0] * 3, "kd": [10.0] * 3, "feedforward": False}
    assert "puma560 on servicer, 0.4 s" in out and "propellant" in out
    assert result["propellant"] >= 0
    result = call("simulate", "--goal", "0,0,0", *SHORT)[3]  # at rest: null, no NaN or Infinity
    assert result["ledger_residual"] is None
    assert "NaN" not in json.dumps(result) and "Infinity" not in json.dumps(result)


def test_simulate_shows_the_laboratory_beside_space(call):
    words = ("--duration", "1.5", "--settle", "0.5", "--goal", "20,10,-10")
    status, out, err, result = call("simulate", *LAB, *words)
    assert (status, err) == (0, "") and "in space" in out and "base position off by" in out
    log = vg.RunLog.load(result["log"])
    assert log.w[0, 2] == pytest.approx(-919, abs=2)  # N, the weight
    assert abs(log.wg[0, 2]) < 1e-6 and log.meta["events"] == []
    assert result["stopped"] is None and result["base_error"] < 0.1
    ratio = result["energies"]["E_mean"] / result["energies_in_space"]["E_mean"]
    assert ratio == pytest.approx(1, abs=0.02)


def test_a_stop_keeps_the_log_and_says_why(call):
    status, _, err, result = call("simulate", *LAB, *SHORT, "--disturb", "2,0,0,0,0,0")
    assert status == 1 and result["energies"] is None
    assert "platform frozen at t = 0.0000 s: leg" in err and "outside the workspace" in err
    log = vg.RunLog.load(result["log"])
    assert len(log) >= 2 and log.meta["events"][0]["reason"] == result["stopped"]["reason"]


@pytest.mark.filterwarnings("default")
def test_an_unstable_run_warns_in_one_line(call):
    words = ("--vehicle", "straight-horizontal-thesis", "--no-compensation")
    status, _, err, _ = call("simulate", *LAB, *SHORT, *words)
    assert status == 1
    first = err.splitlines()[0]
    assert first.startswith("ves-gym: warning: unstable emulation") and ".py" not in err


def test_the_platform_follows_a_motion_and_learns_a_weight(call, tmp_path):
    tilt = Motion.straight(np.zeros(6), np.deg2rad([0, 0, 0, 5.0, 0, 0]), 0.4)
    write_table(tmp_path / "tilt.toml", to_plain(tilt))
    words = (*LAB, *SHORT, "--operation", "position", "--platform-motion", "tilt.toml")
    status, _, _, result = call("simulate", *words)
    assert status == 0
    y = vg.RunLog.load(result["log"]).y
    assert y[-1, 3] == pytest.approx(np.deg2rad(5), abs=1e-3)
    status, out, _, result = call("simulate", *LAB, *SHORT, "--learn", "2")
    assert status == 0 and "repetition 1" in out and "repetition 2" in out
    assert result["base_error"] < 0.5


def test_poses_are_weighed_calibrated_and_taken_back(call, tmp_path):
    status, out, _, weighed = call("simulate", *LAB, "--poses", "30", "--log", "poses.csv")
    assert status == 0 and "weighed 30 poses" in out and weighed["poses"] == 30
    words = ("--iterations", "limit", "--check", weighed["log"], "--rezero")
    status, out, err, result = call("calibrate", weighed["log"], *words)
    assert (status, err, result["schema"]) == (0, "", "ves-calibrate/1")
    for text in ("M_total", "P9", "m2 r2x + (m2 + m3) a2", "moment z", "check rms"):
        assert text in out
    assert result["poses"] == 30 and len(result["P"]) == len(result["names"]) == 9
    file = tmp_path / "out" / "calibration.toml"
    assert read_calibration(file).model.mass == result["M_total"]
    assert call("simulate", *LAB, *SHORT, "--calibration", file)[0] == 0
    write_table(tmp_path / "arm.toml", vg.PUMA_560)
    words = ("--keep-matrix", "--keep-zero", "--arm", tmp_path / "arm.toml")
    kept = call("calibrate", weighed["log"], *words)[3]
    assert kept["iterations"] == 0 and kept["check"] is None
    assert np.array_equal(kept["C"], np.eye(6)) and set(kept["offset"]) == {0.0}


# ------------------------------------------------------------------------------ plan

ROOM = Surroundings(obstacles=(Box(centre=(0.75, 0.0, 0.7), size=(0.2, 0.2, 0.8)),))
ACROSS = ("--start", "-57,6,11", "--goal", "57,6,11", "--duration", "4")


def test_a_path_around_obstacles_and_none_say_why(call, tmp_path):
    write_table(tmp_path / "room.toml", ROOM)
    room = ("plan", *ACROSS, "--obstacles", "room.toml")
    words = ("--planner", "ompl-time", "--evaluations", "5000")
    status, out, _, result = call(*room, *words)
    assert status == 0 and "inside the limits" in out and result["failure"] is None
    motion = vg.load_case(tmp_path / "out" / "case.toml").motion
    path = motion.at(np.linspace(0, 4, 101)).q
    assert collisions(vg.System(), ROOM).first_contact(path) is None
    late = ("plan", "--goal", "110,0,0", "--duration", "1")
    for line, why in (
        ((*room, "--planner", "straight"), "obstacle 1 (box)"),
        ((*late, "--planner", "straight"), "velocity of joint 1 "),
        ((*late, "--planner", "direct"), "no motion: joint 1 "),
    ):
        status, out, _, result = call(*line)
        assert status == 1 and not result["feasible"]
        assert result["failure"] in out and why in result["failure"]
    assert "there are 1 s for the motion (after 0." in out and " s of planning)" in out


def test_the_search_is_as_asked(call):
    words = ("--algorithm", "rrtstar", "--evaluations", "700", "--seconds", "20")
    _, _, _, result = call("plan", "--goal", "40,20,-20", "--planner", "ompl-q", *words)
    assert result["info"]["algorithm"] == "rrtstar"
    # half of them search; relaxing what was found ends at its minimum: 566 in all
    assert 350 <= result["info"]["evaluations"] < 1200


def test_a_plan_to_a_tool_position(call):
    options = ("--tool", "0.5,0.3,1.2", "--planner", "straight", "--duration", "3")
    status, out, _, result = call("plan", *options)
    assert status == 0 and out.startswith("goal: ")
    tool = joint_positions(vg.PUMA_560, np.array(result["case"]["query"]["goal"]))[-1]
    np.testing.assert_allclose(tool, (0.5, 0.3, 1.2), atol=2e-6)


def test_a_plan_bounds_the_motion_of_the_base_and_keeps_limits(call):
    words = ("plan", "--goal", "40,20,-20", "--duration", "1")
    _, out, _, plain = call(*words, "--planner", "direct")
    options = ("--bound", "acceleration_peak=0.9", "--bound", "tip=1")
    status, out, _, calm = call(*words, *options, "--frequency-weight", "0.2:1,5:0")
    assert status == 0 and calm["planner"] == "calm:acceleration_peak=0.9+tip=1"
    assert "acceleration_peak [m/s^2]" in out and "gain 1, 0 above 1 Hz" in out
    before, after = (k["disturbance"]["simulated"] for k in (plain, calm))
    assert after["acceleration_peak"] < 0.7 * before["acceleration_peak"]
    for name, value in calm["disturbance"]["predicted"].items():
        off = 0.06 if name.endswith("_end") else 0.03  # what is left is small
        assert value == pytest.approx(after[name], rel=off), name
    assert calm["simulated"]["E_mean"] > plain["simulated"]["E_mean"]
    options = ("--planner", "direct", "--a-max", "60,60,90")
    _, _, _, slow = call("plan", "--goal", "20,10,-20", *options)
    motion = vg.load_case(slow["files"][0]).motion
    a = np.abs(motion.at(np.linspace(0, 2, 201)).a)
    assert (a <= np.deg2rad([60, 60, 90]) * 1.02).all()


@pytest.mark.parametrize("words", [("--planner", "straight"), (), ("--v-max", "none")])
def test_plan_and_simulate_say_the_same_of_a_motion(call, words):
    _, out, _, planned = call("plan", "--goal", "60,40,-30", "--duration", "1.5", *words)
    case = planned["files"][0]
    _, _, err, played = call("simulate", "--case", case, "--settle", "0.5")
    asked, known = (r["limits"]["reference"]["extremes"] for r in (planned, played))
    assert {**known, "torque": asked["torque"]} == asked  # on the base as it was foreseen
    for kind in ("velocity", "torque"):  # positions settle after the motion, at the records
        ours, theirs = (r["limits"]["simulated"]["extremes"][kind] for r in (planned, played))
        assert ours == theirs
    for of, who in (("reference", "reference"), ("simulated", "simulated arm")):
        inside = planned["limits"][of]["inside"]
        assert f"{who} {'' if inside else 'NOT '}inside the limits" in out
        assert inside == (f"{who}: " not in err)
        for line in (k for k in err.splitlines() if f"{who}: " in k):
            assert line.partition(f"{who}: ")[2] in out  # the same sentence
    expected = {"straight": (True, True), "": (True, True), "none": (False, False)}
    verdicts = tuple(planned["limits"][of]["inside"] for of in ("reference", "simulated"))
    assert verdicts == expected[words[-1] if words else ""]


# ------------------------------------------------------------------------- benchmark

THESIS = ("benchmark", "--suite", "thesis", "--vehicle", "straight-horizontal-thesis")
THESIS += ("--planners", "straight", "--workers", "1")
PART = ("benchmark", "--durations", "2", "--first", "1", "--workers", "1", "--no-figures")


def test_benchmark_shows_the_emulation_error_in_mode_emulated_only(call):
    status, out, _, ideal = call(*THESIS, "--no-figures")
    assert status == 0 and "emulation" not in out and "machine" not in ideal
    (space,) = ideal["rows"]  # twice as fast as our arm may be; nobody asked
    assert "reference NOT inside the limits, of the successes: straight 1" in out
    assert f"such as straight, {space['query']}: {space['arm_breaks']}" in out
    status, out, _, result = call(*THESIS, "--no-figures", *LAB)
    assert status == 0 and result["schema"] == ideal["schema"] == "ves-benchmark/1"
    assert "emulation" in out and "operation: microgravity" in out
    (here,) = result["rows"]
    assert here["E_mean_ideal"] == pytest.approx(space["E_mean"])
    assert f"{here['emulation_error']:+.2%}" in out and f"{here['base_error']:.2%}" in out


def test_benchmark_names_a_stop_and_draws_it(call, tmp_path):
    status, out, _, result = call(*THESIS, *LAB, "--effect", "gravity/scale:error=0.1")
    assert status == 0 and result["rows"][0]["stopped"] in out
    for name in ("report.html", "base_motion_emulated.png", "strain_energy_emulated.png"):
        assert (tmp_path / "out" / name).exists()


@pytest.mark.slow
def test_a_benchmark_of_bounds_shows_what_they_cost(call, tmp_path):
    options = ("--first", "1", "--durations", "0.5", "--workers", "1", "--planners", "straight")
    words = ("benchmark", *options, "--bounds", "acceleration_peak=0.5,1")
    status, out, _, result = call(*words)
    assert status == 0 and (tmp_path / "out" / "pareto.png").stat().st_size > 10_000
    rows = {row["planner"]: row for row in result["rows"]}
    names = ["refined", "calm:acceleration_peak=0.5", "calm"]
    assert list(rows) == ["straight", *names]
    peaks = [rows[name]["acceleration_peak"] for name in names]
    assert peaks[0] > peaks[2] > peaks[1]
    assert "Motion of base and tool" in out and "0, 1 above 1 Hz" in out


def test_benchmark_asks_any_arm_and_says_why_a_planner_refuses(call):
    _, _, _, result = call(*PART, "--planners", "straight", "--arm", "iiwa14")
    (row,) = result["rows"]
    assert row["success"] and row["query"] == "reach-2s-000"
    assert "iiwa" in result["systems"]["bent"]["description"]
    words = ("--vehicle", "free-floating", "--planners", "straight,hotspot-q,reaction-null")
    status, out, _, result = call(*PART, *words)
    failures = {r["planner"]: r["failure"] for r in result["rows"]}
    assert status == 0 and failures["straight"] is None
    assert failures["hotspot-q"].endswith("has no stiffness (Q = 0)")
    for name in ("hotspot-q", "reaction-null"):
        assert f"failed 1 x: {name}: {failures[name]}" in out


def test_a_part_of_the_suite(call):
    _, _, _, result = call(*PART, "--planners", "straight", "--obstacles", "both")
    assert [r["query"] for r in result["rows"]] == ["reach-2s-000", "reach-2s-000-obstacles"]
    _, _, _, result = call(*PART, "--planners", "straight", "--skip", "3")
    assert [r["query"] for r in result["rows"]] == ["reach-2s-003"]


# ------------------------------------------------------------- maps, gains, laboratory


def test_map_draws_every_pair_and_chooses_the_others(call, tmp_path):
    status, out, _, result = call("map", "--points", "9", "--format", "svg", "--duration", "2")
    assert status == 0 and "joints 1 and 3" in out and result["duration"] == 2.0
    assert [m["joints"] for m in result["maps"]] == [[1, 2], [1, 3], [2, 3]]
    assert "<svg" in (tmp_path / "out" / "map.svg").read_text()
    vg.System(arm=six_joint_arm()).save(tmp_path / "six.toml")
    options = ("--system", "six.toml", "--joints", "2,3", "--points", "5", "--others", "least")
    status, _, _, result = call("map", *options)
    assert status == 0 and result["others"] == "least"
    with np.load(tmp_path / "out" / "map_q2_q3.npz") as arrays:
        np.testing.assert_array_equal(arrays["angles"], result["maps"][0]["angles"])
        np.testing.assert_array_equal(arrays["most"], result["maps"][0]["most"])


QUICK = ("pped", "--objective", "strain", "--no-figures")


def test_gains_beside_the_thesis(call):
    system = vg.System(vehicle=BENT_THESIS)
    status, out, err, result = call(*QUICK, "--vehicle", "bent-thesis")
    assert status == 0 and not err
    assert result["schema"] == "ves-pped/1" and result["system"] == system.hash
    assert result["objective"] == "strain" and not result["full"]
    assert result["q"] == pytest.approx(np.deg2rad([45, 0, 0]))
    names = [g["name"] for g in result["gains"]]
    assert names == ["thesis high (4.6)", "thesis PPED (4.5)", "by strain"]
    for name in (*names, "poles", "E_int", "N m/rad", "82.29 J"):
        assert name in out
    gains = GainMatrices(np.array(result["K"]), np.array(result["B"]))
    judged = analyse(plant_at(system, result["q"]), gains)
    assert judged.E_int == pytest.approx(result["E_int"])
    for row in result["gains"]:
        assert row["simulated"]["E_int"] == pytest.approx(row["E_int"], rel=0.01)
        assert row["E_int"] >= result["E_int"] and row["t_5"] > 0 and len(row["poles"]) == 18
    status, out, _, result = call(*QUICK, "--disturb", "1000,0,0,0,0,0")
    assert status == 0 and "not simulated: simulation" in out
    assert all(g["simulated"] is None for g in result["gains"])


@pytest.mark.slow
def test_gains_elsewhere_with_map_and_pictures(call, tmp_path):
    system = vg.System(arm=six_joint_arm(), vehicle=DECOUPLED)
    system.save(tmp_path / "six.toml")
    status, out, _, result = call(*QUICK, "--system", tmp_path / "six.toml")
    assert status == 0 and "thesis high" not in out  # gains for three joints
    assert np.shape(result["K"]) == (6, 6)
    status, _, _, result = call(
        "pped", "--q", "-30,20,-40", "--objective", "worst", "--full", "--vehicle", "decoupled",
        "--disturb", "0,0.05,0,0,0,2", "--bounds", "5,500,1,100", "--no-figures", "--seed", "3",
    )  # fmt: skip
    assert status == 0 and result["seed"] == 3
    assert result["y"] == pytest.approx([0, 0.05, 0, 0, 0, np.deg2rad(2)])
    found = {g["name"]: g for g in result["gains"]}
    assert found["by worst, full"]["worst"] <= found["by worst"]["worst"] * (1 + 1e-3)
    words = ("--objective", "strain", "--map", "--points", "2", "--format", "svg")
    status, out, _, result = call("pped", *words, "--vehicle", "bent-thesis", out="pped")
    assert status == 0 and "configurations that damp best" in out
    files = {path.name for path in (tmp_path / "pped").iterdir()}
    assert files == {f"pped_{k}.svg" for k in ("poles", "responses", "configurations")}
    left = [c["E_int"] for c in result["configurations"]]
    assert left == sorted(left) and left[0] < result["E_int"]
    assert [m["joints"] for m in result["map"]] == [[1, 2], [1, 3], [2, 3]]


@pytest.mark.slow
def test_check_of_an_emulation(call, tmp_path):
    status, out, _, result = call("emulation-check", "--vehicle", "bent-thesis", "--no-figures")
    assert status == 0 and "stable" in out and "UNSTABLE" not in out
    assert result["schema"] == "ves-emulation-check/1"
    assert result["payload_ratio"] == pytest.approx(1.105, abs=0.01)
    assert result["max_bandwidth"] > 20 and len(result["modes"]) >= 6
    words = ("--no-compensation", "--no-figures", "--no-search", "--effect", COULOMB)
    status, out, _, result = call("emulation-check", *words)
    assert status == 1 and "UNSTABLE" in out
    assert not result["stable"] and result["spectral_radius"] > 1.005
    assert result["system"]["effects"][0]["kind"] == "joint/coulomb"
    words = ("--platform", "filtered", "--no-search", "--format", "pdf")
    status, _, _, result = call("emulation-check", *words)
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert status == 0 and names == {
        *(f"loop_{k}.pdf" for k in ("poles", "bode", "step")),
        *(f"leg_{k}.pdf" for k in ("open", "closed", "step", "poles")),
    }


# ------------------------------------------------------------------------------ list


def test_list_names_everything(call):
    status, out, _, result = call("list")
    assert status == 0
    unnamed = ("schema", "wires")
    names = {kind: {row["name"] for row in result[kind]} for kind in result.keys() - unnamed}
    assert {"bent", "free-floating"} <= names["vehicles"]
    assert {"straight", "direct"} <= names["planners"]
    assert {"reach100", "thesis"} <= names["suites"]
    assert {"auto", "kernel", "mujoco"} <= names["backends"]
    assert names["commands"] == set(COMMANDS)
    modes = {row["name"]: row["modes"] for row in result["effects"]}
    assert modes["sensor/noise"] == ["emulated"] and "ideal" in modes["payload/mass"]
    assert "[Hz]" in out  # a unit in a heading is not markup
    rows = {row["name"]: row for row in result["environments"]}
    assert set(rows) == {k for k in gym.registry if k.startswith("ves/")}
    for id, row in list(rows.items())[::4]:
        env = gym.make(id)
        space = env.observation_space
        if isinstance(space, gym.spaces.Dict):
            assert row["observation"] == {k: list(v.shape) for k, v in space.items()}
        else:
            assert row["observation"] == list(space.shape)
        assert row["action"] == list(env.action_space.shape)
        assert row["max_episode_steps"] == env.unwrapped.task.steps


def test_list_blocks(call):
    """One line per wire, of the system that the options describe; a file says its own mode."""
    status, out, _, result = call("list", "blocks")
    assert status == 0 and set(result) == {"schema", "blocks", "wires"}
    rows = {row["name"]: row for row in result["blocks"]}
    assert rows["admittance"]["parameters"]["M"] == [6, 6]
    assert rows["force_sensor"]["runs"] == "after engine" and rows["platform"]["compiles"]
    wires = {(w["from"], w["to"], w["signal"]): w for w in result["wires"]}
    late = wires["force_sensor", "admittance", "reading"]
    assert (late["shape"], late["unit"], late["when"]) == ([6], "N, N m", "a period later")
    for start, end, name in wires:
        lines = [k for k in out.splitlines() if all(f" {w} " in k for w in (start, end, name))]
        assert lines, (start, end, name)
    words = ("--no-compensation", "--operation", "admittance", "--platform", "8")
    names = [row["name"] for row in call("list", "blocks", *words)[3]["blocks"]]
    assert "payload_compensation" not in names and "gravity_estimate" not in names


# ------------------------------------------------------- environments, policies, sweeps


def test_evaluate_compares_on_the_same_episodes(call):
    words = ("evaluate", "PumaRestToRest-v0", "--controller", "zero,random", "--seed", 9)
    status, out, err, result = call(*words, "--episodes", 20, "--n-envs", 7)
    assert status == 0 and err == ""
    assert "zero beats random (return, intervals apart)" in out
    assert result["schema"] == "ves-evaluate/1" and result["id"] == "ves/PumaRestToRest-v0"
    zero, noisy = result["controllers"]
    assert [r["seed"] for r in zero["rows"]] == [r["seed"] for r in noisy["rows"]]
    assert zero["rows"][0]["seed"] == 9
    assert result["ratios"]["random"]["E_mean"]["low"] > 1


def test_evaluate_adds_effects_to_those_of_the_environment(call):
    words = ("--controller", "hold", "--episodes", "2", "--nominal", "--effect", COULOMB)
    (column,) = call("evaluate", "ves/PumaDamp-v0", *words)[3]["controllers"]
    assert column["settings"]["effects"] == [
        {"kind": "joint/coulomb", "torque": [3.0, 0.0, 0.0]}
    ]
    (column,) = call("evaluate", "ves/PumaDampEmulated-v0", *words)[3]["controllers"]
    kinds = [e["kind"] for e in column["settings"]["effects"]]
    assert kinds[-1] == "joint/coulomb" and "sensor/noise" in kinds


def test_a_released_policy_is_taken_by_name(call):
    words = ("evaluate", "PumaDamp-v0", "--episodes", 2)
    default = call(*words)[3]
    assert [c["name"] for c in default["controllers"]] == ["zero", "random", "ppo"]
    result = call(*words, "--controller", "high", "--policy", "released")[3]
    assert [c["name"] for c in result["controllers"]] == ["high", "ppo"]
    assert result["controllers"][1]["rows"] == default["controllers"][2]["rows"]


CONFIG = """
env = "ves/PumaRestToRest-v0"
algorithm = "PPO"
total_timesteps = 400
n_envs = 8
seeds = [0, 1]
layers = [8]
eval_episodes = 4
settings = { duration = 0.5, tail = 0.5 }
hyperparameters = { n_steps = 16, batch_size = 64, n_epochs = 1 }
"""


def test_trains_a_policy_per_seed(call, tmp_path):
    (tmp_path / "small.toml").write_text(CONFIG)
    words = ("train", "small.toml", "--steps", 130, "--seed", 3)
    status, out, err, result = call(*words, "--workers", 2)
    assert status == 0 and err == "" and "PumaRestToRest" in out
    assert result["schema"] == "ves-train/1" and result["config"]["total_timesteps"] == 130
    assert [r["seed"] for r in result["runs"]] == [3, 4]
    for r in result["runs"]:
        assert vg.load_policy(r["policy"]).about["seed"] == r["seed"] and r["policy"] in out
    status, _, err, _ = call(*words)
    assert status == 2 and "holds a run already" in err and err.count("\n") == 1
    status, _, err, again = call(*words, "--resume")
    assert status == 0 and [r["best"] for r in again["runs"]] == [
        r["best"] for r in result["runs"]
    ]


def test_a_training_that_is_stopped_says_how_it_goes_on(call, monkeypatch):
    def stopped(*args, **how):
        raise KeyboardInterrupt

    monkeypatch.setattr("ves_gym.api.train", stopped)
    status, _, err, _ = call("train", "PumaDamp-v0")
    assert status == 130
    assert err == "ves-gym: interrupted; with --resume the same command goes on\n"
    monkeypatch.setattr("ves_gym.api.evaluate", stopped)
    assert call("evaluate", "PumaDamp-v0")[2] == "ves-gym: interrupted\n"


def test_policies_are_exported_with_cards(call, tmp_path):
    status, out, _, result = call("policy", "card", "PumaDamp/ppo", "--episodes", 2)
    assert status == 0 and "PumaDamp-ppo.md" in out
    assert (tmp_path / "out" / "PumaDamp-ppo.md").read_text().startswith("# PumaDamp/ppo")
    pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    status, out, _, result = call("policy", "export", "PumaDamp/ppo", "--onnx")
    assert status == 0 and result["onnx"][0]["difference"] < 1e-5


SPEC = """
[[evaluate]]
envs = ["BeamLQR-v0"]
policies = ["zero", "high"]
episodes = 2
"""
SEARCH = """
[search]
trials = 2
batch = 2
objective = "E_mean"
space = { "evaluate.0.settings.shift" = { low = 1e-3, high = 4e-3 } }
"""


def test_sweeps_merges_and_says_what_failed(call, tmp_path):
    (tmp_path / "spec.toml").write_text(SPEC)
    words = ("sweep", "spec.toml", "--workers", 1)
    status, out, err, result = call(*words)
    assert (status, err) == (0, "") and "2 units done, 0 were done before, 0 failed" in out
    assert result["schema"] == "ves-sweep/1" and len(result["done"]) == 2
    folder = tmp_path / "out"
    rows = (folder / "rows.jsonl").read_text().splitlines()
    assert len(rows) == result["rows"] == 4
    assert "0 units done, 2 were done before" in call(*words)[1]
    status, out, _, result = call("merge", folder, folder)
    assert status == 0 and result["units"] == 2 and result["rows"] == {"evaluate": 4}
    assert (folder / "rows.jsonl").read_text().splitlines() == rows
    (tmp_path / "spec.toml").write_text(SPEC.replace('"high"', '"resolved"'))
    status, out, err, result = call(*words, out="failing")
    assert status == 1 and "1 units done" in out and "failed: evaluate" in err
    assert len(result["failed"]) == 1 and len(result["done"]) == 1


def test_searches(call, tmp_path):
    pytest.importorskip("optuna")
    (tmp_path / "spec.toml").write_text(SPEC + SEARCH)
    status, out, err, result = call("search", "spec.toml", "--workers", 1)
    assert (status, err) == (0, "") and "2 of 2 trials complete" in out and "shift" in out
    assert result["schema"] == "ves-search/1" and len(result["trials"]) == 2
    assert result["best"]["value"] == min(t["value"] for t in result["trials"])


RECIPE = """
env = "ves/BeamLQR-v0"
seed = 5
episodes = 2

[[set]]
name = "mixed"
behaviours = ["random", "lqr"]
"""


def test_data_sets_are_listed_made_and_checked(call, tmp_path):
    status, out, err, result = call("dataset", "list")
    assert (status, err) == (0, "") and "/mixed-v0" in out
    assert {"random-v0", "mixed-v0"} <= {s["id"].rpartition("/")[2] for s in result["sets"]}
    pytest.importorskip("minari")
    h5py = pytest.importorskip("h5py")
    file = tmp_path / "mine.toml"
    file.write_text(RECIPE)
    status, out, err, result = call("dataset", "make", file)
    assert (status, err) == (0, "") and "replayed bit for bit" in out
    (made,) = result["sets"]
    assert made["episodes"] == 2 and made["exact"]
    assert call("dataset", "check", made["folder"])[0] == 0
    with h5py.File(Path(made["folder"]) / "data" / "main_data.hdf5", "a") as data:
        data["episode_1"]["rewards"][0] += 0.5
    status, out, err, _ = call("dataset", "check", made["folder"])
    assert status == 1 and "WRONG" in out and "rewards differ by up to 0.5" in err


def test_the_result_may_not_replace_the_log_s_metadata(tmp_path, capsys):
    words = ["simulate", "--out", str(tmp_path), "--json", str(tmp_path / "run.json")]
    assert main(words) == 2
    assert "metadata" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
