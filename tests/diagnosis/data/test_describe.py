"""A robot of one's own: data -> `--describe` -> mapping -> verdict, as in docs/diagnosis.md."""

import json
import tomllib

import numpy as np
import pytest
import scipy

from tests.diagnosis.machines import rigid_arm
from ves_gym._util.params import ParameterError
from ves_gym._util.recordings import FileColumns
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
    text = describe(FileColumns(data), "run.csv")
    assert said in "\n".join(k for k in text.splitlines() if k.startswith("#   - "))
    assert ("the log has 100 Hz" in text) == ("t" in columns)
    tomllib.loads(text)


def test_a_mapping_that_was_described_is_read_as_it_is(tmp_path):
    t = np.arange(1000) * 5e-3
    t[500:] += 0.1
    data = {"t": t, "arm_1_pos": np.sin(t), "arm_1_vel": np.cos(t)}
    text = describe(FileColumns(data), "run.csv")
    assert "row 502 is 0.105 s after the one before" in text
    (tmp_path / "m.toml").write_text(text)
    machine, _ = read_machine(tmp_path / "m.toml")
    assert [p.name for p in machine.ports] == ["velocity"]
    with pytest.raises(ParameterError, match="no column looks like the position"):
        describe(FileColumns({"a": t, "b": t}), "run.csv")
    (tmp_path / "robot.urdf").write_text(rigid_arm.urdf())
    with pytest.raises(ParameterError, match=r"has 3 joints .* the data 1"):
        describe(FileColumns(data), "run.csv", tmp_path / "robot.urdf")


def test_tolerances_of_a_system_are_stated_in_a_file():
    """Sizes by name and pattern, the rest by a factor; what nothing has is refused."""
    system = System()
    usual = {k.name: k.std for k in SystemMachine(system).nuisances}
    known = {"mass of link *": 0.003, "stiffness of the base*": 0}
    stated = StatedErrors(scale=2.0, known=known)
    sizes = {k.name: k.std for k in SystemMachine(system, stated).nuisances}
    assert sizes["mass of link 2"] == 0.003
    assert sizes["gain of joint 1"] == 2 * usual["gain of joint 1"]
    exact = {name for name in usual if name.startswith("stiffness of the base at ")}
    assert len(exact) >= 6 and set(usual) - set(sizes) == exact
    with pytest.raises(
        ParameterError, match="no tolerance 'mass of limb 1'; there are mass of"
    ):
        _ = SystemMachine(system, StatedErrors(known={"mass of limb 1": 0.1})).nuisances
    with pytest.raises(ParameterError, match="noise: expected one of q, v, tau"):
        StatedErrors(noise={"torque": 0.1})


def motion(n=2, seconds=8.0, dt=0.01):
    t = np.arange(0, seconds, dt)
    return t, np.stack([np.sin((1 + 0.3 * k) * t) for k in range(n)], 1)


def described(tmp_path, columns, *words, **options):
    """The mapping that `--describe` writes for columns, and what it says."""
    if columns is not None:
        text = ",".join(columns) + "\n"
        rows = zip(*columns.values(), strict=True)
        text += "\n".join(",".join(f"{x:.9g}" for x in row) for row in rows)
        (tmp_path / "run.csv").write_text(text)
    out = tmp_path / "out"
    assert (
        main(["diagnose", str(tmp_path / "run.csv"), "--describe", "--out", str(out), *words])
        == 0
    )
    text = (out / "mapping.toml").read_text()
    return tomllib.loads(text), text


