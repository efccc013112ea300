"""Claim: the laboratory `lab` has the wrench errors that thesis 3.2.3 asks of a calibration,
and they move the base as 3.2.2 and 3.2.3 say.

Reference: the same emulation without errors. The arm turns its shoulder by 180 deg in 2 s
(thesis A.5), the base is followed for 10 s; 24 draws of `lab`, without the sensor's noise.
"""

import numpy as np
import pytest

from ves_gym.envs.laboratories import laboratory
from ves_gym.envs.randomize import Draws
from ves_gym.mechanics.gravity import GravityModel
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.vehicle import BENT_THESIS, STRAIGHT_HORIZONTAL_THESIS
from ves_gym.simulation.gravity_calibration import calibration_poses, fit, left_by_noise
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.effect_rows import EffectRows
from ves_gym.system.system import System

TURN = Motion.straight(np.deg2rad([-90, 0, 0]), np.deg2rad([90, 0, 0]), 2.0)
WEIGHT = 919.0  # N, thesis 3.2.3: "a typical payload of a thousand Newtons"
DRAWS = 24


def turn(vehicle):
    """Wrench errors (n, 6) at rest, true motion (k, 6) of the base, its errors (n, k, 6)."""
    system = System(vehicle=vehicle, mode="emulated", physics_dt=2.5e-3)
    draws = Draws(system, laboratory("lab", system).ranges)
    rows = draws.rows(np.random.default_rng(0).random((DRAWS, draws.size)))
    none = {key: np.zeros((1, *v.shape[1:])) for key, v in rows.values.items()}
    sim = Simulator(draws.system, DRAWS + 1)
    sim.assign_effects(EffectRows(draws.system, none, True), [0])
    sim.assign_effects(rows, np.arange(1, DRAWS + 1))
    sample = TURN.at(np.arange(801) * system.control_dt)
    sim.reset(q=sample.q[0])
    wrench = (sim.readings.wrench - sim.readings.gravity)[1:]
    y = []
    for k in range(800):
        command, until = (sim.servo_command(sample.q[i], sample.v[i]) for i in (k, k + 1))
        y.append(sim.step(command, until=until).y)
    path = np.stack(y, axis=1)
    assert not sim.events
    return wrench, path[0], path[1:] - path[0]


@pytest.fixture(scope="module")
def bent():
    return turn(BENT_THESIS)


@pytest.fixture(scope="module")
def straight():
    return turn(STRAIGHT_HORIZONTAL_THESIS)


def rms(errors):
    return np.sqrt((errors**2).sum(axis=1).mean())


def test_wrench_errors_are_within_what_3_2_3_asks_for(bent):
    """1.0 N, 1.5 N m, 0.1 % of the weight; and not so small that nothing would be tested."""
    force, moment = rms(bent[0][:, :3]), rms(bent[0][:, 3:])
    print(f"{force:.2f} N = {force / WEIGHT:.2%} of the weight, {moment:.2f} N m")
    assert 0.5 < force < 1.0
    assert 0.5 < moment < 1.5


def test_the_bent_beam_moves_right_to_a_few_percent(bent):
    """3.2.3; rotation and translation, the median of the draws and the worst of them."""
    _, true, wrong = bent
    for part in (slice(0, 3), slice(3, 6)):
        size = np.linalg.norm(true[:, part], axis=1).max()
        error = np.linalg.norm(wrong[:, :, part], axis=2).max(axis=1) / size
        print(f"median {np.median(error):.1%}, worst {error.max():.1%}")
        assert 0.01 < np.median(error) < 0.04 and error.max() < 0.06


def test_a_percent_would_hide_the_motion_of_the_straight_beam(straight):
    """3.2.2: at 1 % of the weight the error of z is several times the true motion."""
    wrench, true, wrong = straight
    error = np.abs(wrong[:, :, 2]).max(axis=1) / np.abs(true[:, 2]).max()
    percent = 100 * np.linalg.norm(wrench[:, :3], axis=1) / WEIGHT
    per_percent = np.sqrt((error**2).mean() / (percent**2).mean())
    print(f"median {np.median(error):.0%} of z, {per_percent:.1f} times per percent")
    assert np.median(error) > 0.1
    assert 2.0 < per_percent < 13.0  # of a vertical error alone 12.5: claim 12


def test_weights_are_the_scatter_of_the_fit():
    """300 calibrations of noisy readings: mass and moments scatter as predicted."""
    arm = System(vehicle=BENT_THESIS).arm
    q, y = calibration_poses(arm, 47)
    noise = np.array([0.4, 0.3, 0.4, 0.5, 0.7, 0.1])
    left = left_by_noise(arm, q, y, noise)
    weight, rng, found = GravityModel.of(arm).wrench(arm, q, y), np.random.default_rng(0), []
    for _ in range(300):
        w = weight + noise * rng.standard_normal((47, 6))
        one = fit(arm, q, y, w, iterations=None, estimate_offset=False)
        found.append([one.model.mass, *one.model.P])
    predicted = left.model @ left.model.T
    scatter, own = np.cov(np.array(found).T), np.diag(predicted)
    np.testing.assert_allclose(np.diag(scatter), own, rtol=0.35)  # 4 sigma of 300
    size = np.sqrt(np.outer(own, own))
    np.testing.assert_allclose(scatter / size, predicted / size, atol=0.3)
