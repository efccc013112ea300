"""Controllers that damp a released base."""

import numpy as np
import pytest

from ves_gym.baselines.damping import Receding, TunedGains
from ves_gym.baselines.evaluate import evaluate
from ves_gym.baselines.registry import get_controller
from ves_gym.baselines.regulator import Regulator, feedback, observer_gain
from ves_gym.engine.linear import linearise_ideal
from ves_gym.mechanics.servo import PPED_GAINS, JointServo
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.system.system import System

ID, LAB = "ves/PumaDamp-v0", "ves/PumaDampEmulated-v0"


def integrals(controller, id=ID, episodes=2, fails=False):
    rows = evaluate(controller, id, episodes=episodes, threads=1).rows
    assert fails or not any(row["failed"] for row in rows)
    return np.array([row["E_int"] for row in rows])


@pytest.fixture(scope="module")
def tuned():
    return integrals(TunedGains())


@pytest.fixture(scope="module")
def replanned():
    return integrals(Receding())


def test_tuned_gains_are_better_than_those_of_the_thesis(tuned):
    assert (tuned < integrals(get_controller("pped"))).all()
    assert (tuned < integrals(get_controller("high"))).all()


@pytest.mark.slow
def test_replanning_damps_better_than_the_best_gains(tuned, replanned):
    """Claimed: the median of 24 (tests/claims); of these two each."""
    assert (replanned < 0.75 * tuned).all()


@pytest.mark.slow
def test_the_regulator_lies_between(tuned, replanned):
    lqi = integrals(Regulator())
    assert (lqi < 0.95 * tuned).all()
    assert lqi.sum() > replanned.sum()


def test_the_integral_takes_out_what_a_constant_torque_leaves():
    """An unknown torque of 5 N m on each joint, closed loop of the sampled plant, 20 s.

    Without the integral the joints stay away; the other side of the test.
    """
    system, servo = System(vehicle=BENT_THESIS), JointServo(kp=(0.0,) * 3, kd=PPED_GAINS.kd)
    q, dt = np.array([0.8, 0.2, -0.3]), system.control_dt
    A, B = linearise_ideal(system, q, servo=servo).discretise(dt)
    F, L = feedback(system, q, A, B, dt), observer_gain(A, 3, dt)

    def joint_error(F):
        x, estimate, summed = np.zeros(18), np.zeros(18), np.zeros(3)
        for _ in range(1600):
            tau = -F @ np.r_[estimate, summed]
            summed = summed + dt * x[6:9]
            x, estimate = A @ x + B @ (tau + 5.0), A @ estimate + B @ tau
            estimate = estimate + L @ (x[:9] - estimate[:9])
        return np.abs(x[6:9]).max()

    without = F.copy()
    without[:, 18:] = 0.0
    assert joint_error(F) < min(0.01, 0.1 * joint_error(without))


def test_replanning_is_the_same_in_any_company(replanned):
    """Episode by episode, whatever runs beside it: tolerance as of rounding in BLAS."""
    one = evaluate(Receding(), ID, episodes=1, seed=1, threads=1).rows[0]
    assert one["E_int"] == pytest.approx(replanned[1], rel=1e-6)


@pytest.mark.slow
def test_replanning_damps_under_the_errors_of_the_laboratory():
    """Tuned gains fail in some of these episodes, which count as far as they come."""
    ratio = integrals(Receding(), LAB, 8) / integrals(TunedGains(), LAB, 8, fails=True)
    assert np.median(ratio) <= 0.85
