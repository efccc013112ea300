"""The Model Method finds arm and sensor from static poses, or says what it cannot find."""

import numpy as np
import pytest

from tests.arms import planar_arm, six_joint_arm
from ves_gym._util.params import ParameterError, write_table
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.gravity import GravityModel
from ves_gym.mechanics.spatial import skew
from ves_gym.simulation.gravity_calibration import (
    calibration_poses,
    fit,
    predict_errors,
    read_calibration,
)

ARMS = {"puma": PUMA_560, "planar": planar_arm(), "wrist": six_joint_arm()}
each_arm = pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS.keys())
EXACT = GravityModel.of(PUMA_560)
Q, Y = calibration_poses(PUMA_560)
W = EXACT.wrench(PUMA_560, Q, Y)
NOISE = 0.3  # N, N m


def sensor(seed, spread=0.03):
    """A reading from a true wrench: gains and cross-talk of 3 %, and an arbitrary zero."""
    rng = np.random.default_rng(seed)
    matrix = np.eye(6) + spread * rng.standard_normal((6, 6))
    zero = rng.normal(0, 20, 6)
    return lambda wrench: wrench @ matrix.T + zero


def noise(count, seed=0):
    return NOISE * np.random.default_rng(seed).standard_normal((count, 6))


# ------------------------------------------------------------------------------ poses


@each_arm
def test_poses_fill_limits_and_tilts(arm):
    q, y = calibration_poses(arm, tilt=0.1)
    low, high = arm.column("q_min"), arm.column("q_max")
    assert q.shape == (47, arm.n) and y.shape == (47, 6)
    for angles, a, b in ((q, low, high), (y[:, 3:5], -0.1, 0.1)):
        assert (angles >= a).all() and (angles <= b).all()
        assert (np.std(angles, axis=0) > 0.23 * (b - a)).all()  # even: 0.26 to 0.29
    np.testing.assert_array_equal(calibration_poses(arm, tilt=0.1)[0], q)
    assert not np.array_equal(calibration_poses(arm, seed=1)[0], q)
    with pytest.raises(ParameterError, match="count"):
        calibration_poses(arm, 0)
    with pytest.raises(ParameterError, match="tilt"):
        calibration_poses(arm, tilt=2.0)


# ----------------------------------------------------------------------- good readings


@pytest.mark.parametrize(("name", "turns"), [*((k, None) for k in ARMS), ("planar", 4000)])
def test_cross_talk_is_recovered_exactly(name, turns):
    """Noise-free: other readings are predicted to 1e-6 N, by many turns as by their limit."""
    arm = ARMS[name]
    read, exact = sensor(1), GravityModel.of(arm)
    q, y = calibration_poses(arm)
    found = fit(arm, q, y, read(exact.wrench(arm, q, y)), iterations=turns)
    q, y = calibration_poses(arm, 200, seed=5)
    errors = predict_errors(found, arm, q, y, read(exact.wrench(arm, q, y)))
    assert errors.max.max() < 1e-6 and max(found.max) < 1e-6


def test_matrix_is_the_true_one_up_to_the_gauge():
    """A sensor whose mean gains and place are right is recovered in full, the arm too."""
    rng = np.random.default_rng(3)
    C = np.eye(6) + 0.02 * rng.standard_normal((6, 6))
    for block in (C[:3, :3], C[3:, 3:]):
        block += np.eye(3) * (1 - np.trace(block) / 3)
    C[3:, :3] = (C[3:, :3] + C[3:, :3].T) / 2
    found = fit(PUMA_560, Q, Y, W @ np.linalg.inv(C).T, iterations=None)
    np.testing.assert_allclose(found.C, C, atol=1e-9)
    assert found.model.mass == pytest.approx(EXACT.mass, abs=1e-8)
    np.testing.assert_allclose(found.model.P, EXACT.P, atol=1e-8)


def test_scales_and_place_of_the_sensor_cannot_be_seen():
    """Gains common to all forces or moments, and a shift r, go into M_total and P."""
    r = np.array([0.01, -0.02, 0.03])
    matrix = np.diag([1.1] * 3 + [0.9] * 3)
    matrix[3:, :3] = skew(r)
    found = fit(PUMA_560, Q, Y, W @ matrix.T)
    np.testing.assert_allclose(found.C, np.eye(6), atol=1e-9)
    assert found.model.mass == pytest.approx(1.1 * EXACT.mass)
    shifted = 0.9 * np.array(EXACT.P)
    shifted[:3] += EXACT.mass * r
    np.testing.assert_allclose(found.model.P, shifted, atol=1e-9)
    assert max(found.max) < 1e-9


