"""Machines by a residual function: what they lack is found, and what is described left alone.

Generators: the weight of a point mass, `scipy.signal.lsim`, momentum balances of MuJoCo.
"""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
import scipy
from scipy.spatial.transform import Rotation

from examples import force_plate
from examples.linear_plant import StateSpace, linear_machine, structure
from examples.static_tool import StaticTool
from tests.diagnosis.machines import rigid_arm
from ves_gym import diagnosis as vd
from ves_gym._util.params import ParameterError
from ves_gym.cli.main import main
from ves_gym.diagnosis import diagnose as d
from ves_gym.diagnosis.data.measured_run import run_of_signals
from ves_gym.diagnosis.data.sanity_checks import suspected_mistake
from ves_gym.diagnosis.machines.mapping import read_machine

ROOT = Path(__file__).parents[3]
ZERO = np.zeros(6)
NOISE = np.array([0.1, 0.1, 0.1, 0.01, 0.01, 0.01])  # N, N m


def named(found):
    return {f.candidate.name: f.values for f in found.explanations}


def found_in(machine, runs, final=()):
    return d.diagnose(machine, runs, final, candidates=machine.candidates())


# ------------------------------------------------------------------- a function of one's own


def spring(p, run):
    """A spring that hardens, or not: force on an extension."""
    x = run["x"]
    return {"spring": run["force"] - p["stiffness"] * x - p["hardening"] * x**3}


SPRING = vd.ResidualMachine(
    "spring",
    spring,
    (vd.Port("spring", "force left", ("F",), ("N",), ("x", "force"), ("x",), signal="force"),),
    {
        "stiffness": vd.Parameter(unit="N/m", nominal=100.0, usual=5.0, tolerance=0.5, low=0.0),
        "hardening": vd.Parameter(unit="N/m^3", usual=20.0, low=0.0),
    },
)


def stretched(seed, stiffness=100.0, hardening=0.0):
    rng = np.random.default_rng(seed)
    x = rng.uniform(-1, 1, (40, 1))
    force = stiffness * x + hardening * x**3 + 0.1 * rng.standard_normal(x.shape)
    return vd.samples(f"run {seed}", {"x": x, "force": force}, {"x": 0.0, "force": 0.1})


@pytest.mark.parametrize(
    ("hidden", "names"),
    [
        ({}, set()),
        ({"stiffness": 100.5}, set()),  # a tolerance
        ({"stiffness": 112.0}, {"stiffness"}),
        ({"hardening": 15.0}, {"hardening"}),
        ({"stiffness": 112.0, "hardening": 15.0}, {"stiffness", "hardening"}),
    ],
)
def test_a_parameter_and_a_law_of_ones_own_are_named(hidden, names):
    """The answer is the parameter itself: `better` has it, and `at` makes the machine of it."""
    runs = [stretched(k, **hidden) for k in range(3)]
    found = found_in(SPRING, runs[:2], runs[2:])
    assert set(named(found)) == names, found.sentence
    better = SPRING.better(found.effects)
    assert better == {k: pytest.approx(hidden[k], rel=0.02) for k in names}
    assert found_in(SPRING.at(better), runs[:2]).verdict == d.NOTHING


def test_what_a_machine_of_ones_own_must_keep_to_is_said():
    short = replace(SPRING, residual=lambda p, run: {"spring": run["x"][1:]})
    endless = replace(SPRING, residual=lambda p, run: {"spring": np.inf * run["x"]})
    for machine in (short, endless):
        with pytest.raises(ParameterError, match=r"must be \(40, 1\) finite numbers, got"):
            machine.residuals(stretched(0), [()], ["spring"])
    with pytest.raises(ParameterError, match="no tolerance 'stifness'"):
        replace(SPRING, tolerance={"stifness": 0.1})
    with pytest.raises(ParameterError, match="parameter must be one of"):
        SPRING.at({"mass": 1.0})
    with pytest.raises(ParameterError, match="at least 8 samples"):
        vd.samples("few", {"x": np.zeros((5, 1))}, {})
    with pytest.raises(ParameterError, match="entries need as many"):
        vd.Parameter(unit="m", usual=1.0, nominal=(0.0, 0.0), entries=("x",))
    with pytest.raises(ParameterError, match="needs starts"):
        vd.Parameter(unit="Hz", usual=1.0, nominal=None)


