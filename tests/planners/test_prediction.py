"""The linear prediction of base energy and its quadratic form."""

import dataclasses

import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.servo import HIGH_GAINS
from ves_gym.mechanics.spatial import matvec
from ves_gym.mechanics.vehicle import VEHICLES
from ves_gym.planners.prediction import MeanEnergy, predict, spectral_energy
from ves_gym.system.system import System

START = np.array([0.4, -0.6, 0.9])
SMALL = Motion.straight(
    START, START + np.array([1e-3, -2e-3, 1.5e-3]), 1.0
)  # inertia hardly changes
LARGE = Motion.straight(START, START + np.array([0.8, 0.6, -1.2]), 1.0)


def quadratic_form(system, motion, servo):
    """E_mean by `MeanEnergy`, inertia frozen in the middle of the motion."""
    energy = MeanEnergy(system, motion.at(motion.duration / 2).q, motion.duration, servo)
    s = motion.at(energy.t)
    u = matvec(inertia(system.arm, s.q)[..., :6, 6:], s.v).ravel()
    return 0.5 * u @ energy.hessian @ u


@pytest.mark.parametrize("vehicle", ["bent", "straight-vertical", "decoupled", "free-floating"])
@pytest.mark.parametrize("servo", [None, HIGH_GAINS], ids=["exact joints", "servo"])
def test_the_quadratic_form_is_the_prediction_where_inertia_is_constant(vehicle, servo):
    """Tolerance: milliradians change the inertia by 1e-3 relative."""
    system = System(vehicle=VEHICLES[vehicle])
    form = quadratic_form(system, SMALL, servo)
    assert form == pytest.approx(predict(system, SMALL, servo).E_mean, rel=2e-3)
    assert form > 0


def test_it_is_not_where_inertia_changes():
    """The other side of the test above."""
    swing = Motion.straight(START, [-1.0, 1.5, -1.2], 0.8)
    form = quadratic_form(System(), swing, HIGH_GAINS)
    expected = predict(System(), swing, HIGH_GAINS).E_mean
    assert form != pytest.approx(expected, rel=2e-3)
    assert form == pytest.approx(expected, rel=0.5)


def test_the_hessian_is_symmetric_and_semidefinite():
    W = MeanEnergy(System(), START, 1.0, HIGH_GAINS, nodes=24).hessian
    assert W.shape == (150, 150)
    np.testing.assert_allclose(W, W.T, atol=1e-12 * np.abs(W).max())
    assert np.linalg.eigvalsh((W + W.T) / 2)[0] > -1e-12 * np.abs(W).max()


def test_energy_grows_with_the_square_of_a_small_motion():
    twice = Motion.straight(SMALL.start, SMALL.start + 2 * (SMALL.goal - SMALL.start), 1.0)
    a, b = predict(System(), SMALL), predict(System(), twice)
    for name in ("E_mean", "E_res", "E_peak"):
        assert getattr(b, name) == pytest.approx(4 * getattr(a, name), rel=5e-3)


def test_a_motion_that_stands_still_predicts_nothing():
    still = Motion.straight(START, START, 1.0)
    assert predict(System(), still, HIGH_GAINS).to_dict() == {
        "E_mean": 0.0,
        "E_res": 0.0,
        "E_peak": 0.0,
    }
    assert spectral_energy(System(), still) == 0.0


def test_peak_mean_and_end_are_ordered():
    for duration in (0.3, 1.0, 4.0):
        p = predict(System(), LARGE.retimed(duration), HIGH_GAINS)
        assert p.E_peak >= p.E_res > 0
        assert p.E_peak >= p.E_mean > 0


def test_the_servo_counts_on_motor_drives_only():
    motor, prescribed = System(), System(drive="prescribed")
    assert predict(prescribed, LARGE, HIGH_GAINS) == predict(prescribed, LARGE)
    assert predict(motor, LARGE) == predict(prescribed, LARGE)
    assert predict(motor, LARGE, HIGH_GAINS) != predict(motor, LARGE)
    stiff = dataclasses.replace(HIGH_GAINS, kp=(1e8,) * 3, kd=(1e5,) * 3)
    assert predict(motor, LARGE, stiff).E_mean == pytest.approx(
        predict(motor, LARGE).E_mean, rel=1e-3
    )


def test_more_nodes_change_little():
    coarse, fine = (predict(System(), LARGE, HIGH_GAINS, nodes=n) for n in (96, 384))
    assert coarse.E_mean == pytest.approx(fine.E_mean, rel=3e-3)
    assert coarse.E_res == pytest.approx(fine.E_res, rel=1e-2)


def test_a_prediction_wants_a_motion_of_the_arm():
    with pytest.raises(ParameterError, match="q must have shape"):
        predict(System(), Motion.straight([0.0, 0.0], [1.0, 1.0], 1.0))
