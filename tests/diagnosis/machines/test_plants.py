"""Static poses of a sensor, an arm over a force plate, linear plants: found, and left alone.

Generators: the weight of a point mass, `scipy.signal.lsim`, momentum balances of MuJoCo.
"""

import json

import mujoco
import numpy as np
import pytest
import scipy
from scipy.spatial.transform import Rotation

from tests.diagnosis.machines import rigid_arm
from ves_gym._util.params import ParameterError
from ves_gym.cli.main import main
from ves_gym.diagnosis import diagnose as d
from ves_gym.diagnosis.data.measured_run import run_of_signals
from ves_gym.diagnosis.data.sanity_checks import suspected_mistake
from ves_gym.diagnosis.machines.force_plate import ForcePlateArm
from ves_gym.diagnosis.machines.linear_plant import LinearMachine, StateSpace, structure
from ves_gym.diagnosis.machines.mapping import read_machine
from ves_gym.diagnosis.machines.static_poses import StaticTool, static_run

ZERO = np.zeros(6)
NOISE = np.array([0.1, 0.1, 0.1, 0.01, 0.01, 0.01])  # N, N m


def named(found):
    return {f.candidate.name: f.values for f in found.explanations}


# ------------------------------------------------------------------------ static poses


def poses(mass, centre, bias=ZERO, n=60, seed=0):
    """Readings of a sensor that carries a point mass, in random directions."""
    rng = np.random.default_rng(seed)
    orientation = Rotation.random(n, random_state=seed)
    force = mass * 9.80665 * orientation.inv().apply([0.0, 0.0, -1.0])
    wrench = np.hstack([force, np.cross(centre, force)]) + bias
    wrench = wrench + NOISE * rng.standard_normal(wrench.shape)
    return static_run("poses", orientation, wrench, NOISE)


def test_a_tool_and_a_bias_are_told_from_static_poses():
    bias = np.array([3.0, -2.0, 5.0, 0.2, 0.1, -0.3])
    machine = StaticTool("gripper", 1.0, (0.0, 0.0, 0.05))
    run = poses(1.4, (0.01, 0.0, 0.08), bias)
    assert suspected_mistake(machine, run) is None
    found = d.diagnose(machine, [run], candidates=machine.candidates())
    values = named(found)
    assert set(values) == {"tool/body", "wrench/bias"}, found.sentence
    added = [0.4, 0.014, 0.0, 1.4 * 0.08 - 0.05]
    assert values["tool/body"] == pytest.approx(added, abs=0.01)
    assert values["wrench/bias"] == pytest.approx(bias, abs=0.1)


def test_a_tool_as_described_is_left_alone():
    machine = StaticTool("gripper", 1.4, (0.01, 0.0, 0.08))
    run = poses(1.4, (0.01, 0.0, 0.08), seed=2)
    found = d.diagnose(machine, [run], candidates=machine.candidates())
    assert found.verdict == d.NOTHING, found.sentence
    with pytest.raises(ParameterError, match="at least 8 poses"):
        poses(1.0, (0.0, 0.0, 0.0), n=5)


# ------------------------------------------------------------------------ linear plant


def two_masses(stiffness=4000.0, damping=6.0):
    """Two carriages on springs; the force pushes one, the other is measured."""
    K = np.array([[stiffness + 2000.0, -2000.0], [-2000.0, 2000.0]])
    return np.diag([10.0, 5.0]), np.diag([damping, damping]), K