def test_a_machine_is_filed_once():
    @dataclass(frozen=True)
    class Other:
        def machine(self, folder):
            return SPRING

    with pytest.raises(ParameterError, match="'force plate' is already registered"):
        vd.register_machine("force plate")(Other)
    with pytest.raises(ParameterError, match="must be a dataclass"):
        vd.register_machine("number")(int)


# ------------------------------------------------------------------------ static poses


def poses(mass, centre, bias=ZERO, n=60, seed=0):
    """Readings of a sensor that carries a point mass, in random directions."""
    rng = np.random.default_rng(seed)
    orientation = Rotation.random(n, random_state=seed)
    force = mass * 9.80665 * orientation.inv().apply([0.0, 0.0, -1.0])
    wrench = np.hstack([force, np.cross(centre, force)]) + bias
    wrench = wrench + NOISE * rng.standard_normal(wrench.shape)
    signals = {"orientation": orientation.as_quat()[:, [3, 0, 1, 2]], "wrench": wrench}
    return vd.samples(f"poses {seed}", signals, {"orientation": 0.0, "wrench": NOISE})


BIAS = np.array([3.0, -2.0, 5.0, 0.2, 0.1, -0.3])


@pytest.mark.parametrize(
    ("mass", "centre"),
    [(1.0, (0.0, 0.0, 0.05)), (0.0, (0.0,) * 3)],
    ids=["described otherwise", "undescribed"],
)
def test_a_tool_and_a_bias_are_told_from_static_poses(mass, centre):
    machine = StaticTool(mass, centre).machine()
    runs = [poses(1.4, (0.01, 0.0, 0.08), BIAS, seed=k) for k in range(3)]
    assert suspected_mistake(machine, runs[0]) is None
    found = found_in(machine, runs[:2], runs[2:])
    assert set(named(found)) == {"tool", "bias"}, found.sentence
    better = machine.better(found.effects)
    assert better["mass"] == pytest.approx(1.4, abs=0.01)
    assert better["moment"] == pytest.approx([0.014, 0.0, 0.112], abs=0.002)
    assert better["bias"] == pytest.approx(BIAS, abs=0.1)


def test_a_tool_as_described_is_left_alone():
    machine = StaticTool(1.4, (0.01, 0.0, 0.08)).machine()
    found = found_in(machine, [poses(1.4, (0.01, 0.0, 0.08), seed=2)])
    assert found.verdict == d.NOTHING, found.sentence


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
    signals = {"input": u[:, None], "output": y[:, None]}
    return run_of_signals(t, signals, f"run {seed}", meta={"noise_std": {"output": 2e-6}})


def plant():
    M, D, K = two_masses()
    described = structure(M, D, K, np.eye(2)[:, :1], np.eye(2)[1:], "displacement")
    return linear_machine(described, [("x2", "m")])


@pytest.mark.parametrize(
    ("change", "name", "value"),
    [({"delay": 0.02}, "delay", 0.02), ({"gain": 1.08}, "gain", 0.08)],
)
def test_what_a_plant_lacks_is_named(change, name, value):
    machine = plant()
    found = found_in(machine, [pushed(*two_masses(), **change, start=[0.01, 0.0, 0.0, 0.2])])
    assert named(found) == {name: pytest.approx([value], rel=0.05)}, found.sentence


def test_a_softer_mode_and_a_described_plant():
    """A stiffness matrix 8 % higher moves every mode by 4 %; the plant as described by none."""
    machine = plant()
    M, D, K = two_masses()
    found = found_in(machine, [pushed(M, D, 1.08 * K)])
    assert found.verdict in (d.NAMED, d.ONE_OF, d.MORE)
    hertz = machine.parameters["frequency"]
    for name, values in named(found).items():
        nominal = dict(zip(hertz.entries, hertz.nominal, strict=True))
        at = name.removeprefix("frequency at ")
        assert values == pytest.approx([nominal[at] * (np.sqrt(1.08) - 1)], rel=0.1)
    clean = found_in(machine, [pushed(M, D, K, seed=1)])
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
    found = found_in(linear_machine(first, [("x2", "m")]), [pushed(M, D, K)])
    hertz = np.sqrt(values[1]) / (2 * np.pi)
    assert named(found)["extra mode"][0] == pytest.approx(hertz, rel=0.02)
    with pytest.raises(ParameterError, match="unstable"):
        StateSpace(np.eye(1), np.ones((1, 1)), np.ones((1, 1)), np.zeros((1, 1)))


