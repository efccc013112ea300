"""`ves-gym diagnose`: a verdict and a better description, or one line."""

import dataclasses

import numpy as np
import pytest

from ves_gym.effects import JointCoulomb, SensorNoise
from ves_gym.hardware.force_sensor import ForceSensor
from ves_gym.hardware.platform import PoseServo
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.simulation.playback import play_motions
from ves_gym.system.emulator_settings import EmulatorSettings
from ves_gym.system.runlog import RunLog
from ves_gym.system.system import System

SYSTEM = System(
    vehicle=BENT_THESIS,
    mode="emulated",
    control_dt=5e-3,
    emulator=EmulatorSettings(
        platform=PoseServo(bandwidth=10.0),
        sensor=ForceSensor(cutoff=40.0),
        payload_compensation=False,
    ),
)
ENDS = (
    ([0.0, -0.2, 0.1], [0.8, 0.5, -0.6]),
    ([0.5, 0.3, -0.5], [-0.6, -0.4, 0.4]),
    ([-0.4, 0.2, 0.6], [0.5, -0.3, -0.2]),
)


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """Three runs of a machine whose second joint rubs, which its description does not say."""
    noise = SensorNoise(force=(0.3,) * 3, moment=(0.1,) * 3)
    true = SYSTEM.replace(effects=(JointCoulomb(torque=(0.0, 3.0, 0.0)), noise))
    motions = [Motion.straight(np.array(a), b, duration=1.5) for a, b in ENDS]
    recording = play_motions(true, motions, settle=2.0)
    folder, rng = tmp_path_factory.mktemp("logs"), np.random.default_rng(0)
    for i in range(len(ENDS)):
        log = recording.log(i)
        noisy = {
            k: getattr(log, k) + s * rng.standard_normal(getattr(log, k).shape)
            for k, s in (("q", 2e-5), ("tau", 0.1), ("y", 1e-5))
        }
        meta = {**log.meta, "system": SYSTEM.to_dict()}
        dataclasses.replace(log, **noisy, meta=meta).save(folder / f"run-{i + 1}.parquet")
    return folder


@pytest.mark.slow
def test_the_friction_is_named_and_written_down(call, logs, tmp_path):
    status, out, err, result = call("diagnose", logs)
    assert (status, err) == (0, "")
    assert result["schema"] == "ves-diagnose/1"
    assert [(e["kind"], e["slot"]) for e in result["effects"]] == [("joint/coulomb", "joint 2")]
    assert result["effects"][0]["value"]["torque"] == pytest.approx(3.0, rel=0.05)
    low, high = result["effects"][0]["interval"]["torque"]
    assert low < result["effects"][0]["value"]["torque"] < high
    assert result["held_back"] == ["run-3.parquet"]
    before, after = (result[k]["joint/tau_2"] for k in ("final_before", "final_after"))
    assert before > 5 > 2 > after
    assert "joint/coulomb at joint 2" in out
    assert [r["name"] for r in result["ranking"] if r["chosen"]] == ["joint/coulomb at joint 2"]
    assert result["described"] == SYSTEM.hash != result["better"]
    better = System.load(tmp_path / "out" / "system.toml")
    assert better.to_dict() == result["system"]
    assert result["replay_difference"] <= 1e-9 and result["worse"] == []
    low, high = result["final_intervals"]["joint/tau_2"]["before"]
    assert low < before < high and result["closest"] == []
    free = {g["channel"]: g for g in result["free"]["gaps"]}
    assert result["free"]["difference"] <= 1e-9 and result["free"]["runs"] == ["run-3.parquet"]
    assert free["tau_2"]["before"] > 5 * free["tau_2"]["after"]
    page = tmp_path / "out" / "diagnosis.html"
    assert result["sentence"] in page.read_text(encoding="utf-8")
    page.unlink()
    repaired = tmp_path / "out" / "system.toml"
    words = ("--system", repaired, "--final", "0", "--no-figures")
    again = call("diagnose", logs / "run-3.parquet", *words)[3]  # the one that was held back
    assert again["effects"] == [] and again["experiments"] == []
    assert not page.exists()


def test_exchanged_channels_are_a_question(call, logs, tmp_path):
    log = RunLog.load(logs / "run-1.parquet")
    tau = log.tau[:, [1, 0, 2]]
    dataclasses.replace(log, tau=tau).save(tmp_path / "mixed.parquet")
    status, out, err, result = call("diagnose", tmp_path / "mixed.parquet")
    assert (status, out, result) == (2, "", None)
    assert "mixed.parquet: is tau_1 exchanged with tau_2?" in err and err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_logs_of_two_machines_are_refused(call, logs, tmp_path):
    log = RunLog.load(logs / "run-1.parquet")
    meta = {**log.meta, "system": System(control_dt=5e-3).to_dict()}
    dataclasses.replace(log, meta=meta).save(tmp_path / "other.parquet")
    status, out, err, _ = call("diagnose", logs, tmp_path / "other.parquet")
    assert (status, out) == (2, "")
    assert "is of another system" in err and err.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--final", "3"], "--final must leave a log to fit: 0 to 2, got 3"),
        (["--without", "joint/magic"], "no candidate 'joint/magic'; known: "),
        (["--most", "0"], "--most must be >= 1, got 0"),
        (["--machine", "arm.toml", "--arm", "ur5e"], "describe two machines"),
        (["--band", "80"], "sampled at 200 Hz, comparing up to 80 Hz needs at least 320 Hz"),
        (["nowhere.csv"], "nowhere.csv"),
    ],
)
def test_bad_arguments_are_one_line(call, logs, words, said):
    status, out, err, result = call("diagnose", logs, *words)
    assert (status, out, result) == (2, "", None)
    assert said in err and err.count("\n") == 1


def test_data_of_ones_own_are_described_first(call, tmp_path):
    data = tmp_path / "lab.csv"
    data.write_text("t,q_1,tau_1\n" + "".join(f"{k / 100},{k},{k}\n" for k in range(50)))
    status, _, err, _ = call("diagnose", data)
    assert status == 2 and "lab.csv: no run log" in err and "--describe FILE" in err
    status, _, err, _ = call("diagnose", "--describe", data, data)
    assert status == 2 and "got 2: describe one of them" in err
    status, out, _, _ = call("diagnose", "--describe", data)
    mapping = tmp_path / "out" / "mapping.toml"
    assert status == 0 and f"next: ves-gym diagnose {data} --machine {mapping}" in out


def test_logs_that_say_too_little_or_twice_are_refused(call, logs, tmp_path):
    (tmp_path / "empty").mkdir()
    log = RunLog.load(logs / "run-1.parquet")
    meta = {k: v for k, v in log.meta.items() if k != "system"}
    dataclasses.replace(log, meta=meta).save(tmp_path / "bare.parquet")
    for words, said in (
        ([tmp_path / "empty"], "no run log"),
        ([logs, logs / "run-1.parquet"], "given more than once"),
        ([tmp_path / "bare.parquet"], "names no system; give --system FILE"),
        ([logs, "--arm", "iiwa14"], "run-1.parquet: has 3 joints, iiwa14 has 7"),
    ):
        status, out, err, _ = call("diagnose", *words)
        assert (status, out) == (2, "") and said in err
