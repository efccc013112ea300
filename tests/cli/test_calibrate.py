"""`ves-gym calibrate`: from a log of poses to a calibration file, or one line."""

import numpy as np
import pytest

from ves_gym._util.params import write_table
from ves_gym.mechanics.gravity import GravityModel
from ves_gym.mechanics.puma import PUMA_560
from ves_gym.simulation.gravity_calibration import calibration_poses, read_calibration
from ves_gym.system.runlog import RunLog
from ves_gym.system.system import System

EXACT = GravityModel.of(PUMA_560)
MATRIX = np.eye(6) + 0.02 * np.random.default_rng(1).standard_normal((6, 6))


@pytest.fixture
def poses(tmp_path):
    """Write a log of static poses, as a laboratory would; returns its path."""

    def write(name="poses.csv", count=47, seed=0, zero=3.0, meta=None, still=False, w=True):
        q, y = calibration_poses(PUMA_560, count, seed=seed)
        q[:, 1] = 0.3 if still else q[:, 1]
        readings = EXACT.wrench(PUMA_560, q, y) @ MATRIX.T + zero
        meta = {"system": System().to_dict()} if meta is None else meta
        log = RunLog(
            t=np.arange(count),
            q_cmd=q,
            v_cmd=0 * q,
            q=q,
            y=y,
            w=readings if w else None,
            meta={"format": "ves-run/1", **meta},
        )
        log.save(tmp_path / name)
        return tmp_path / name

    return write


def test_calibrate_finds_the_arm_and_predicts_a_second_log(call, poses, tmp_path):
    other = poses("other.csv", count=20, seed=7, zero=-2.0)
    words = ("--iterations", "limit", "--check", other, "--rezero")
    status, out, err, result = call("calibrate", poses(), *words)
    assert status == 0 and err == ""
    for text in ("M_total", "P9", "m2 r2x + (m2 + m3) a2", "moment z", "check rms"):
        assert text in out
    assert result["schema"] == "ves-calibrate/1" and result["poses"] == 47
    assert len(result["P"]) == len(result["names"]) == 9
    assert max(result["max"]) < 1e-6 < min(result["rms_before"])
    assert max(result["check"]["max"]) < 1e-6

    found = read_calibration(tmp_path / "out" / "calibration.toml")
    assert found.model.mass == result["M_total"]
    assert np.array(found.C).tolist() == result["C"]
    wrench = EXACT.wrench(PUMA_560, np.zeros(3), np.zeros(6))
    estimate = found.model.wrench(PUMA_560, np.zeros(3), np.zeros(6))
    np.testing.assert_allclose(found.wrench(MATRIX @ wrench + 3.0), estimate, atol=1e-6)


def test_calibrate_may_keep_the_matrix_and_take_the_arm_from_a_file(call, poses, tmp_path):
    write_table(tmp_path / "arm.toml", PUMA_560)
    words = (poses(meta={}), "--arm", tmp_path / "arm.toml", "--keep-matrix", "--keep-zero")
    status, _, _, result = call("calibrate", *words)
    assert status == 0 and result["iterations"] == 0 and result["check"] is None
    assert np.array_equal(result["C"], np.eye(6)) and set(result["offset"]) == {0.0}


def test_calibrate_takes_the_thesis_s_two_turns(call, poses):
    _, _, _, result = call("calibrate", poses())
    assert result["iterations"] == 2
    assert np.linalg.norm(result["rms"]) < 0.5 * np.linalg.norm(result["rms_before"])


def test_bad_input_is_one_line(refused, poses):
    assert "vary joint 2" in refused("calibrate", poses(still=True))
    assert "--arm" in refused("calibrate", poses(meta={}))
    assert "w_1" in refused("calibrate", poses(w=False))
    assert "--iterations" in refused("calibrate", poses(), "--iterations", "0")
    assert "--check" in refused("calibrate", poses(), "--rezero")
    assert "nowhere" in refused("calibrate", "nowhere.csv")
    assert "nowhere" in refused("calibrate", poses(), "--check", "nowhere.csv")