@pytest.mark.parametrize("held", [False, True])
@pytest.mark.parametrize("reads", ["displacement", "velocity", "acceleration"])
def test_a_plants_output_is_that_of_scipy(reads, held):
    """Modes that swing, an overdamped one, and two integrators, from a start of their own."""
    rng = np.random.default_rng(0)
    u, t = rng.standard_normal((300, 1)), 0.01 * np.arange(300)
    free = np.zeros((2, 2)), np.zeros((2, 2))  # D, K
    for D, K in (two_masses()[1:], (np.diag([900.0, 6.0]), two_masses()[2]), free):
        s = structure(two_masses()[0], D, K, np.eye(2)[:, :1], np.eye(2)[1:] + 0.1, reads)
        start = 0.1 * rng.standard_normal(4)
        _, y, _ = scipy.signal.lsim((s.A, s.B, s.C, s.D), u, t, start, not held)
        assert s.output(u, 0.01, start, held)[:, 0] == pytest.approx(y, abs=1e-9)


def modal(reads, *modes):
    """A structure by its modes: hertz, damping ratio, residue."""
    w, zeta, residue = np.array(modes).T * np.array([[2 * np.pi], [1.0], [1.0]])
    M, D, K = np.eye(len(w)), np.diag(2 * zeta * w), np.diag(w**2)
    return structure(M, D, K, residue[:, None], np.ones((1, len(w))), reads)


@pytest.mark.parametrize("reads", ["displacement", "velocity", "acceleration"])
def test_a_mode_that_is_otherwise_is_a_structure_that_is_otherwise(reads):
    """Frequency, damping and share of a mode, and a mode more, in what each output reads."""
    a, b, more = (1.0, 0.02, 1.0), (3.0, 0.01, 2.0), (7.0, 0.02, 0.3)
    u = np.random.default_rng(0).standard_normal((300, 1))

    def output(plant):
        return plant.output(u, 0.01, np.zeros(len(plant.A)), False)

    other = modal(reads, a, b).with_modes(
        [1.0, 3.3], 2 * np.pi * np.array([0.02, 3.3 * 0.015]), [1.0, 1.3]
    )
    assert output(other) == pytest.approx(output(modal(reads, a, (3.3, 0.015, 2.6))), abs=1e-9)
    larger = modal(reads, a, b).with_mode(*more)
    assert output(larger) == pytest.approx(output(modal(reads, a, b, more)), abs=1e-9)


def test_a_body_that_moves_freely_has_modes_that_may_be_off():
    """Two carriages on one spring, on no rail's end: their poles at 0 share a vector."""
    between = np.array([[1.0, -1.0], [-1.0, 1.0]])
    M, K, D = np.diag([10.0, 5.0]), 2e3 * between, 4.0 * between
    machine = linear_machine(
        structure(M, D, K, np.eye(2)[:, :1], np.eye(2)[1:], "displacement"), [("x2", "m")]
    )
    assert len(machine.parameters["frequency"].entries) == 1
    found = found_in(machine, [pushed(M, D, 1.1 * K, seed=k) for k in (0, 1)])
    hertz = np.sqrt(2e3 * (1 / 10 + 1 / 5)) / (2 * np.pi)
    (name, value), *others = named(found).items()
    assert not others and name.startswith("frequency at 1"), found.sentence
    assert value == pytest.approx([hertz * (np.sqrt(1.1) - 1)], rel=0.02)


FLEXIBLE = ((1.2, 0.01, 1.0), (3.7, 0.008, 2.0), (7.9, 0.006, -3.0), (11.5, 0.006, 2.0))


def flexible(seed, stated=True):
    """The tip's acceleration of a flexible arm of four modes, noise 0.2 % of it."""
    rng = np.random.default_rng(seed)
    t = 0.01 * np.arange(3000)
    low = scipy.signal.butter(3, 20.0, fs=100.0)
    u = scipy.signal.lfilter(*low, rng.standard_normal(len(t)))
    true = modal("acceleration", *FLEXIBLE)
    _, y, _ = scipy.signal.lsim((true.A, true.B, true.C, true.D), u, t)
    noise = 0.002 * y.std()
    signals = {
        "input": u[:, None],
        "output": (y + noise * rng.standard_normal(len(t)))[:, None],
    }
    meta = {"noise_std": {"output": noise}} if stated else {}
    return run_of_signals(t, signals, f"run {seed}", meta=meta)


