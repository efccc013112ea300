"""A case: written by every verb, read by every verb, and the next line plays it."""

import dataclasses
import shlex
from pathlib import Path

import numpy as np
import pytest

import ves_gym as vg
from ves_gym._util.params import write_table
from ves_gym.effects import JointCoulomb
from ves_gym.mechanics.arm_library import get_arm
from ves_gym.mechanics.motion import Motion
from ves_gym.planners.obstacles import Sphere, Surroundings

ROOT = Path(__file__).parents[2]
MAST = (str(ROOT / "examples" / "mast.pch"), "--interface", "4", "--units", "m-kg-s")
GOAL = (0.3, 0.2, -0.1)


@pytest.fixture(scope="module")
def plan():
    return vg.plan(goal=GOAL, duration=1.0, planner="straight", seed=3)


def next_line(out):
    """The words of the line that a command names, as a shell splits them."""
    (line,) = [k.removeprefix("next: ") for k in out.splitlines() if k.startswith("next: ")]
    program, *words = shlex.split(line)
    assert program == "ves-gym"
    return words


# --------------------------------------------------------------------- the printed line


@pytest.mark.parametrize("machine", ["mast", pytest.param("ur5e", marks=pytest.mark.slow)])
def test_the_next_line_plays_the_plan_on_its_machine(call, machine):
    """The energy is that of the plan, to 0.1 %: the records of the two are 10 times apart."""
    words = ["--goal", "20,-20,30,10,10,10", "--arm", "ur5e"]
    if machine == "mast":
        assert call("structure", *MAST, "--damping", "0.01", "--save", "my mast.toml")[0] == 0
        words = ["--goal", "30,20,-15", "--vehicle", "my mast.toml"]
    words += ["--planner", "straight", "--duration", "2"]
    status, out, _, planned = call("plan", *words, out="with a space")
    assert status == 0
    line = next_line(out)
    assert line == ["simulate", "--case", "with a space/case.toml"]
    status, _, err, played = call(*line, out=None)
    assert (status, err) == (0, "")
    energy = planned["simulated"]["E_mean"]
    assert played["energies"]["E_mean"] == pytest.approx(energy, rel=1e-3)
    assert played["system"] == vg.load_case(line[2]).system.hash
    assert played["log"] == "with a space/run.csv"
    assert vg.RunLog.load(played["log"]).digest == played["digest"]


def test_the_case_of_a_structure_has_the_arm_that_it_was_read_for(call):
    status, out, _, _ = call("structure", *MAST, "--damping", "0.01", "--arm", "ur5e")
    line = next_line(out)
    assert status == 0 and line[:2] == ["simulate", "--case"]
    system = vg.load_case(line[2]).system
    assert system.arm == vg.System(arm="ur5e").arm
    assert system.vehicle == vg.get_vehicle("out/vehicle.toml")


def test_the_next_line_of_a_run_and_of_weighed_poses(call):
    words = ("simulate", "--mode", "emulated", "--poses", "12", "--log", "a b.csv")
    assert call(*next_line(call(*words)[1]))[3]["poses"] == 12
    _, out, _, result = call("simulate", "--duration", "1", "--settle", "0.2", out="a b")
    assert next_line(out) == ["view", "a b/run.case.toml"]
    assert vg.load_case("a b/run.case.toml").log == result["log"]


def test_a_case_on_another_machine_says_so(call, plan):
    plan.case.save("case.toml")
    slow = ("simulate", "--case", "case.toml", "--settle", "0.2")
    status, _, err, own = call(*slow)
    assert status == 0 and err == ""
    status, _, err, other = call(*slow, "--vehicle", "bent-thesis")
    assert status == 0 and own["system"] != other["system"]
    assert err.startswith("ves-gym: note: the case is of <System: puma560 on bent") and (
        "this machine is <System: puma560 on bent-thesis" in err
    )


def test_a_case_is_asked_again(call, plan):
    plan.case.save("case.toml")
    _, _, _, again = call("plan", "--case", "case.toml", "--planner", "straight")
    assert again["predicted"] == plan.predicted.to_dict() and again["case"]["seed"] == 3
    _, _, _, slower = call("plan", "--case", "case.toml", "--duration", "2")
    assert slower["case"]["query"]["duration"] == 2.0
    assert slower["case"]["query"]["goal"] == list(GOAL)


# ---------------------------------------------------------------------------- the file


