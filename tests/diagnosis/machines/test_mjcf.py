"""A machine in MJCF: hidden friction is named, a complete model left alone, files are read."""

import json

import mujoco
import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.cli.main import main
from ves_gym.diagnosis import diagnose as d
from ves_gym.diagnosis.data.measured_run import run_of_signals
from ves_gym.diagnosis.inference.cache import AnswerCache
from ves_gym.diagnosis.machines.joint_library import MjcfJoint
from ves_gym.diagnosis.machines.mapping import read_machine
from ves_gym.diagnosis.machines.mjcf import MjcfMachine
from ves_gym.diagnosis.output.mjcf_file import write_machine
from ves_gym.effects import (
    JointCoulomb,
    JointDriveGain,
    JointMeasurementDelay,
    JointRotorInertia,
    JointViscous,
    SensorBias,
)

ARM = """<mujoco>
  <option timestep="0.001" integrator="RK4"/>
  <worldbody>
    <body name="upper">
      <joint name="shoulder" axis="0 1 0" {shoulder}/>
      <geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.04" mass="3" contype="0"/>
      <body name="fore" pos="0.4 0 0">
        <joint name="reach" type="slide" axis="1 0 0" {reach}/>
        <geom type="box" size="0.1 0.03 0.03" mass="1.5" contype="0"/>
      </body>
    </body>
  </worldbody>
</mujoco>"""
JOINTS = (MjcfJoint("shoulder"), MjcfJoint("reach", "slide", 0.1))
PLAIN = {"shoulder": "", "reach": ""}


def moved(seed, steps=12000, **hidden):
    """A run of the arm under control, with what is hidden in its joints."""
    t, signals = recorded(seed, steps, **hidden)
    return run_of_signals(t, signals, f"run {seed}")


def recorded(seed, steps=12000, **hidden):
    model = mujoco.MjModel.from_xml_string(ARM.format(**{**PLAIN, **hidden}))
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    waves, phase = rng.uniform(0.2, 1.2, (3, 2)), rng.uniform(0, 6, (3, 2))
    size, kp, kd = np.array([0.4, 0.05]), np.array([600.0, 6000.0]), np.array([60.0, 300.0])
    rows = []
    for k in range(steps):
        angle = 2 * np.pi * waves * data.time + phase
        want = size * np.sin(angle).sum(axis=0)
        rate = size * (2 * np.pi * waves * np.cos(angle)).sum(axis=0)
        if k == 0:
            data.qpos, data.qvel = want, rate
        force = kp * (want - data.qpos) + kd * (rate - data.qvel)
        if k % 2 == 0:  # the force that acts around this instant: it is held for a step
            mean = (force + data.qfrc_applied) / 2 if k else force
            rows.append([data.time, *data.qpos, *data.qvel, *mean])
        data.qfrc_applied[:] = force
        mujoco.mj_step(model, data)
    t, q, v, tau = np.split(np.array(rows), [1, 3, 5], axis=1)
    noise = [1e-6, 1e-6] * rng.standard_normal(q.shape)
    force = np.array([0.02, 0.05]) * rng.standard_normal(q.shape)
    signals = {"q": q + noise, "v": v, "tau": tau + force}
    return t[:, 0], signals


@pytest.fixture(scope="module")
def machine():
    return MjcfMachine("arm", JOINTS, mujoco.MjModel.from_xml_string(ARM.format(**PLAIN)))


def only_force(machine):
    """What acts on the force; the rates of the simulation are exact."""
    return [c for c in machine.candidates() if "joint" in c.ports]


def test_nothing_is_found_where_nothing_is_hidden(machine):
    t, signals = recorded(1, 6000)
    noise = {"q": 1e-6, "v": 1e-6, "tau": [0.02, 0.05]}
    told = []
    for stated in ((), ("q", "v"), tuple(noise)):
        meta = {"noise_std": {k: noise[k] for k in stated}}
        run = run_of_signals(t, signals, "run 1", meta=meta)
        found = d.diagnose(machine, [run], candidates=only_force(machine))
        assert found.verdict == d.NOTHING, found.sentence
        assert found.sentence.count("[noise]") == (found.noise_unknown != ())
        told.append(found.noise_unknown)
    assert told == [("q", "v", "tau"), ("tau",), ()]