@pytest.mark.parametrize(
    ("described", "name", "value"),
    [
        ((*FLEXIBLE[:2], FLEXIBLE[3]), "extra mode", (7.9, 0.006, -3.0)),
        (
            (*FLEXIBLE[:2], (7.9, 0.006, -2.2), FLEXIBLE[3]),
            "share at 3 (7.9 Hz)",
            (3 / 2.2 - 1,),
        ),
        (
            (*FLEXIBLE[:2], (7.98, 0.006 * 7.9 / 7.98, -3.0), FLEXIBLE[3]),
            "frequency at 3 (7.98 Hz)",
            (-0.08,),
        ),
        (FLEXIBLE, None, None),
    ],
    ids=["mode", "share", "frequency", "as described"],
)
def test_a_flexible_arm_whose_model_leaves_a_fifth_is_told_so(described, name, value):
    """One input, one output, modes beyond the quiet end of the spectrum: their noise is stated,
    not taken from them. A wrong share leaves 20 % of the output, a mode that lacks 70 %."""
    machine = linear_machine(modal("acceleration", *described), [("tip", "m/s^2")])
    runs = [flexible(k) for k in range(3)]
    found = found_in(machine, runs[:2], runs[2:])
    expected = {} if name is None else {name: pytest.approx(value, rel=0.02)}
    assert named(found) == expected, found.sentence
    assert found.verdict == (d.NOTHING if name is None else d.NAMED)


def test_a_noise_that_nobody_knows_is_asked_for():
    machine = linear_machine(modal("acceleration", *FLEXIBLE[:2]), [("tip", "m/s^2")])
    with pytest.raises(ParameterError, match="run 0: the noise of output is not known"):
        found_in(machine, [flexible(0, stated=False)])


# ------------------------------------------------------------------------- force plate

SPRINGS = np.array([2e4, 2e4, 5e4, 2e3, 2e3, 1e3])
DAMPERS = np.array([200.0, 200.0, 400.0, 20.0, 20.0, 10.0])
ZYX = [0, 1, 2, 5, 4, 3]  # coordinates of the six joints in the order of the pose


def turned(y):
    return Rotation.from_euler("ZYX", y[:2:-1])


def springs(y, rate, stiffness):
    """Wrench on a base, about it and in world axes, of its rotation vector."""
    h = 1e-6
    place, later = (np.append(x[:3], turned(x).as_rotvec()) for x in (y, y + h * rate))
    return -stiffness * place - DAMPERS * (later - place) / h


def on_joints(y, wrench):
    """Forces (6,) on three slides and hinges about z, y and x."""
    rz, ry = (Rotation.from_euler(k, x).as_matrix() for k, x in (("z", y[5]), ("y", y[4])))
    axes = np.stack([np.array([0.0, 0.0, 1.0]), rz[:, 1], (rz @ ry)[:, 0]])
    return np.append(wrench[:3], axes @ wrench[3:])


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
    y[2] = -model.body_mass.sum() * 9.81 / stiffness[2]
    rows = []
    for k in range(len(q)):
        data.qpos[:] = np.concatenate([y[ZYX], q[k]])
        data.qvel[:] = np.concatenate([rate[ZYX], v[k]])
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, full)
        force = springs(y, rate, stiffness)
        if k % every == 0:
            rows.append([*q[k], *y, *force[:3], *(force[3:] + np.cross(y[:3], force[:3]))])
        needed = on_joints(y, force) - data.qfrc_bias[:6] - full[:6, 6:] @ a[k]
        rate = rate + h * np.linalg.solve(full[:6, :6], needed)[ZYX]
        y = y + h * rate
    rng = np.random.default_rng(seed)
    parts = dict(
        zip(("q", "y", "plate"), np.split(np.array(rows), [3, 9], axis=1), strict=True)
    )
    parts["plate"] = parts["plate"] + bias
    noise = {"q": [1e-5] * 3, "y": [2e-6] * 3 + [1e-5] * 3, "plate": [0.5] * 3 + [0.1] * 3}
    signals = {k: x + noise[k] * rng.standard_normal(x.shape) for k, x in parts.items()}
    t = h * every * np.arange(len(rows))
    return run_of_signals(t, signals, f"run {seed}", 8.0, {"noise_std": noise})


@pytest.fixture(scope="module")
def plate(tmp_path_factory):
    path = tmp_path_factory.mktemp("plate") / "arm.urdf"
    path.write_text(rigid_arm.urdf(base=rigid_arm.BASE))
    described = force_plate.ForcePlate(path.name, tuple(SPRINGS), tuple(DAMPERS))
    return described.machine(path.parent)


