"""`ves-gym diagnose` designs the motion that decides, and says how to run it."""

import dataclasses
import shlex

import numpy as np
import pytest

from tests.diagnosis.thesis_laboratory import SYSTEM
from ves_gym.diagnosis.inputs import system_inputs
from ves_gym.effects import JointDriveGain, SensorNoise
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.servo import HIGH_GAINS
from ves_gym.planners.case import load_case
from ves_gym.simulation.playback import play_motions
from ves_gym.system.runlog import RunLog

KEPT = ("joint/drive_gain", "joint/torque_offset")
NOISE = {"q": 2e-5, "tau": 0.3, "y": 1e-5}


def logged(log, path, seed):
    """Write a log with noise that names the machine as described, and no controller: what it
    asked would tell the rivals apart."""
    rng = np.random.default_rng(seed)
    noisy = {
        k: getattr(log, k) + s * rng.standard_normal(getattr(log, k).shape)
        for k, s in NOISE.items()
    }
    meta = {k: v for k, v in log.meta.items() if k != "controller"}
    meta["system"] = SYSTEM.to_dict()
    dataclasses.replace(log, **noisy, meta=meta).save(path)


@pytest.mark.slow
def test_the_experiment_that_the_command_designs_decides(call, tmp_path):
    noise = SensorNoise(force=(0.3,) * 3, moment=(0.1,) * 3)
    true = SYSTEM.replace(effects=(JointDriveGain(error=(0.0, 0.007, 0.0)), noise))
    still = Motion.straight([0.3, 0.5, 0.4], [0.5, 0.6, 0.3], 4.0)
    record = play_motions(true, [still], servo=HIGH_GAINS, settle=0.0)
    logged(record.log(0), tmp_path / "run.parquet", 1)
    offered = {c.kind for c in system_inputs([tmp_path / "run.parquet"], final=0).candidates}
    few = [word for k in sorted(offered - {*KEPT}) for word in ("--without", k)]
    few += ["--no-figures", "--no-free-run"]
    status, out, _, result = call("diagnose", tmp_path / "run.parquet", *few)
    assert (status, result["verdict"]) == (0, "one of")
    plan = result["next_motion"]
    assert plan["sentence"] in " ".join(out.split()) and plan["simulate"] in out
    case = load_case(plan["files"][0])
    motion = case.motion
    assert motion.duration == 4.0 and plan["separates"] and plan["least"] > 5 > plan["at_hand"]
    words = shlex.split(plan["simulate"])[1:]
    assert words == ["simulate", "--case", plan["files"][0], "--settle", "0"]
    hidden = dataclasses.replace(case, system=true)  # the machine that is there
    hidden.save(tmp_path / "hidden.toml")
    words[2] = str(tmp_path / "hidden.toml")
    assert call(*words, "--log", tmp_path / "raw.parquet")[0] == 0
    logged(RunLog.load(tmp_path / "raw.parquet"), tmp_path / "experiment.parquet", 2)
    both = [tmp_path / "experiment.parquet", tmp_path / "run.parquet"]
    after = call("diagnose", *both, *few, "--final", "0")[3]
    assert after["verdict"] == "named" and after["next_motion"] is None
    assert [e["name"] for e in after["effects"]] == ["joint/drive_gain at joint 2"]