def test_units_in_names_are_taken(tmp_path):
    t, q = motion()
    columns = {"time [ms]": 1e3 * t}
    for k, (angle, load) in enumerate(zip(q.T, np.cos(q.T), strict=True), 1):
        columns[f"J{k} pos [deg]"] = np.rad2deg(angle)
        columns[f"J{k}_vel_rpm"] = np.gradient(angle, t) * 60 / (2 * np.pi)
        columns[f"J{k}_torque_mNm"] = 1e3 * load
        columns[f"J{k} current (A)"] = load
    table, text = described(tmp_path, columns)
    assert table["time"] == {"column": "time [ms]", "gain": 1e-3, "offset": 0.0}
    for k, joint in enumerate(table["joint"], 1):
        assert joint["position"]["gain"] == pytest.approx(np.pi / 180)
        assert joint["velocity"]["gain"] == pytest.approx(np.pi / 30)
        assert joint["force"] == {"column": f"J{k}_torque_mNm", "gain": 1e-3}
        assert "gain_unknown" not in joint
    assert "# Columns not used: J1 current (A), J2 current (A)" in text


def test_no_number_and_a_name_that_stands_again_lose_no_joint(tmp_path, capsys):
    t, q = motion()
    v = np.gradient(q, t, axis=0)
    q[30, 0] = np.nan
    columns = {"t": t, "q_1": q[:, 0], "q_2": q[:, 1], "v_1": v[:, 0], "v_2": v[:, 1]}
    table, _ = described(tmp_path, columns)
    assert [j["position"]["column"] for j in table["joint"]] == ["q_1", "q_2"]
    assert "understood: q_1: no number in 1 of 800 rows" in capsys.readouterr().out
    _, load = read_machine(tmp_path / "out" / "mapping.toml")
    run = load(tmp_path / "run.csv")
    assert run.meta["notes"] == ["run.csv: 1 of 800 rows lack a number and are left out"]
    np.testing.assert_allclose(run["q"][:, 0], np.sin(run.dt * np.arange(799)), atol=1e-6)
    text = (tmp_path / "run.csv").read_text()
    head, *rows = text.split("\n")
    (tmp_path / "run.csv").write_text("\n".join([f"{head},q_1", *(f"{k},9" for k in rows)]))
    (tmp_path / "out" / "mapping.toml").unlink()
    table, text = described(tmp_path, None)
    assert [j["position"]["column"] for j in table["joint"]] == ["q_1", "q_2"]
    assert "q_1 stands again in column 6, with other numbers: there it is q_1@6" in text


def test_columns_without_names_are_asked_for_by_place(tmp_path, capsys):
    t, q = motion()
    v = np.gradient(q, t, axis=0)
    np.savetxt(tmp_path / "run.csv", np.column_stack([t, q, v]), "%.9g", ",")
    words = ["diagnose", str(tmp_path / "run.csv"), "--describe", "--out", str(tmp_path / "o")]
    assert main(words) == 2
    assert "say what they are, by place (--columns t,q_1" in capsys.readouterr().err
    assert main([*words, "--columns", "t,q_1"]) == 2
    assert "must name 5 columns, got 2" in capsys.readouterr().err
    table, _ = described(tmp_path, None, "--columns", "t,q_1,q_2,v_1,v_2")
    assert table["time"]["column"] == "column_1"
    assert [j["velocity"]["column"] for j in table["joint"]] == ["column_4", "column_5"]
    assert main(["diagnose", str(tmp_path / "run.csv"), "--columns", "t"]) == 2


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda t: np.cumsum(np.where(np.arange(len(t)) % 2, 0.007, 0.013)),
         "uneven steps of 7 to 13 ms, 9.996 ms on average"),
        (lambda t: np.r_[t[:50], t[49], t[50:-1]], "clock that runs forward: 1 of 799 steps"),
        (lambda t: np.r_[t[:50], t[40], t[51:]], "clock that runs forward: 1 of 799 steps"),
        (lambda t: t + 0.5 * (t > 3), "is 0.51 s after the one before"),
    ],
)  # fmt: skip
def test_a_clock_is_described_as_it_is(tmp_path, damage, said):
    t, q = motion()
    table, text = described(tmp_path, {"t": damage(t), "q_1": q[:, 0], "v_1": q[:, 1]})
    assert said in text and table["time"]["column"] == "t"