def test_an_arm_over_a_force_plate_as_described_is_left_alone(plate):
    found = found_in(plate, [over_a_plate(0)])
    assert found.verdict == d.NOTHING, found.sentence


@pytest.mark.slow
def test_a_payload_over_a_force_plate(plate):
    run = over_a_plate(1, mass=2.0, centre=(0.2, 0.0, 0.05))
    found = found_in(plate, [run])
    assert set(named(found)) == {"payload"}, found.sentence
    assert plate.better(found.effects)["mass"] == pytest.approx(2.0, rel=0.05)


@pytest.mark.slow
def test_a_softer_base_and_a_bias_over_a_force_plate(plate):
    softer = SPRINGS * np.array([0.9, 1, 1, 1, 1, 1])
    bias = np.array([5.0, 0.0, 0.0, 0.0, 3.0, 0.0])
    found = found_in(plate, [over_a_plate(2, stiffness=softer, bias=bias)])
    values = named(found)
    assert set(values) == {"stiffness at x", "bias"}, found.sentence
    assert values["stiffness at x"] == pytest.approx([-0.1 * SPRINGS[0]], rel=0.05)


# ----------------------------------------------------------------------- mapping files

STATIC = """
schema = "ves-residual/1"
machine = "static tool"
name = "gripper"
description = { mass = 1.0, centre = [0.0, 0.0, 0.05] }
[signals]
orientation = [{ column = "qw" }, { column = "qx" }, { column = "qy" }, { column = "qz" }]
wrench = [
  { column = "fx" }, { column = "fy" }, { column = "fz" },
  { column = "mx" }, { column = "my" }, { column = "mz" },
]
[noise]
orientation = [0.0]
wrench = [0.1, 0.1, 0.1, 0.01, 0.01, 0.01]
"""


def test_static_poses_go_from_csv_to_a_better_mapping(tmp_path, capsys):
    run = poses(1.5, (0.0, 0.0, 0.05), n=40)
    table = np.hstack([run["orientation"], run["wrench"]])
    header = "qw,qx,qy,qz,fx,fy,fz,mx,my,mz"
    np.savetxt(tmp_path / "poses.csv", table, "%.9g", ",", header=header, comments="")
    (tmp_path / "tool.toml").write_text(STATIC)
    words = ["diagnose", str(tmp_path / "poses.csv"), "--machine", str(tmp_path / "tool.toml")]
    assert main([*words, "--out", str(tmp_path / "out")]) == 0
    found = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert [e["kind"] for e in found["effects"]] == ["tool"]
    assert found["replay_difference"] <= 1e-9
    assert found["machine_file"]["parameters"]["mass"] == pytest.approx(1.5, abs=0.01)
    machine, load = read_machine(tmp_path / "out" / "machine.toml")
    again = found_in(machine, [load(tmp_path / "poses.csv")])
    assert again.verdict == d.NOTHING, again.sentence


@pytest.mark.slow
def test_a_machine_of_ones_own_is_named_by_a_mapping_file(tmp_path, capsys):
    """What a TOML file names was imported by the user; the model it names stays where it is."""
    run = over_a_plate(1, mass=2.0, centre=(0.2, 0.0, 0.05))
    header = [*(f"q{k}" for k in range(3)), *(f"y{k}" for k in range(6))]
    header += [f"w{k}" for k in range(6)]
    t = run.dt * np.arange(run.length)[:, None]
    rows = np.hstack([t, *(run[k] for k in ("q", "y", "plate"))])
    title = ",".join(["t", *header])
    np.savetxt(tmp_path / "run.csv", rows, "%.12g", ",", header=title, comments="")
    (tmp_path / "arm.urdf").write_text(rigid_arm.urdf(base=rigid_arm.BASE))
    names = {"q": header[:3], "y": header[3:9], "plate": header[9:]}
    table = {
        "schema": "ves-residual/1",
        "machine": "force plate",
        "name": "arm on springs",
        "band": 8.0,
        "time": {"column": "t"},
        "signals": {k: [{"column": c} for c in x] for k, x in names.items()},
        "noise": run.meta["noise_std"],
        "description": {
            "model": "arm.urdf",
            "stiffness": SPRINGS.tolist(),
            "damping": DAMPERS.tolist(),
        },
    }
    (tmp_path / "plate.json").write_text(json.dumps(table))
    words = ["diagnose", str(tmp_path / "run.csv"), "--machine", str(tmp_path / "plate.json")]
    words += [
        "--import",
        "examples.force_plate",
        "--no-figures",
        "--out",
        str(tmp_path / "out"),
    ]
    assert main(words) == 0
    found = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert found["machine_file"]["parameters"]["mass"] == pytest.approx(2.0, rel=0.05)
    assert found["machine_file"]["description"]["model"] == "../arm.urdf"


