"""Machines in URDF and MJCF: payloads, coupled shafts, friction of an arm, unknown scales."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.diagnosis.machines import rigid_arm
from ves_gym._util.params import ParameterError
from ves_gym._util.signals import downsampled
from ves_gym.cli.main import main
from ves_gym.diagnosis import diagnose as d
from ves_gym.diagnosis.data.drive_gains import with_drive_gains
from ves_gym.diagnosis.data.measured_run import run_of_signals
from ves_gym.diagnosis.data.sanity_checks import suspected_mistake
from ves_gym.diagnosis.machines.joint_changes import CarriedBody, Shaft
from ves_gym.diagnosis.machines.joint_library import MjcfJoint
from ves_gym.diagnosis.machines.mapping import read_machine
from ves_gym.diagnosis.machines.mjcf import MjcfMachine
from ves_gym.diagnosis.machines.rigid_bodies import BodyChange, MjcfBodies, UrdfBodies
from ves_gym.effects import JointViscous

TYPED = [(name, "hinge") for name in rigid_arm.JOINTS]
JOINTS = [MjcfJoint(name) for name in rigid_arm.JOINTS]
SHAFT = (0.0, 0.5, 1.0)  # turns of a shaft per turn of each joint
NOISE = {"q": 2e-5, "tau": 0.05}


@pytest.fixture(scope="module")
def bodies(tmp_path_factory):
    path = tmp_path_factory.mktemp("arm") / "small.urdf"
    path.write_text(rigid_arm.urdf("package://nowhere/link.stl"))
    return UrdfBodies(path, TYPED)


def logged(seed, viscous=0.0, coulomb=0.0, shaft=None, gain=(1.0,) * 3, seconds=12.0, **load):
    """A run: what the arm's motion and its friction take, with noise."""
    t, q, v, a = rigid_arm.motion(seed, seconds)
    rng = np.random.default_rng(seed)
    tau = rigid_arm.load(q, v, a, **load) + rigid_arm.friction(v, viscous, coulomb)
    if shaft is not None:
        ratio, rate = np.array(SHAFT), v @ np.array(SHAFT)
        turning = shaft[0] * np.sign(rate) + shaft[1] * rate + shaft[2] * (a @ ratio)
        tau = tau + turning[:, None] * ratio
    q = q + NOISE["q"] * rng.standard_normal(q.shape)
    tau = (tau + NOISE["tau"] * rng.standard_normal(q.shape)) / np.array(gain)
    t = t + 1e-4 * rng.standard_normal(len(t))  # a clock that is read a little late or early
    return run_of_signals(t, {"q": q, "tau": tau}, f"run {seed}")


def test_two_engines_give_the_same_forces_for_bodies_changed_and_loaded(bodies):
    """Reference: MuJoCo's inverse dynamics of the same file, its own link by its own name."""
    other = MjcfBodies(rigid_arm.mjcf(), TYPED)
    _, q, v, a = (x[:50] for x in rigid_arm.motion(0))
    change = [BodyChange(1, 1.3, (0.01, -0.02, 0.03))]
    assert bodies.bodies == other.bodies
    for changes in ([], change):
        assert bodies.load(q, v, a, changes) == pytest.approx(
            other.load(q, v, a, changes), abs=1e-10
        )
    columns = bodies.payload(q, v, a)
    assert columns == pytest.approx(other.payload(q, v, a), abs=1e-8)
    mass, centre = 2.0, np.array([0.1, 0.02, 0.05])
    inertia = mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    six = [inertia[i, j] for i, j in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))]
    carried = rigid_arm.load(q, v, a, mass, tuple(centre)) - rigid_arm.load(q, v, a)
    assert columns @ [mass, *mass * centre, *six] == pytest.approx(carried, abs=1e-6)


@pytest.mark.slow
def test_friction_of_an_arm_and_of_a_coupled_shaft_are_two_causes(bodies):
    machine = MjcfMachine("arm", JOINTS, bodies, couplings=[SHAFT])
    hidden = {"viscous": (2.0, 3.0, 1.0), "coulomb": (4.0, 6.0, 3.0)}
    run = logged(1, **hidden, shaft=(2.5, 0.8, 0.05))
    assert suspected_mistake(machine, run) is None
    found = d.diagnose(machine, [run], candidates=machine.candidates())
    named = {f.candidate.kind: f for f in found.explanations}
    assert set(named) == {"joint/friction", "shaft/friction"}, found.sentence
    values = [*hidden["viscous"], *hidden["coulomb"]]
    assert named["joint/friction"].values == pytest.approx(values, rel=0.1, abs=0.1)
    assert named["shaft/friction"].values == pytest.approx([2.5, 0.8, 0.05], rel=0.1, abs=0.02)
    assert named["shaft/friction"].candidate.slot == "shoulder and elbow"