def test_a_case_is_the_same_when_it_is_read(plan, tmp_path):
    room = Surroundings(obstacles=(Sphere(centre=(1.0, 1.0, 1.0), radius=0.1),))
    hidden = vg.System(
        arm=get_arm("puma560"), mode="emulated", effects=(JointCoulomb(torque=(1.0, 0, 0)),)
    )
    query = dataclasses.replace(plan.query, v_max=None, surroundings=room)
    for case in (
        plan.case,
        vg.Case(system=hidden, motion=plan.motion, log=str(tmp_path / "logs" / "a.csv")),
        vg.Case(system=query.system, query=query, servo=query.servo),
        vg.Case(system=vg.System(arm=get_arm("ur5e")), seed=7),
    ):
        for name in ("case.toml", "case.json"):
            case.save(tmp_path / name)
            assert vg.load_case(tmp_path / name) == case
    assert "\n" not in repr(case)
    text = (tmp_path / "case.toml").read_text()
    assert 'arm = "ur5e"' in text and 'vehicle = "bent"' in text


def test_a_case_whose_base_moves_already_is_read(tmp_path):
    """No motor holds against it, so the usual servo foresees nothing, in query and case."""
    file = tmp_path / "case.toml"
    query = "start = [0, 0, 0]\ngoal = [0.3, 0.2, -0.2]\nduration = 2.0"
    file.write_text(f"[query]\n{query}\n[query.base]\nyd = [0.01, 0, 0, 0, 0, 0]\n")
    case = vg.load_case(file)
    assert case.query.base.yd[0] == 0.01
    assert case.query.servo == case.servo and not case.servo.moving_base
    file.write_text(f"[query]\n{query}\n")
    assert vg.load_case(file).servo.moving_base


def test_a_person_writes_a_case(tmp_path):
    """Names of the package, files from the case's folder, the arm's own speed limits."""
    write_table(tmp_path / "mast.toml", vg.get_vehicle("bent-thesis"))
    (tmp_path / "case.toml").write_text(
        'log = "run.csv"\n[system]\nvehicle = "mast.toml"\n'
        "[query]\nstart = [0, 0, 0]\ngoal = [0.3, 0.2, -0.1]\nduration = 1\n"
    )
    case = vg.load_case(tmp_path / "case.toml")
    assert case.log == str(tmp_path / "run.csv")
    assert case.query.v_max == tuple(vg.PUMA_560.column("v_max"))
    assert case.system == vg.System(vehicle=vg.get_vehicle("bent-thesis"))
    log = vg.simulate(case, settle=0.1)
    np.testing.assert_allclose(log.q_cmd[-1], GOAL)


BAD = {
    "a key": ("sede = 1", 'did you mean "seed"'),
    "a key of the system": ("[system]\nphysics_d = 0.001", 'did you mean "physics_dt"'),
    "a key of the query": ("[query]\ngaol = [0, 0, 0]", "unknown key 'gaol'"),
    "a servo said twice": ("[query]\nservo = 1", "query.servo is said once"),
    "an arm": ('[system]\narm = "ur5"', 'did you mean "ur5e"'),
    "a file": ('[system]\nvehicle = "no.toml"', "no.toml"),
    "a seed": ("seed = -1", "whole number >= 0"),
    "joints": ("[motion]\nduration = 1.0\ncontrol = " + str([[0.0, 0.0]] * 6), "has 3 joints"),
    "points": ("[motion]\nduration = 1.0\ncontrol = [[0.0, 0.0], [0.0]]", "rows of n numbers"),
    "few points": ("[motion]\nduration = 1.0\ncontrol = [[0.0, 0.0, 0.0]]", "shape"),
    "a duration": ("[motion]\nduration = -1.0\ncontrol = []", "> 0"),
    "no TOML": ("[", "not valid TOML"),
}


@pytest.mark.parametrize("case", BAD)
def test_what_is_wrong_with_a_case_is_one_line(refused, tmp_path, case):
    text, expected = BAD[case]
    (tmp_path / "case.toml").write_text(text)
    line = refused("simulate", "--case", "case.toml")
    assert expected in line and "case.toml" in line


def test_a_case_excludes_what_it_says(refused, plan):
    plan.case.save("case.toml")
    assert "leave out --goal" in refused("simulate", "--case", "case.toml", "--goal", "1,1,1")
    both = ("--case", "case.toml", "--system", "macro-micro-reduced")
    assert "--case and --system" in refused("map", *both)
    assert "the case names no log" in refused("view", "case.toml")


def test_a_motion_of_another_arm_is_no_case(plan):
    with pytest.raises(vg.ParameterError, match="ur5e has 6 joints, got 3 in the motion"):
        vg.Case(system=vg.System(arm=get_arm("ur5e")), motion=plan.motion)
    with pytest.raises(vg.ParameterError, match="the case's own system"):
        vg.Case(system=vg.System(mode="emulated"), query=plan.query)
    with pytest.raises(vg.ParameterError, match="a case of a system alone"):
        vg.simulate(vg.Case())
    assert isinstance(vg.simulate(plan.case, settle=0.0).meta["limits"]["inside"], bool)
    assert isinstance(plan.case.motion, Motion)
