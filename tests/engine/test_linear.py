"""The space system linearised: against closed forms, MuJoCo's accelerations, printed poles."""

import dataclasses

import numpy as np
import pytest

from tests.arms import WRIST_GAINS
from ves_gym._util.params import ParameterError
from ves_gym.effects import JointStribeck
from ves_gym.engine.linear import linearise_ideal
from ves_gym.mechanics.servo import HIGH_GAINS, PPED_GAINS
from ves_gym.mechanics.vehicle import BENT_THESIS, FREE_FLOATING
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.system import System

FRICTION = JointStribeck(coulomb=(3, 4, 2), stiction=(6, 8, 4), fade_speed=0.3)


@pytest.mark.parametrize(
    ("drive", "vehicle"), [("motor", BENT_THESIS), ("prescribed", FREE_FLOATING)]
)
def test_anywhere_it_is_the_slope_of_mujocos_accelerations(drive, vehicle):
    """Base displaced and turned, commands anywhere: an effect's law and satellites included.

    Tolerance: the law's bend over a step of 1e-6 rad/s, rounding over as much.
    """
    effects = (FRICTION,) if drive == "motor" else ()
    system = System(vehicle=vehicle, drive=drive, effects=effects)
    servo = HIGH_GAINS if drive == "motor" else None
    rng, s, n = np.random.default_rng(1), 9, 3
    q, y = rng.uniform(-2, 2, n), rng.uniform(-0.2, 0.2, 6)
    u = rng.uniform(-10, 10, n) + (np.array(HIGH_GAINS.kp) * q if servo else 0.0)
    found = linearise_ideal(system, q, y=y, servo=servo, command=u)

    size, step = 2 * s + n, 1e-6 * np.r_[np.ones(2 * s), np.full(n, 1e3)]
    point = np.r_[y, q, np.zeros(s), u]
    points = point + np.vstack([np.zeros(size), np.diag(step), -np.diag(step)])
    sim = Simulator(system, len(points), backend="mujoco", servo=servo)
    sim.reset(y=points[:, :6], q=points[:, 6:s], yd=points[:, s : s + 6], v=points[:, 15:18])
    zdd = sim.backend.evaluate(points[:, 18:])[1]
    slope = (zdd[1 : 1 + size] - zdd[1 + size :]).T / (2 * step)
    both = np.hstack([found.A[s:], found.B[s:]])
    size = np.maximum(np.abs(both).max(axis=0), 1.0)  # of each cause
    np.testing.assert_allclose(slope / size, both / size, atol=1e-6)
    np.testing.assert_allclose(found.drift[s:], zdd[0], atol=1e-9 * np.abs(zdd[0]).max())
    assert np.abs(found.drift[s:]).max() > 0.1


@pytest.mark.parametrize(
    ("servo", "printed"),
    [
        (HIGH_GAINS, (-0.31 + 1.79j, -0.21 + 1.89j, -0.19 + 3.17j, -0.32 + 7.05j)),
        (PPED_GAINS, (-0.31 + 1.79j, -0.21 + 1.89j, -0.19 + 3.17j, -0.38 + 7.15j)),
    ],
    ids=["high", "pped"],
)
def test_poles_of_the_beam_are_those_found_before(servo, printed):
    """Reference: the model with which the thesis was first retraced, printed to 0.01 1/s.

    Damping element by element, q = (45, 0, 0) deg. Its rotors were others, which the poles
    of the joints show and the slow ones of the beam do not.
    """
    system = System(vehicle=dataclasses.replace(BENT_THESIS, damping_model="elementwise"))
    poles = np.linalg.eigvals(linearise_ideal(system, np.deg2rad([45, 0, 0]), servo=servo).A)
    for pole in printed:
        assert np.abs(poles - pole).min() < 0.01


def test_sampled_it_is_what_the_simulator_does():
    """A small push held over a control period. Tolerance: RK4 of 1.25 ms steps against the
    exact exponential, and the second order of a motion of 1e-6."""
    system, q = System(vehicle=BENT_THESIS), np.array([0.5, -0.3, 0.2])
    linear = linearise_ideal(system, q, servo=HIGH_GAINS)
    A, B = linear.discretise(system.control_dt)
    rng = np.random.default_rng(2)
    x, u = 1e-6 * rng.uniform(-1, 1, 18), 1e-4 * rng.uniform(-1, 1, 3)
    sim = Simulator(system, servo=HIGH_GAINS)
    start = linear.x0 + x
    sim.reset(y=start[:6], q=start[6:9], yd=start[9:15], v=start[15:])
    after = sim.step((linear.u0 + u)[None])
    there = np.concatenate([after.y, after.q, after.yd, after.v], axis=1)[0] - linear.x0
    np.testing.assert_allclose(A @ x + B @ u, there, atol=1e-5 * np.abs(there).max())
    twice = linear.discretise(2 * system.control_dt)
    np.testing.assert_allclose(twice[0], A @ A, atol=1e-12)
    np.testing.assert_allclose(twice[1], A @ B + B, atol=1e-12)


def test_a_batch_is_its_members():
    q = np.random.default_rng(3).uniform(-2, 2, (4, 5, 3))
    y = 0.1 * np.ones((5, 6))
    many = linearise_ideal(System(vehicle=BENT_THESIS), q, y=y, servo=HIGH_GAINS)
    assert many.A.shape == (4, 5, 18, 18) and many.B.shape == (4, 5, 18, 3)
    assert many.drift.shape == (4, 5, 18)
    assert many.discretise(0.01)[0].shape == (4, 5, 18, 18)
    one = linearise_ideal(System(vehicle=BENT_THESIS), q[2, 3], y=y[3], servo=HIGH_GAINS)
    np.testing.assert_array_equal(one.A, many.A[2, 3])
    np.testing.assert_array_equal(one.drift, many.drift[2, 3])
    assert linearise_ideal(System(vehicle=BENT_THESIS), q[:0, 0]).A.shape == (0, 18, 18)


REFUSED = {  # what is said of what is other than usual
    "needs mode ideal, got emulated": {"system": System(vehicle=BENT_THESIS, mode="emulated")},
    r"q must have shape \(\.\.\., 3\), got \(4,\)": {"q": np.zeros(4)},
    r"y must have shape \(\.\.\., 6\)": {"y": np.zeros(5)},
    "q must be finite": {"q": np.nan},
    r"command must have shape \(\.\.\., 3\)": {"command": np.zeros(2)},
    "axes must broadcast": {"q": np.zeros((2, 3)), "y": np.zeros((3, 6))},
    "servo must have gains for 3 joints, got 6": {"servo": WRIST_GAINS},
    "needs drive motor": {"system": System(drive="prescribed"), "servo": HIGH_GAINS},
}


@pytest.mark.parametrize("message", REFUSED)
def test_wrong_arguments_are_refused(message):
    with pytest.raises(ParameterError, match=message):
        linearise_ideal(**{"system": System(vehicle=BENT_THESIS), **REFUSED[message]})


def test_wrong_periods_are_refused():
    linear = linearise_ideal(System(vehicle=BENT_THESIS))
    for dt in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(ParameterError, match="dt must be > 0 s"):
            linear.discretise(dt)