@pytest.mark.parametrize("kind", ["urdf", pytest.param("mjcf", marks=pytest.mark.slow)])
def test_a_payload_is_one_cause_with_mass_and_centre(bodies, kind):
    machine = MjcfMachine("arm", JOINTS, bodies if kind == "urdf" else rigid_arm.mjcf())
    run = logged(2, mass=2.8, centre=(0.2, 0.0, 0.06))
    found = d.diagnose(machine, [run], candidates=machine.candidates())
    (named,) = found.explanations
    assert named.candidate.name == "payload/body"
    body = named.candidate.effect(named.values)
    assert body.mass == pytest.approx(2.8, rel=0.05)
    assert body.centre == pytest.approx((0.2, 0.0, 0.06), abs=0.01)


def test_nothing_is_missing_where_the_description_has_it_all(bodies):
    body = CarriedBody(1.0, (0.1, 0.0, 0.0), (0.0, 0.0, 0.01, 0.0, 0.0, 0.01))
    effects = [body, Shaft(SHAFT, 2.0, 0.5), JointViscous(damping=(2.0, 2.0, 2.0))]
    machine = MjcfMachine("arm", JOINTS, bodies, effects=effects)
    run = logged(7, 2.0, 0.0, (2.0, 0.5, 0.0), seconds=20.0, mass=1.0, centre=(0.1, 0.0, 0.0))
    found = d.diagnose(machine, [run], candidates=machine.candidates())
    assert found.verdict == d.NOTHING, found.sentence


def test_a_drive_without_a_scale_gets_it_from_the_load(bodies):
    joints = [MjcfJoint(name, gain_unknown=True) for name in rigid_arm.JOINTS]
    machine = MjcfMachine("arm", joints, bodies)
    gain = (11.0, -25.0, 0.4)
    run = logged(4, (1.0, 1.0, 0.5), (2.0, 2.0, 1.0), gain=gain)
    (scaled,), notes = with_drive_gains(machine, [run], [0])
    assert scaled["tau"] / run["tau"] == pytest.approx(np.tile(gain, (run.length, 1)), rel=0.02)
    assert len(notes) == 3 and "found in the data" in notes[0]
    assert not any(c.kind == "joint/drive_gain" for c in machine.candidates())
    still = run.with_signals({"tau": np.zeros_like(run["tau"])})
    with pytest.raises(ParameterError, match="gain of waist cannot be told"):
        with_drive_gains(machine, [still], [0])


MAPPING = """
schema = "ves-machine/1"
name = "small arm"
model = "small.urdf"
time = { step = 6.666666666666667e-4, start = 0.5, stop = 6.5 }
known = { "inertia of *" = 0.003 }
[[joint]]
name = "waist"
position = { column = "angle:j1" }
force = { column = "torque:j1" }
[[joint]]
name = "shoulder"
position = { column = "angle:j2" }
force = [{ column = "torque:j2" }, { column = "torque:j3", gain = 0.5 }]
[[joint]]
name = "elbow"
position = [{ column = "angle:j3" }, { column = "angle:j2", gain = -0.5 }]
force = { column = "torque:j3" }
"""