def pushed(M, D, K, delay=0.0, gain=1.0, seed=0, rate=100.0, start=None):
    """The measured carriage under a random force, by scipy's `lsim`."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(20 * rate)) / rate
    low = scipy.signal.butter(3, 8.0, fs=rate)
    u = scipy.signal.lfilter(*low, 50 * rng.standard_normal(len(t)))
    n = len(M)
    A = np.vstack([np.eye(2 * n)[n:], -np.linalg.solve(M, np.hstack([K, D]))])
    B = np.concatenate([np.zeros(n), np.linalg.solve(M, np.eye(n)[0])])[:, None]
    C = np.concatenate([np.eye(n)[-1], np.zeros(n)])[None]
    late = np.interp(t - delay, t, u)
    _, y, _ = scipy.signal.lsim((A, B, C, [[0.0]]), late, t, X0=start)
    y = gain * y + 2e-6 * rng.standard_normal(len(t))
    return run_of_signals(t, {"input": u[:, None], "output": y[:, None]}, f"run {seed}")


def plant(**options):
    M, D, K = two_masses()
    described = structure(M, D, K, np.eye(2)[:, :1], np.eye(2)[1:], "displacement")
    return LinearMachine("carriages", described, [("x2", "m")], **options)


@pytest.mark.parametrize(
    ("change", "name", "value"),
    [
        ({"delay": 0.012}, "plant/delay", 0.012),
        ({"gain": 1.08}, "plant/gain", 0.08),
    ],
)
def test_what_a_plant_lacks_is_named(change, name, value):
    machine = plant()
    runs = [pushed(*two_masses(), **change, start=[0.01, 0.0, 0.0, 0.2])]
    found = d.diagnose(machine, runs, candidates=machine.candidates())
    values = named(found)
    assert set(values) == {name}, found.sentence
    assert values[name] == pytest.approx([value], rel=0.05)


def test_a_softer_mode_and_a_described_plant():
    """A stiffness matrix 4 % higher moves every mode by 2 %; the plant as described by none."""
    machine = plant()
    M, D, K = two_masses()
    found = d.diagnose(machine, [pushed(M, D, 1.08 * K)], candidates=machine.candidates())
    assert found.verdict in (d.NAMED, d.ONE_OF, d.MORE)
    assert all(n.startswith("plant/mode at frequency of mode") for n in named(found))
    for values in named(found).values():
        assert values == pytest.approx([np.sqrt(1.08) - 1], rel=0.1)
    clean = d.diagnose(machine, [pushed(M, D, K, seed=1)], candidates=machine.candidates())
    assert clean.verdict == d.NOTHING, clean.sentence


def test_a_plant_by_its_matrices_lacks_a_mode():
    """A, B, C, D of the first mode alone, run against the plant with both."""
    M, D, K = two_masses(damping=1.0)
    values, shapes = scipy.linalg.eigh(K, M)
    w = np.sqrt(values[0])
    residue = shapes[0, 0] * shapes[1, 0]
    damping = float(shapes[:, 0] @ D @ shapes[:, 0])
    A, B = np.array([[0.0, 1.0], [-(w**2), -damping]]), np.array([[0.0], [residue]])
    first = StateSpace(A, B, np.array([[1.0, 0.0]]), np.zeros((1, 1)))
    machine = LinearMachine("one mode", first, [("x2", "m")])
    found = d.diagnose(machine, [pushed(M, D, K)], candidates=machine.candidates())
    hertz = np.sqrt(values[1]) / (2 * np.pi)
    assert named(found)["plant/extra_mode"][0] == pytest.approx(hertz, rel=0.02)
    with pytest.raises(ParameterError, match="unstable"):
        StateSpace(np.eye(1), np.ones((1, 1)), np.ones((1, 1)), np.zeros((1, 1)))


# ------------------------------------------------------------------------- force plate

SPRINGS = np.diag([2e4, 2e4, 5e4, 2e3, 2e3, 1e3])
DAMPERS = np.diag([200.0, 200.0, 400.0, 20.0, 20.0, 10.0])


def over_a_plate(seed, mass=0.0, centre=(0.0, 0.0, 0.0), bias=ZERO, stiffness=SPRINGS):
    """An arm moved on a base of springs: M and bias forces by MuJoCo, the base's motion
    integrated here; the plate reads the springs, about the place of the unloaded base."""
    seconds, h, every = 6.0, 1e-3, 10
    _, q, v, a = rigid_arm.motion(seed, seconds, 1 / h)
    spec = mujoco.MjSpec.from_string(rigid_arm.on_six_joints())
    if mass:
        body = spec.body("elbow_link").add_body(pos=centre)
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[1e-4, 0, 0], mass=mass)
    model = spec.compile()
    data = mujoco.MjData(model)
    y, rate, full = np.zeros(6), np.zeros(6), np.empty((9, 9))
    y[2] = -model.body_mass.sum() * 9.81 / stiffness[2, 2]
    rows = []
    for k in range(len(q)):
        data.qpos[:], data.qvel[:] = np.concatenate([y, q[k]]), np.concatenate([rate, v[k]])
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, full)
        force = -stiffness @ y - DAMPERS @ rate
        if k % every == 0:
            reading = np.concatenate([force[:3], force[3:] + np.cross(y[:3], force[:3])])
            rows.append([*q[k], *y, *reading])
        needed = force - data.qfrc_bias[:6] - full[:6, 6:] @ a[k]
        rate = rate + h * np.linalg.solve(full[:6, :6], needed)
        y = y + h * rate
    q, y, w = np.split(np.array(rows), [3, 9], axis=1)
    rng = np.random.default_rng(seed)
    q = q + 1e-5 * rng.standard_normal(q.shape)
    y = y + np.array([2e-6] * 3 + [1e-5] * 3) * rng.standard_normal(y.shape)
    w = w + bias + np.array([0.5] * 3 + [0.1] * 3) * rng.standard_normal(w.shape)
    t = h * every * np.arange(len(q))
    return run_of_signals(t, {"q": q, "y": y, "plate": w}, f"run {seed}", 8.0)


@pytest.fixture(scope="module")
def plate(tmp_path_factory):
    path = tmp_path_factory.mktemp("plate") / "arm.urdf"
    path.write_text(rigid_arm.urdf(base=rigid_arm.BASE))
    return ForcePlateArm("arm on springs", path, rigid_arm.JOINTS, SPRINGS, DAMPERS)


def test_an_arm_over_a_force_plate_as_described_is_left_alone(plate):
    found = d.diagnose(plate, [over_a_plate(0)], candidates=plate.candidates())
    assert not found.explanations, found.sentence
    assert found.verdict in (d.NOTHING, d.WEAK)


@pytest.mark.slow
def test_a_payload_over_a_force_plate(plate):
    run = over_a_plate(1, mass=2.0, centre=(0.2, 0.0, 0.05))
    found = d.diagnose(plate, [run], candidates=plate.candidates())
    values = named(found)
    assert set(values) == {"plate/payload"}, found.sentence
    assert values["plate/payload"][0] == pytest.approx(2.0, rel=0.05)


@pytest.mark.slow
def test_a_softer_base_and_a_bias_over_a_force_plate(plate):
    softer = SPRINGS * np.diag([0.9, 1, 1, 1, 1, 1])
    bias = np.array([5.0, 0.0, 0.0, 0.0, 3.0, 0.0])
    run = over_a_plate(2, stiffness=softer, bias=bias)
    found = d.diagnose(plate, [run], candidates=plate.candidates())
    values = named(found)
    assert set(values) == {"mount/stiffness at x", "wrench/bias"}, found.sentence
    assert values["mount/stiffness at x"] == pytest.approx([-0.1], rel=0.05)


# ----------------------------------------------------------------------- mapping files

STATIC = """
schema = "ves-static/1"
name = "gripper"
orientation = { quaternion = ["qw", "qx", "qy", "qz"] }
wrench = [
  { column = "fx" }, { column = "fy" }, { column = "fz" },
  { column = "mx" }, { column = "my" }, { column = "mz" },
]
tool = { mass = 1.0, centre = [0.0, 0.0, 0.05] }
noise = { force = 0.1, torque = 0.01 }
"""


def test_static_poses_go_from_csv_to_a_better_mapping(tmp_path, capsys):
    orientation = Rotation.random(40, random_state=0)
    force = 1.5 * 9.80665 * orientation.inv().apply([0.0, 0.0, -1.0])
    wrench = np.hstack([force, np.cross([0.0, 0.0, 0.05], force)])
    wrench = wrench + NOISE * np.random.default_rng(0).standard_normal(wrench.shape)
    table = np.hstack([orientation.as_quat()[:, [3, 0, 1, 2]], wrench])
    header = "qw,qx,qy,qz,fx,fy,fz,mx,my,mz"
    np.savetxt(tmp_path / "poses.csv", table, "%.9g", ",", header=header, comments="")
    (tmp_path / "tool.toml").write_text(STATIC)
    words = ["diagnose", str(tmp_path / "poses.csv"), "--machine", str(tmp_path / "tool.toml")]
    assert main([*words, "--out", str(tmp_path / "out")]) == 0
    found = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert [e["kind"] for e in found["effects"]] == ["tool/body"]
    assert found["replay_difference"] <= 1e-9
    machine, load = read_machine(tmp_path / "out" / "machine.toml")
    again = d.diagnose(machine, [load(tmp_path / "poses.csv")], candidates=machine.candidates())
    assert again.verdict == d.NOTHING, again.sentence


LINEAR = """
schema = "ves-plant/1"
name = "carriages"
time = { column = "t" }
band = 10.0
input = [{ column = "u" }]
output = [{ name = "x2", column = "x2", gain = 1e-3, unit = "m" }]
[structure]
M = [[10.0, 0.0], [0.0, 5.0]]
D = [[6.0, 0.0], [0.0, 6.0]]
K = [[6000.0, -2000.0], [-2000.0, 2000.0]]
force = [[1.0], [0.0]]
output = [[0.0, 1.0]]
"""


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("ves-plant/1", "ves-plan/1", "schema must be one of ves-machine/1, ves-plant/1"),
        ("[[1.0], [0.0]]", "[[1.0]]", "M, D, K, force, output do not fit"),
        ("[structure]", "[matrix]", "unknown key 'matrix'"),
        ('"displacement"', '"position"', ""),
    ],
)
def test_a_plants_mapping_is_read_or_refused_by_its_key(tmp_path, old, new, match):
    run = pushed(*two_masses(), gain=1.05)
    rows = np.hstack(
        [run.dt * np.arange(run.length)[:, None], run["input"], 1e3 * run["output"]]
    )
    np.savetxt(tmp_path / "run.csv", rows, "%.12g", ",", header="t,u,x2", comments="")
    (tmp_path / "plant.toml").write_text(LINEAR.replace(old, new))
    if match:
        with pytest.raises(ParameterError, match=match):
            read_machine(tmp_path / "plant.toml")
        return
    machine, load = read_machine(tmp_path / "plant.toml")
    same = load(tmp_path / "run.csv")
    assert same["output"] == pytest.approx(run["output"], abs=1e-9)
    found = d.diagnose(machine, [same], candidates=machine.candidates())
    assert set(named(found)) == {"plant/gain"}, found.sentence


MASS = [[[1.0]], [[2.0]], [[100.0]], [[1.0]], [[1.0]]]


@pytest.mark.parametrize(
    ("changes", "verdict"),
    [
        ({}, d.NAMED),
        ({"tolerance": {"gain": 0.02}}, d.NOTHING),
        ({"tolerance": {"gain": 0.02}, "known": {"gain": 0.002}}, d.NAMED),
        ({"noise": 0.03}, d.NOTHING),
    ],
    ids=["narrow", "wide", "known well", "noisy"],
)
def test_a_small_error_is_named_or_not_by_what_tolerances_and_noise_say(
    tmp_path, changes, verdict
):
    """A gain 2 % off: ten of its tolerances, or one."""
    t = np.arange(1200) * 0.01
    rng = np.random.default_rng(0)
    u = scipy.signal.lfilter(*scipy.signal.butter(3, 0.15), 50 * rng.standard_normal(len(t)))
    _, y, _ = scipy.signal.lsim(([1.02], [1.0, 2.0, 100.0]), u, t)
    rows = np.column_stack([t, u, y + 1e-4 * rng.standard_normal(len(t))])
    np.savetxt(tmp_path / "run.csv", rows, "%.9g", ",", header="t,u,y", comments="")
    table = {
        "schema": "ves-plant/1",
        "name": "mass on a spring",
        "time": {"column": "t"},
        "input": [{"column": "u"}],
        "output": [{"name": "y", "column": "y"}],
        "structure": dict(zip(("M", "D", "K", "force", "output"), MASS, strict=True)),
        "noise": 1e-4,
        **changes,
    }
    (tmp_path / "plant.json").write_text(json.dumps(table))
    machine, load = read_machine(tmp_path / "plant.json")
    run = load(tmp_path / "run.csv")
    candidates = [c for c in machine.candidates() if c.kind in ("plant/gain", "plant/delay")]
    found = d.diagnose(machine, [run], candidates=candidates)
    assert found.verdict == verdict, found.sentence
    assert set(named(found)) == ({"plant/gain"} if verdict == d.NAMED else set())