def test_friction_hidden_in_the_joints_is_named_in_their_units(machine):
    damped = {"shoulder": 'damping="2.0"', "reach": 'damping="30"'}
    runs = [moved(seed, 6000, **damped) for seed in (2, 3)]
    found = d.diagnose(machine, runs[:1], runs[1:], candidates=only_force(machine))
    named = {f.candidate.name: (f.values[0], f.candidate.units) for f in found.explanations}
    assert named == {
        "joint/viscous at shoulder": (pytest.approx(2.0, rel=0.02), ("N m s/rad",)),
        "joint/viscous at reach": (pytest.approx(30.0, rel=0.02), ("N s/m",)),
    }
    gaps = [g for g in found.final if g.port == "joint"]
    assert all(g.after < min(1.2, g.before / 2) for g in gaps), gaps


COMMAND = """
schema = "ves-machine/1"
name = "arm"
model = "arm.xml"
time = { column = "t" }
noise = { position = 1e-6 }
[[joint]]
name = "shoulder"
position = { column = "q1" }
force = [{ column = "i1" }]
[[joint]]
name = "reach"
type = "slide"
radius = 0.1
position = { column = "q2" }
force = [{ column = "i2" }]
"""


@pytest.mark.slow
def test_a_machine_in_mjcf_goes_from_command_to_files_that_play_the_same(tmp_path, capsys):
    """What MJCF holds is in the model, the rest in the mapping; both are found right again."""
    motor = '<actuator><motor joint="shoulder" gear="50"/></actuator></mujoco>'
    xml = ARM.format(shoulder='damping="1"', reach="").replace("</mujoco>", motor)
    (tmp_path / "arm.xml").write_text(xml)
    (tmp_path / "arm.toml").write_text(COMMAND)
    for seed in (2, 3):
        t, x = recorded(seed, 6000, shoulder='damping="3"', reach='damping="30"')
        x["tau"][:, 0] /= 0.9  # the drive gives a tenth less than it says
        table = np.column_stack([t, x["q"], x["tau"]])
        path = tmp_path / f"run-{seed}.csv"
        np.savetxt(path, table, "%.12g", ",", header="t,q1,q2,i1,i2", comments="")
    words = ["diagnose", str(tmp_path / "run-2.csv"), str(tmp_path / "run-3.csv"), "--final"]
    words += ["1", "--no-figures", "--machine"]
    out = tmp_path / "out"
    assert main([*words, str(tmp_path / "arm.toml"), "--out", str(out)]) == 0
    found = json.loads((out / "diagnosis.json").read_text())
    named = {(e["kind"], e["slot"]): e["value"] for e in found["effects"]}
    assert set(named) == {
        ("joint/viscous", "shoulder"),
        ("joint/viscous", "reach"),
        ("joint/drive_gain", "shoulder"),
    }
    assert found["replay_difference"] <= 1e-9 and found["held_back"] == ["run-3.csv"]
    model = mujoco.MjModel.from_xml_path(str(out / "model.xml"))
    gain = named["joint/drive_gain", "shoulder"]["error"]
    assert gain == pytest.approx(-0.1, abs=0.01)
    assert model.dof_damping == pytest.approx([3.0, 30.0], rel=0.05)
    assert model.actuator_gear[0, 0] == pytest.approx(50 * (1 + gain))
    machine, load = read_machine(out / "machine.toml")
    assert [e.kind for e in machine.nominal.effects] == ["joint/drive_gain"]
    again = d.diagnose(machine, [load(tmp_path / "run-3.csv")], candidates=only_force(machine))
    assert again.explanations == (), again.sentence
    assert main([*words, str(out / "machine.toml"), "--out", str(out)]) == 2
    assert "would overwrite" in capsys.readouterr().err