def test_a_urdf_and_csv_without_a_clock_go_to_a_better_mapping(tmp_path, capsys):
    """Motor angles and torques at 1.5 kHz in two files with the same names of columns."""
    (tmp_path / "small.urdf").write_text(rigid_arm.urdf())
    (tmp_path / "arm.toml").write_text(MAPPING)
    (tmp_path / "run").mkdir()
    _, q, v, a = rigid_arm.motion(5, seconds=7.0, rate=1500.0)
    tau = rigid_arm.load(q, v, a) + rigid_arm.friction(v, 2.0, 3.0)
    motors = np.column_stack([q[:, :2], q[:, 2] + 0.5 * q[:, 1]])
    drives = np.column_stack([tau[:, 0], tau[:, 1] - 0.5 * tau[:, 2], tau[:, 2]])
    rng = np.random.default_rng(0)
    for name, x, noise in (("angle", motors, 2e-5), ("torque", drives, 0.05)):
        noisy = x + noise * rng.standard_normal(x.shape)
        path = tmp_path / "run" / f"{name}.csv"
        np.savetxt(path, noisy, "%.9g", ",", header="j1,j2,j3", comments="")
    (tmp_path / "run" / "notes.csv").write_text("name,value\npublished,8.05\n")
    machine, load = read_machine(tmp_path / "arm.toml")
    assert machine.couplings == ((0.0, 0.5, 1.0),)
    assert {k.std for k in machine.nuisances if k.name.startswith("inertia")} == {0.003}
    run = load(tmp_path / "run")
    assert (run.dt, run.length) == (pytest.approx(1 / 1500), 9001)
    out = tmp_path / "out"
    words = ["diagnose", str(tmp_path / "run"), "--machine", str(tmp_path / "arm.toml")]
    words += ["--band", "6", "--no-figures", "--out", str(out)]
    assert main(words) == 0
    found = json.loads((out / "diagnosis.json").read_text())
    assert [e["kind"] for e in found["effects"]] == ["joint/friction"]
    assert any("down-sampled from 1500 Hz to 750 Hz" in note for note in found["notes"])
    assert found["replay_difference"] <= 1e-9
    better, _ = read_machine(out / "machine.toml")
    assert {e.kind for e in better.nominal.effects} == {"joint/viscous", "joint/coulomb"}
    assert Path(better.bodies.path).resolve() == (tmp_path / "small.urdf").resolve()


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ('"angle:j1"', '"j1"', "no column 'j1'; it has angle:j1"),
        ("step =", "offset =", "a column or a step"),
        ("start = 0.5", "start = 99.0", "no rows between start and stop"),
        ('"inertia of *"', '"inertia of waste_link"', "known: no tolerance"),
        ('"small.urdf"', '"none.urdf"', "none.urdf: cannot be read"),
    ],
)
def test_a_mapping_that_does_not_fit_is_refused_by_its_key(tmp_path, old, new, match):
    (tmp_path / "small.urdf").write_text(rigid_arm.urdf())
    (tmp_path / "run").mkdir()
    for name in ("angle", "torque"):
        text = "j1,j2,j3\n" + "".join(f"{k},{k},{name == 'angle'}\n" for k in range(9))
        text = text.replace("True", "1").replace("False", "0").replace("8,8", f"8,{len(name)}")
        (tmp_path / "run" / f"{name}.csv").write_text(text.replace("0,0", f"{len(name)},0", 1))
    (tmp_path / "arm.toml").write_text(MAPPING.replace(old, new, 1))
    with pytest.raises(ParameterError, match=match):
        read_machine(tmp_path / "arm.toml")[1](tmp_path / "run")


def test_a_down_sampled_signal_has_its_motion_and_nothing_folded_into_it():
    t = np.arange(20000) / 5000
    slow, fast = np.sin(2 * np.pi * 20 * t), np.sin(2 * np.pi * 1010 * t)
    out = downsampled(np.stack([slow + fast, slow], axis=1), 5)
    inner = slice(50, -50)
    assert out[inner, 1] == pytest.approx(slow[::5][inner], abs=1e-4)
    assert np.abs(out[inner, 0] - out[inner, 1]).max() < 1e-4


def test_joints_of_a_urdf_that_stand_still_are_locked(tmp_path):
    path = tmp_path / "small.urdf"
    path.write_text(rigid_arm.urdf())
    with pytest.raises(ParameterError, match="joints of the model without columns: elbow"):
        UrdfBodies(path, TYPED[:2])
    two = UrdfBodies(path, TYPED[:2], ["elbow"])
    _, q, v, a = (x[:20] for x in rigid_arm.motion(0))
    still = (x * [1.0, 1.0, 0.0] for x in (q, v, a))
    whole = UrdfBodies(path, TYPED).load(*still)[:, :2]
    assert two.load(q[:, :2], v[:, :2], a[:, :2]) == pytest.approx(whole, abs=1e-12)


def test_a_urdf_whose_last_link_has_no_inertia_is_good_enough(tmp_path):
    """No simulation could run it; what its motion takes is that of a point mass there."""
    text, tiny = rigid_arm.urdf(), 'ixx="0.015" iyy="0.018" izz="0.0135"'
    assert tiny in text
    path = tmp_path / "small.urdf"
    path.write_text(text.replace(tiny, 'ixx="0" iyy="0" izz="0"'))
    _, q, v, a = (x[:20] for x in rigid_arm.motion(0))
    (tmp_path / "whole.urdf").write_text(text)
    whole = UrdfBodies(tmp_path / "whole.urdf", TYPED).load(q, v, a)
    less = whole - UrdfBodies(path, TYPED).load(q, v, a)
    turn = a[:, 1] + a[:, 2]  # of the last link about the axis of shoulder and elbow
    assert less[:, 2] - 0.018 * turn == pytest.approx(
        (0.0135 - 0.015) * v[:, 0] ** 2 * np.sin(2 * (q[:, 1] + q[:, 2])) / 2, abs=1e-9
    )
