"""A machine in MJCF: hidden friction is named, a complete model left alone, files are read."""

import mujoco
import numpy as np
import pytest

from ves_gym.core.params import ParameterError
from ves_gym.discrepancy import diagnosis as d
from ves_gym.discrepancy.mapping import read_machine
from ves_gym.discrepancy.mjcf_machine import MjcfJoint, MjcfMachine
from ves_gym.discrepancy.runs import run_of_signals
from ves_gym.effects import JointCoulomb, JointDriveGain

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


def moved(seed, **hidden):
    """A run of the arm under control, with what is hidden in its joints."""
    model = mujoco.MjModel.from_xml_string(ARM.format(**{**PLAIN, **hidden}))
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    waves, phase = rng.uniform(0.2, 1.2, (3, 2)), rng.uniform(0, 6, (3, 2))
    size, kp, kd = np.array([0.4, 0.05]), np.array([600.0, 6000.0]), np.array([60.0, 300.0])
    rows = []
    for k in range(12000):
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
    return run_of_signals(t[:, 0], signals, f"run {seed}")


@pytest.fixture(scope="module")
def machine():
    return MjcfMachine("arm", JOINTS, mujoco.MjModel.from_xml_string(ARM.format(**PLAIN)))


def only_force(machine):
    """What acts on the force; the rates of the simulation are exact."""
    return [c for c in machine.candidates() if "joint" in c.ports]


def test_nothing_is_found_where_nothing_is_hidden(machine):
    found = d.diagnose(machine, [moved(1)], candidates=only_force(machine))
    assert found.verdict == d.NOTHING, found.sentence


def test_friction_hidden_in_the_joints_is_named_in_their_units(machine):
    runs = [moved(2, shoulder='damping="2.0"', reach='damping="30"')]
    found = d.diagnose(
        machine,
        runs,
        [moved(3, shoulder='damping="2.0"', reach='damping="30"')],
        candidates=only_force(machine),
    )
    named = {(f.candidate.kind, f.candidate.slot): f for f in found.found}
    assert set(named) == {("joint/viscous", "shoulder"), ("joint/viscous", "reach")}
    for (_, slot), want, symbol in zip(
        sorted(named), (30.0, 2.0), ("N s/m", "N m s/rad"), strict=True
    ):
        f = named["joint/viscous", slot]
        assert f.values[0] == pytest.approx(want, rel=0.02)
        assert f.candidate.units == (symbol,)
    gaps = [g for g in found.final if g.port == "joint"]
    assert all(g.after < min(1.2, g.before / 2) for g in gaps), gaps


def test_laws_see_a_slide_on_its_pinion(machine):
    """2 N m on a pinion of 0.1 m are 20 N; a drive's gain is judged in the force logged."""
    run = moved(4)
    plain, rubbed, gained = machine.residuals(
        run,
        [
            machine.nominal,
            machine.model([JointCoulomb(torque=(0.0, 2.0))]),
            machine.model([JointDriveGain(error=(0.25, 0.0))]),
        ],
        ["joint"],
    )["joint"]
    rate = run.joints.v[:, 1]
    assert np.allclose(rubbed - plain, np.stack([0 * rate, -20 * np.tanh(rate / 1e-3)], 1))
    load = run["tau"] - plain
    want = run["tau"][:, 0] - load[:, 0] / 1.25
    assert np.allclose(gained[:, 0], want, atol=1e-6 * np.abs(load).max())


MAPPING = """
schema = "ves-machine/1"
name = "arm"
model = "arm.xml"
time = { column = "t" }
[[joint]]
name = "shoulder"
position = { column = "q1", gain = 0.017453292519943295 }
force = [{ column = "i1", gain = 2.0 }, { column = "known" }]
[[joint]]
name = "reach"
type = "slide"
radius = 0.1
position = { column = "q2", offset = 0.1 }
force = [{ column = "i2" }]
"""


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
        ('"ves-machine/1"', '"other/1"', "arm.toml: schema must be 'ves-machine/1'"),
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