def test_turns_only_improve_and_do_not_drift():
    """Two turns take most of the cross-talk away; a hundred leave the noise.

    Setting the gauge moves the sum of squares a little: 1e-6 of it a turn. Noise shrinks
    the vertical gain, which tilts of 0.15 rad show least: 0.5 % of the mass.
    """
    w = sensor(2)(W) + noise(len(W))
    turns = fit(PUMA_560, Q, Y, w, iterations=100)
    total = np.square(turns.history).sum(axis=1)
    assert (np.diff(total) < 1e-6 * total[1:]).all()
    assert total[2] < 0.05 * total[0]
    assert turns.history[0] == turns.rms_before and turns.history[-1] == turns.rms
    limit = fit(PUMA_560, Q, Y, w, iterations=None)
    assert max(limit.rms) < 1.2 * NOISE
    assert turns.model.mass == pytest.approx(limit.model.mass, rel=5e-3)


def test_matrix_and_zero_may_be_kept():
    w = W + noise(len(W))
    found = fit(PUMA_560, Q, Y, w, estimate_matrix=False, estimate_offset=False)
    assert np.array_equal(found.C, np.eye(6)) and found.offset == (0.0,) * 6
    assert found.iterations == 0 and len(found.condition) == 1
    g = W[:, :3] / EXACT.mass  # thesis eq. 3.5
    assert found.model.mass == pytest.approx((g * w[:, :3]).sum() / (g * g).sum())
    assert found.model.mass == pytest.approx(EXACT.mass, abs=0.02)
    np.testing.assert_allclose(found.model.P, EXACT.P, atol=0.1)


def test_sensor_zeroed_anew():
    found = fit(PUMA_560, Q, Y, W)
    shifted = W + np.array([5, 4, 3, 2, 1, 0.0])
    assert predict_errors(found, PUMA_560, Q, Y, shifted).max[0] == pytest.approx(5)
    assert predict_errors(found, PUMA_560, Q, Y, shifted, rezero=True).max.max() < 1e-8


def test_calibration_survives_a_file(tmp_path):
    found = fit(PUMA_560, Q, Y, W + noise(len(W)))
    for name in ("a.toml", "a.json"):
        write_table(tmp_path / name, found)
        assert read_calibration(tmp_path / name) == found


# ------------------------------------------------------------------------ bad readings


def still(column, value):
    """The good poses with one joint (0 to 2) or platform angle (3, 4) held."""
    q, y = Q.copy(), Y.copy()
    (q if column < 3 else y)[:, column] = value
    return q, y


@pytest.mark.parametrize(
    ("poses", "missing", "advice"),
    [
        (still(0, 0.4), "P4 (m1 r1x), P5 (m1 r1z)", "vary joint 1"),
        (still(2, 0.4), "P8 (m3 r3x), P9 (m3 r3y)", "vary joint 3"),
        (still(3, 0.03), "matrix's answer to force y", "tilt the platform in phi_x"),
        ((Q, 0 * Y), "M_total", "tilt the platform in phi_x and phi_y"),
        ((Q, 0.06 * Y), "the calibration matrix", "tilt the platform in phi_x and phi_y"),
        ((Q[:3], Y[:3]), "P5 (m1 r1z)", "take more poses"),
        ((Q[:6], Y[:6]), "calibration matrix", "take more poses"),
    ],
)  # fmt: skip
def test_poses_that_do_not_determine_everything_are_refused(poses, missing, advice):
    """With noise, which makes every matrix look regular."""
    q, y = poses
    with pytest.raises(ParameterError) as refused:
        fit(PUMA_560, q, y, EXACT.wrench(PUMA_560, q, y) + noise(len(q)))
    text = str(refused.value)
    assert text.startswith(f"the {len(q)} poses do not determine ")
    assert missing in text and advice in text


def test_fewer_unknowns_need_fewer_directions():
    q, y = still(4, 0.03)
    w = EXACT.wrench(PUMA_560, q, y)
    found = fit(PUMA_560, q, y, w, estimate_matrix=False)
    assert found.model.mass == pytest.approx(EXACT.mass)


def test_unlike_arrays_are_named():
    nan = W.copy()
    nan[3, 2] = np.nan
    for arguments, message in (
        ((Q[:, :2], Y, W), "q must have shape"),
        ((Q, Y[:5], W), "y must have shape"),
        ((Q, Y, nan), "w must be finite"),
        ((Q[:0], Y[:0], W[:0]), "m >= 1"),
        ((Q, Y, -W), "mass of -93.7"),
    ):
        with pytest.raises(ParameterError, match=message):
            fit(PUMA_560, *arguments)
    with pytest.raises(ParameterError, match="iterations"):
        fit(PUMA_560, Q, Y, W, iterations=0)
    found = fit(PUMA_560, Q, Y, W)
    with pytest.raises(ParameterError, match="not of planar"):
        predict_errors(found, planar_arm(), Q, Y, W)