LINEAR = """
schema = "ves-residual/1"
machine = "linear plant"
name = "carriages"
time = { column = "t" }
band = 10.0
noise = { output = [2e-6] }
[signals]
input = [{ column = "u" }]
output = [{ column = "x2", gain = 1e-3 }]
[description]
outputs = [["x2", "m"]]
[description.structure]
M = [[10.0, 0.0], [0.0, 5.0]]
D = [[6.0, 0.0], [0.0, 6.0]]
K = [[6000.0, -2000.0], [-2000.0, 2000.0]]
force = [[1.0], [0.0]]
output = [[0.0, 1.0]]
"""


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        (
            "ves-residual/1",
            "ves-plant/1",
            "schema must be one of ves-machine/1, ves-residual/1",
        ),
        ('"linear plant"', '"a plant"', "machine must be one of .*linear plant, static tool"),
        ("[[1.0], [0.0]]", "[[1.0]]", "M, D, K, force, output do not fit"),
        ("[[10.0, 0.0], ", "[[10.0], ", "rows of one length, got"),
        ("description.structure", "description.matrix", "unknown key 'matrix'"),
        ("[signals]", "parameters = { mass = 1.0 }\n[signals]", "parameter must be one of"),
        ("[signals]", "rest = [90.0, 91.0]\n[signals]", "no samples at rest"),
        ("[signals]", "rest = [0.0, 1.0]\n[signals]", ""),
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
            read_machine(tmp_path / "plant.toml")[1](tmp_path / "run.csv")
        return
    machine, load = read_machine(tmp_path / "plant.toml")
    same = load(tmp_path / "run.csv")
    assert same["output"] == pytest.approx(run["output"], abs=1e-9)
    found = found_in(machine, [same])
    assert set(named(found)) == {"gain"}, found.sentence


def test_noise_is_seen_where_nothing_moves(tmp_path):
    """Noise of 3e-6 m in the second before the force begins, as the file says."""
    rng = np.random.default_rng(0)
    t = 0.01 * np.arange(1000)
    x = np.where(t > 1.0, np.sin(5 * (t - 1.0)), 0.0) + 3e-3 * rng.standard_normal(1000)
    rows = np.stack([t, np.where(t > 1.0, 1.0, 0.0), x], axis=1)
    np.savetxt(tmp_path / "run.csv", rows, "%.12g", ",", header="t,u,x2", comments="")
    rest = LINEAR.replace("noise = { output = [2e-6] }", "rest = [0.0, 1.0]")
    (tmp_path / "plant.toml").write_text(rest)
    run = read_machine(tmp_path / "plant.toml")[1](tmp_path / "run.csv")
    assert run.noise["output"].std == pytest.approx([3e-6], rel=0.15)


MASS = [[[1.0]], [[2.0]], [[100.0]], [[1.0]], [[1.0]]]


@pytest.mark.parametrize(
    ("changes", "verdict"),
    [
        ({}, d.NAMED),
        ({"tolerance": {"gain": 0.02}}, d.NOTHING),
        ({"noise": {"output": [0.03]}}, d.NOTHING),
    ],
    ids=["narrow", "wide", "noisy"],
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
        "schema": "ves-residual/1",
        "machine": "linear plant",
        "name": "mass on a spring",
        "time": {"column": "t"},
        "signals": {"input": [{"column": "u"}], "output": [{"column": "y"}]},
        "description": {
            "outputs": [["y", "m"]],
            "structure": dict(zip(("M", "D", "K", "force", "output"), MASS, strict=True)),
        },
        "noise": {"output": [1e-4]},
        **changes,
    }
    (tmp_path / "plant.json").write_text(json.dumps(table))
    machine, load = read_machine(tmp_path / "plant.json")
    run = load(tmp_path / "run.csv")
    candidates = [c for c in machine.candidates() if c.kind in ("gain", "delay")]
    found = d.diagnose(machine, [run], candidates=candidates)
    assert found.verdict == verdict, found.sentence
    assert set(named(found)) == ({"gain"} if verdict == d.NAMED else set())