def test_friction_and_rotor_of_a_model_are_those_of_the_library(machine):
    """The same numbers in the model and as effects leave the same residual."""
    run = moved(4)
    own = {"shoulder": 'frictionloss="2" armature="0.1"', "reach": 'damping="7"'}
    model = mujoco.MjModel.from_xml_string(ARM.format(**own))
    stated = MjcfMachine("arm", JOINTS, model)
    effects = (
        JointCoulomb(torque=(2.0, 0.0)),
        JointRotorInertia(added=(0.1, 0.0)),
        JointViscous(damping=(0.0, 0.07)),  # 7 N s/m on a pinion of 0.1 m
        JointMeasurementDelay(delay=2e-3),
    )
    late = stated.model([effects[-1]])
    one = stated.residuals(run, [late], ["joint"])["joint"]
    other = machine.residuals(run, [machine.model(effects)], ["joint"])["joint"]
    assert np.abs(one - other).max() < 1e-9


@pytest.mark.parametrize(
    ("effects", "match"),
    [
        ([JointCoulomb(torque=(1.0,))], "torque must have 2 numbers, got 1"),
        ([SensorBias(force=(1.0, 0.0, 0.0))], "sensor/bias is not computed for MJCF"),
    ],
)
def test_effects_that_a_machine_cannot_have_are_refused(effects, match):
    model = mujoco.MjModel.from_xml_string(ARM.format(**PLAIN))
    with pytest.raises(ParameterError, match=match):
        MjcfMachine("arm", JOINTS, model, effects=effects)


def test_a_model_whose_files_lie_elsewhere_still_finds_them(tmp_path, machine):
    """Meshes are named from the model's folder; the better model lies in another."""
    corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    faces = ["1 3 2", "1 2 4", "1 4 3", "2 3 4"]
    text = [f"v {x} {y} {z}" for x, y, z in corners] + [f"f {f}" for f in faces]
    (tmp_path / "in" / "parts").mkdir(parents=True)
    (tmp_path / "in" / "parts" / "wedge.obj").write_text("\n".join(text))
    asset = '<compiler meshdir="parts"/><asset><mesh name="w" file="wedge.obj"/></asset>'
    body = '<geom type="mesh" mesh="w" mass="0.1" contype="0"/>'
    xml = ARM.format(**PLAIN).replace("<option", asset + "<option")
    xml = xml.replace('<body name="fore"', body + '<body name="fore"')
    (tmp_path / "in" / "arm.xml").write_text(xml)
    (tmp_path / "in" / "arm.toml").write_text(COMMAND)
    own, _ = read_machine(tmp_path / "in" / "arm.toml")
    effects, out = [JointViscous(damping=(2.0, 0.0))], tmp_path / "deep" / "out"
    out.mkdir(parents=True)
    written = write_machine(tmp_path / "in" / "arm.toml", own, effects, out, [moved(4)])
    assert written.difference <= 1e-9 and "+" in written.diff
    read_machine(out / "machine.toml")


def test_a_diagnosis_that_is_interrupted_goes_on(machine, tmp_path):
    """Nothing is computed twice, a damaged file is computed again, the answer is the same."""
    run = moved(2, 3000, shoulder='damping="2.0"')
    few = [c for c in only_force(machine) if c.kind in ("joint/viscous", "joint/coulomb")]

    def answer(interrupted=False):
        asked = []
        cache = AnswerCache(tmp_path, "arm")

        def put(key, x):
            asked.append(key)
            AnswerCache.put(cache, key, x)
            if interrupted and len(asked) == 9:
                raise KeyboardInterrupt

        cache.put = put
        found = d.diagnose(machine, [run], candidates=few, cache=cache)
        return cache, asked, found

    with pytest.raises(KeyboardInterrupt):
        answer(interrupted=True)
    files = sorted((tmp_path / "unfinished").rglob("*.bin"))
    assert len(files) == 9
    files[0].write_bytes(files[0].read_bytes()[:-8])
    cache, asked, found = answer()
    assert cache.n_restored == 9 and files[0].stem in asked
    assert not {f.stem for f in files[1:]} & set(asked)
    plain = d.diagnose(machine, [run], candidates=few)
    assert found.sentence == plain.sentence
    assert found.selection.fit.deviance == plain.selection.fit.deviance
    assert answer()[1] == []
    cache.done()
    assert list(tmp_path.iterdir()) == []


