"""A robot of one's own: data -> `--describe` -> mapping -> verdict, as in docs/diagnosis.md."""

import json
import tomllib

import numpy as np
import pytest

from tests.diagnosis.machines import rigid_arm
from ves_gym._util.params import ParameterError
from ves_gym.cli.main import main
from ves_gym.diagnosis.data.describe import describe
from ves_gym.diagnosis.machines.mapping import read_machine
from ves_gym.diagnosis.machines.system import SystemMachine
from ves_gym.diagnosis.machines.tolerances import StatedErrors
from ves_gym.system.system import System


def recorded(path, coulomb, seed=1):
    """A log as robots give them: milliseconds, degrees, currents, names of their own."""
    t, q, v, a = rigid_arm.motion(seed, seconds=12.0)
    rng = np.random.default_rng(seed)
    tau = rigid_arm.load(q, v, a) + rigid_arm.friction(v, 0.0, coulomb)
    q = q + 2e-5 * rng.standard_normal(q.shape)
    v = v + 1e-3 * rng.standard_normal(q.shape)
    ampere = (tau + 0.05 * rng.standard_normal(q.shape)) / [5.0, 8.0, 4.0]
    table = np.column_stack([1e3 * t + 1.7e12, np.rad2deg(q), v, ampere, np.rad2deg(q)])
    names = rigid_arm.JOINTS
    header = ["timestamp"]
    header += [f"{n}_{what}" for what in ("pos", "vel", "current", "pos_cmd") for n in names]
    np.savetxt(path, table, "%.12g", ",", header=",".join(header), comments="")


def test_the_walk_through_from_data_to_a_verdict(tmp_path, capsys):
    """The steps of "A robot of one's own" in docs/diagnosis.md, one by one."""
    (tmp_path / "robot.urdf").write_text(rigid_arm.urdf())
    log, out = tmp_path / "run.csv", tmp_path / "out"
    recorded(log, (4.0, 6.0, 3.0))
    words = ["diagnose", str(log), "--describe", "--model", str(tmp_path / "robot.urdf")]
    assert main([*words, "--out", str(out)]) == 0
    text = (out / "mapping.toml").read_text()
    table = tomllib.loads(text)
    assert table["time"] == {"column": "timestamp", "gain": 1e-3, "offset": -1.7e9}
    first = table["joint"][0]
    assert first["name"] == "waist" and first["gain_unknown"]
    assert first["position"] == {"column": "waist_pos", "gain": np.pi / 180}
    assert first["velocity"] == {"column": "waist_vel"}
    assert first["force"] == {"column": "waist_current"}
    assert "# Columns not used: waist_pos_cmd" in text and "even steps of 10 ms" in text
    assert main([*words, "--out", str(out)]) == 2
    assert "is there already" in capsys.readouterr().err
    (out / "mine.toml").write_text(text)  # here one would correct it
    words = ["diagnose", str(log), "--machine", str(out / "mine.toml"), "--no-figures"]
    assert main([*words, "--without", "joint/velocity_lag", "--out", str(out / "found")]) == 0
    found = json.loads((out / "found" / "diagnosis.json").read_text())
    assert {e["kind"] for e in found["effects"]} <= {"joint/friction", "joint/coulomb"}
    assert found["effects"] and any("drive gain of waist" in note for note in found["notes"])
    for note, gain in zip(found["notes"], (5.0, 8.0, 4.0), strict=False):
        assert float(note.split(": ")[1].split(" ")[0]) == pytest.approx(gain, rel=0.05)


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ({"q1": 0.0, "q2": 0.0}, "a clock: say the step"),
        ({"t": 1.0, "q1": 0.0, "tau1": 0.0}, "velocity of all joints"),
        ({"t": 1.0, "q1": 0.0, "v1": 0.0}, "force of all joints"),
        ({"t": 1.0, "q1": 0.0, "q2": 0.0, "tau1": 0.0}, "force of 2: give it"),
        ({"t": 1.0, "Joint_1_position": 0.0}, "a model"),
    ],
)
def test_what_is_missing_is_said(columns, said):
    t = np.arange(100) * 0.01
    data = {k: t if clock else np.sin(9 * t) for k, clock in columns.items()}
    text = describe(data, "run.csv")
    assert said in "\n".join(k for k in text.splitlines() if k.startswith("#   - "))
    assert ("the log has 100 Hz" in text) == ("t" in columns)
    tomllib.loads(text)


def test_a_mapping_that_was_described_is_read_as_it_is(tmp_path):
    t = np.arange(1000) * 5e-3
    t[500:] += 0.1
    data = {"t": t, "arm_1_pos": np.sin(t), "arm_1_vel": np.cos(t)}
    text = describe(data, "run.csv")
    assert "row 502 is 0.105 s after the one before" in text
    (tmp_path / "m.toml").write_text(text)
    machine, _ = read_machine(tmp_path / "m.toml")
    assert [p.name for p in machine.ports] == ["velocity"]
    with pytest.raises(ParameterError, match="no column looks like the position"):
        describe({"a": t, "b": t}, "run.csv")
    (tmp_path / "robot.urdf").write_text(rigid_arm.urdf())
    with pytest.raises(ParameterError, match=r"has 3 joints .* the data 1"):
        describe(data, "run.csv", tmp_path / "robot.urdf")


def test_tolerances_of_a_system_are_stated_in_a_file():
    """Sizes by name and pattern, the rest by a factor; what nothing has is refused."""
    system = System()
    usual = {k.name: k.std for k in SystemMachine(system).nuisances}
    stated = StatedErrors(
        scale=2.0, known={"mass of link *": 0.003, "stiffness of the base": 0}
    )
    sizes = {k.name: k.std for k in SystemMachine(system, stated).nuisances}
    assert sizes["mass of link 2"] == 0.003
    assert sizes["gain of joint 1"] == 2 * usual["gain of joint 1"]
    assert set(usual) - set(sizes) == {"stiffness of the base"}
    with pytest.raises(
        ParameterError, match="no tolerance 'mass of limb 1'; there are mass of"
    ):
        _ = SystemMachine(system, StatedErrors(known={"mass of limb 1": 0.1})).nuisances
    with pytest.raises(ParameterError, match="noise: expected one of q, v, tau"):
        StatedErrors(noise={"torque": 0.1})