@pytest.mark.parametrize("late", [1e-3, 4e-3])
def test_what_resampling_is_wrong_by_is_told(tmp_path, late):
    """The truth is known: the bound that is told holds, and is small where the error is."""
    even, _ = motion()
    t = even + late * np.random.default_rng(0).uniform(-1, 1, len(even))
    q = np.sin(9 * t)
    _, text = described(tmp_path, {"t": t, "q_1": q, "v_1": 9 * np.cos(9 * t)})
    told = float(text.split("resampled, wrong by at most ")[1].split(" ")[0])
    error = np.abs(
        scipy.interpolate.CubicSpline(t, 9 * np.cos(9 * t))(even) - 9 * np.cos(9 * even)
    )
    assert error[5:-5].max() <= told < 0.05


def test_joints_are_the_models_by_name_or_by_a_place_that_is_told(tmp_path, capsys):
    """In another order than the model's: names count; words that name no joint go by place."""
    (tmp_path / "robot.urdf").write_text(rigid_arm.urdf())
    t, q = motion(3)
    for names, order, said in (
        (("elbow", "waist", "shoulder"), ("waist", "shoulder", "elbow"), ""),
        (("a", "b", "c"), ("a", "b", "c"), "order does: a = waist, b = shoulder, c = elbow"),
        (("3", "1", "2"), ("1", "2", "3"), "numbers do: 1 = waist, 2 = shoulder, 3 = elbow"),
    ):
        (tmp_path / "out" / "mapping.toml").unlink(missing_ok=True)
        columns = {"t": t} | {f"{k}_joint_position": x for k, x in zip(names, q.T, strict=True)}
        table, _ = described(tmp_path, columns, "--model", str(tmp_path / "robot.urdf"))
        assert [joint["name"] for joint in table["joint"]] == ["waist", "shoulder", "elbow"]
        got = [joint["position"]["column"] for joint in table["joint"]]
        assert got == [f"{k}_joint_position" for k in order]
        out = capsys.readouterr().out
        assert said in out and ("names do not tell which joint is which" in out) == bool(said)


def test_of_two_clocks_one_is_taken_and_the_other_is_told(tmp_path):
    t, q = motion()
    columns = {"t_host": 1.02 * t, "t_robot": t, "q_1": q[:, 0], "q_2": q[:, 1]}
    table, text = described(tmp_path, columns)
    assert table["time"]["column"] == "t_host"
    assert "#   * t_host is the clock; t_robot is one, too, 0.98039 times as fast" in text


def test_a_mapping_without_rates_and_torques_has_nothing_to_compare(tmp_path, capsys):
    t, q = motion()
    described(tmp_path, {"t": t, "q_1": q[:, 0], "q_2": q[:, 1]})
    words = ["diagnose", str(tmp_path / "run.csv"), "--machine"]
    assert main([*words, str(tmp_path / "out" / "mapping.toml")]) == 2
    assert "nothing to compare: say columns of velocity" in capsys.readouterr().err


def test_a_tools_pose_is_no_joint(tmp_path):
    """Columns as a controller's own recorder calls them."""
    t, q = motion()
    columns = {"timestamp": t, "actual_q_0": q[:, 0], "actual_qd_0": np.gradient(q[:, 0], t)}
    columns |= {"actual_TCP_pose_0": q[:, 1], "joint_temperature_0": 30 + q[:, 1]}
    table, text = described(tmp_path, columns)
    assert [j["position"]["column"] for j in table["joint"]] == ["actual_q_0"]
    assert "# Columns not used: actual_TCP_pose_0, joint_temperature_0" in text


def test_german_words_for_commanded_and_actual(tmp_path):
    """Soll is commanded, ist is actual; in longer words they are none."""
    t, q = motion()
    columns = {"t": t, "A1_soll_deg": q[:, 1], "A1_ist_deg": q[:, 0], "A1_ist_Nm": 0.0 * t}
    columns |= {"list": t, "exist": t, "solltek": t}
    table, text = described(tmp_path, columns)
    assert [j["position"]["column"] for j in table["joint"]] == ["A1_ist_deg"]
    assert "# Columns not used: A1_soll_deg, A1_ist_Nm, list, exist, solltek" in text