def test_laws_see_a_slide_on_its_pinion(machine):
    """2 N m on a pinion of 0.1 m are 20 N; a drive's gain is judged in the force logged."""
    run = moved(4)
    effects = JointCoulomb(torque=(0.0, 2.0)), JointDriveGain(error=(0.25, 0.0))
    models = [machine.nominal, *(machine.model([e]) for e in effects)]
    plain, rubbed, gained = machine.residuals(run, models, ["joint"])["joint"]
    rate = run.joints.v[:, 1]
    assert np.allclose(rubbed - plain, np.stack([0 * rate, -20 * np.tanh(rate / 1e-3)], 1))
    load = run["tau"] - plain
    want = run["tau"][:, 0] - load[:, 0] / 1.25
    assert np.allclose(gained[:, 0], want, atol=1e-6 * np.abs(load).max())


MAPPING = (  # with gains, an offset, and a force of two columns
    COMMAND.replace('"q1"', '"q1", gain = 0.017453292519943295')
    .replace('"q2"', '"q2", offset = 0.1')
    .replace('{ column = "i1" }', '{ column = "i1", gain = 2.0 }, { column = "known" }')
)


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM.format(**PLAIN))
    (tmp_path / "arm.toml").write_text(MAPPING)
    t = np.arange(1000) * 2e-3
    columns = {"t": t, "q1": 90 * np.sin(t), "i1": t, "known": 1 + t, "q2": t, "i2": 3 * t}
    table = np.stack(list(columns.values()), axis=1)
    header = ",".join(columns)
    np.savetxt(tmp_path / "data.csv", table, "%.12g", ",", header=header, comments="")
    return tmp_path


def test_columns_become_signals(folder):
    machine, load = read_machine(folder / "arm.toml")
    run = load(folder / "data.csv")
    t = np.arange(1000) * 2e-3
    assert [p.name for p in machine.ports] == ["joint", "velocity"]
    assert np.allclose(run["q"], np.stack([np.pi / 2 * np.sin(t), t + 0.1], axis=1))
    assert np.allclose(run["tau"], np.stack([3 * t + 1, 3 * t], axis=1))
    assert "v" not in run


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ('"ves-machine/1"', '"other/1"', "arm.toml: schema must be one of ves-machine"),
        ("radius = 0.1", "radios = 0.1", r"arm.toml.joint\[1\]: unknown key 'radios'"),
        ("radius = 0.1", "radius = -1.0", "arm.toml: .*radius must be > 0 m"),
        ('"reach"', '"elbow"', "arm.toml: the model has no joint 'elbow'"),
        ('type = "slide"', "", "arm.toml: joint reach: radius is of slides"),
        ('"arm.xml"', '"none.xml"', "arm.toml: model .*none.xml"),
        ('force = [{ column = "i2" }]', "", "arm.toml: joint reach has no force"),
    ],
)
def test_a_mapping_file_is_read_strictly(folder, old, new, match):
    (folder / "arm.toml").write_text(MAPPING.replace(old, new))
    with pytest.raises(ParameterError, match=match):
        read_machine(folder / "arm.toml")


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda rows: [rows[0].replace("q2", "x2"), *rows[1:]], "data.csv: no column 'q2'"),
        (lambda rows: [*rows[:5], *rows[4:]], "row 5: the clock does not run forward"),
        (lambda rows: [*rows[:500], *rows[600:]], "row 500: .*cut the log at the gap"),
        (lambda rows: [*rows[:9], rows[9] + ",1", *rows[10:]], "row 10: expected 6 numbers"),
        (lambda rows: [*rows[:9], "nan" + rows[9], *rows[10:]], "row 10"),
    ],
)
def test_data_are_read_strictly(folder, change, match):
    _, load = read_machine(folder / "arm.toml")
    rows = (folder / "data.csv").read_text().splitlines()
    (folder / "data.csv").write_text("\n".join(change(rows)))
    with pytest.raises(ParameterError, match=match):
        load(folder / "data.csv")


def test_a_model_on_a_free_base_is_refused():
    body = '<body><freejoint name="base"/><geom size="1"/></body>'
    free = f"<mujoco><worldbody>{body}</worldbody></mujoco>"
    with pytest.raises(ParameterError, match="neither hinge nor slide"):
        MjcfMachine("free", [MjcfJoint("base")], mujoco.MjModel.from_xml_string(free))
