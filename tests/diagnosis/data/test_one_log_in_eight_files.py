"""One log of a UR5e as people keep logs: described by one command, read as the same numbers."""

import json
import tomllib
from dataclasses import replace

import numpy as np
import pytest
import scipy

from tests import ros_logs
from ves_gym.cli.main import main
from ves_gym.diagnosis.machines.mapping import read_machine
from ves_gym.mechanics.arm_library import get_arm

JOINTS = [
    f"{k}_joint"
    for k in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
]
ARM = get_arm("ur5e")
ARM = replace(
    ARM, links=tuple(replace(k, name=name) for k, name in zip(ARM.links, JOINTS, strict=True))
)
FRICTION = (8.0, 6.0, 5.0, 1.5, 1.2, 1.0)  # N m, hidden


@pytest.fixture(scope="module")
def log():
    """t (T,), q, v, tau (T, 6): Pinocchio's forces and Coulomb friction, with noise."""
    pin = pytest.importorskip("pinocchio")
    model, rng = ARM.to_pinocchio(), np.random.default_rng(0)
    data, t = model.createData(), 0.005 * np.arange(2400)
    w = 2 * np.pi / 12 * np.arange(1, 7)  # six harmonics, mixed anew for each joint
    size, phase = rng.uniform(-1, 1, (6, 6)) / np.arange(1, 7), t[:, None] * w
    q, v, a = (x @ size for x in (np.sin(phase), w * np.cos(phase), -(w**2) * np.sin(phase)))
    tau = np.array([pin.rnea(model, data, *x) for x in zip(q, v, a, strict=True)])
    tau += np.array(FRICTION) * np.tanh(v / 0.01) + 0.05 * rng.standard_normal(tau.shape)
    return t, q + 1e-5 * rng.standard_normal(tau.shape), v, tau


def columns(log, units=False):
    t, *parts = log
    out = {"time [s]" if units else "t": t}
    for what, unit, x in zip(
        ("position", "velocity", "torque"), ("rad", "rad/s", "Nm"), parts, strict=True
    ):
        names = [f"{j}_{what} [{unit}]" if units else f"{j}_{what}" for j in JOINTS]
        out |= dict(zip(names, x.T, strict=True))
    return out


def text(table, mark=",", comma=False, head=True):
    rows = [mark.join(map(repr, row)) for row in np.column_stack([*table.values()]).tolist()]
    body = "\n".join(rows).replace(".", "," if comma else ".")
    return (mark.join(table) + "\n" if head else "") + body


def hdf5(path, table):
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, x in table.items():
            file[name] = x[None]
    with open(path, "r+b") as file:  # as MATLAB begins it
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\0\2IM")
    return path


def bag(path, log, storage):
    return ros_logs.write(
        path, ros_logs.joints("/joint_states", log[0], JOINTS, *log[1:]), storage=storage
    )


def written(folder, log, kind):
    """The file, and what the command is told of it beside."""
    table = columns(log)
    path = folder / "log.csv"
    if kind == "CSV with units":
        path.write_text(text(columns(log, units=True)))
    elif kind == "semicolons":
        path.write_text(text(table, ";"))
    elif kind == "decimal commas":
        path.write_text(text(table, ";", comma=True))
    elif kind == "no header":
        path.write_text(text(table, head=False))
        return path, ["--columns", ",".join(table)]
    elif kind == "MAT 5":
        path = folder / "log.mat"
        scipy.io.savemat(path, table, long_field_names=True)
    elif kind == "MAT 7.3":
        path = hdf5(folder / "log.mat", table)
    elif kind == "MCAP":
        path = bag(folder / "bag", log, "MCAP")
    else:
        bag(folder / "bag", log, "SQLITE3")
        path = folder / "bag"
    return path, []


KINDS = (
    "CSV with units",
    "semicolons",
    "decimal commas",
    "no header",
    "MAT 5",
    "MAT 7.3",
    "MCAP",
    "rosbag2",
)


def described(folder, log, kind):
    """The log's file and the mapping that one command writes."""
    ARM.to_urdf(folder / "ur5e.urdf")
    path, words = written(folder, log, kind)
    words = ["diagnose", str(path), "--describe", "--model", str(folder / "ur5e.urdf"), *words]
    assert main([*words, "--out", str(folder / "out")]) == 0
    return path, folder / "out" / "mapping.toml"


@pytest.mark.parametrize("kind", KINDS)
def test_one_command_describes_and_the_numbers_are_the_same(kind, log, tmp_path):
    path, mapping = described(tmp_path, log, kind)
    table = tomllib.loads(mapping.read_text())
    assert [joint["name"] for joint in table["joint"]] == JOINTS  # HDF5 has the alphabet's
    assert all({"position", "velocity", "force"} <= joint.keys() for joint in table["joint"])
    run = read_machine(mapping)[1](path)
    assert run.dt == pytest.approx(0.005, rel=1e-9)
    for name, x in zip(("q", "v", "tau"), log[1:], strict=True):
        np.testing.assert_allclose(run[name], x, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_all_eight_get_the_same_verdict(log, tmp_path):
    verdicts = {}
    for kind in KINDS:
        folder = tmp_path / kind.replace(" ", "_")
        folder.mkdir()
        path, mapping = described(folder, log, kind)
        words = ["diagnose", str(path), "--machine", str(mapping), "--final", "0"]
        assert main([*words, "--no-figures", "--out", str(folder / "found")]) == 0
        found = json.loads((folder / "found" / "diagnosis.json").read_text())
        (effect,) = found["effects"]
        assert effect["kind"] == "joint/friction"
        verdicts[kind] = effect["value"]
    first = verdicts[KINDS[0]]
    for joint, torque in zip(JOINTS, FRICTION, strict=True):
        assert first[f"coulomb of {joint}"] == pytest.approx(torque, rel=0.01)
    for kind, verdict in verdicts.items():
        assert verdict == pytest.approx(first, rel=1e-6, abs=1e-6), kind
