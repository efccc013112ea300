"""Attitude control: jets and whole pulses, wheels and their limits, the law."""

from dataclasses import replace

import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.mechanics import attitude
from ves_gym.mechanics.pointing import (
    AttitudeControl,
    allocated,
    pulses,
    wheel_axes,
    wheel_torques,
    within_limits,
    wrench_matrix,
)
from ves_gym.mechanics.vehicle import SERVICER, Satellite

JETS = SERVICER.jets
BIT, THRUST = JETS[0].min_impulse, JETS[0].thrust
DT = 0.0125


def test_twelve_jets_make_any_small_wrench():
    wrench = np.random.default_rng(0).uniform(-3, 3, (200, 6))
    force = allocated(JETS, wrench)
    assert (force >= 0).all()
    assert (force <= THRUST).all()
    np.testing.assert_allclose(force @ wrench_matrix(JETS).T, wrench, atol=1e-6)


def test_a_wrench_beyond_the_jets_keeps_its_direction():
    asked = np.array([[200.0, 0, -150.0, 10, 0, 0]])
    got = allocated(JETS, asked) @ wrench_matrix(JETS).T
    share = got[0, 0] / asked[0, 0]
    assert 0 < share < 0.2
    np.testing.assert_allclose(got, share * asked, atol=1e-4)


def test_what_no_jet_can_make_is_left():
    only = (replace(JETS[0], position=(0.0, 0.0, 0.0)),)  # pushes along +x through the origin
    np.testing.assert_array_equal(allocated(only, np.array([[-5.0, 0, 0, 0, 0, 0]])), [[0.0]])
    np.testing.assert_allclose(allocated(only, np.array([[5.0, 3, 0, 0, 0, 0]])), [[5.0]])


def run(jet, forces):
    owed, left, out = np.zeros((1, 1)), np.zeros((1, 1)), []
    for force in forces:
        given, owed, left = pulses((jet,), owed, left, np.array([[force]]), DT)
        out.append(given[0, 0])
    return np.array(out)


def test_a_pulse_is_no_smaller_than_the_minimum_impulse_bit():
    """Asked for a tenth of it a period: nothing for nine periods, then one whole bit."""
    given = run(JETS[0], [BIT / 10 / DT * (1 + 1e-9)] * 40)
    fired = given[given > 0]
    np.testing.assert_allclose(fired, BIT, rtol=1e-6)
    assert len(fired) == 4
    assert not given[:9].any()


def test_a_pulse_longer_than_a_period_goes_on():
    """The smallest pulse takes 2.5 periods; the request ends with the first of them."""
    jet = replace(JETS[0], min_impulse=2.5 * THRUST * DT)
    given = run(jet, [2.6 * THRUST] + [0.0] * 5)
    assert given.sum() == pytest.approx(jet.min_impulse, rel=0.05)
    np.testing.assert_allclose(given[:2], THRUST * DT)
    assert not given[3:].any()


# -------------------------------------------------------------------------- wheels

WHEELS = SERVICER.wheels
FASTEST = WHEELS[0].speed_max


def test_the_reaction_of_the_wheels_is_the_moment():
    moment = np.random.default_rng(0).normal(size=(20, 3))
    torque = wheel_torques(WHEELS, moment)
    np.testing.assert_allclose(-torque @ wheel_axes(WHEELS).T, moment, atol=1e-12)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_torque_and_momentum_limits_on_both_sides(sign):
    def limited(torque, speed):
        full = np.full((1, 4), sign)
        return sign * within_limits(WHEELS, torque * full, speed * full, DT)[0, 0]

    assert limited(0.1, 0.0) == pytest.approx(0.1)  # within
    assert limited(5.0, 0.0) == pytest.approx(0.2)  # the motor's most
    near = FASTEST - 0.1 * DT / 0.02  # 0.1 N m over a period bring it to the end
    assert limited(0.2, near) == pytest.approx(0.1)
    assert limited(0.2, FASTEST) == pytest.approx(0.0, abs=1e-9)
    assert limited(0.2, 1.1 * FASTEST) == 0.0  # beyond: nothing more
    assert limited(-0.2, 1.1 * FASTEST) == pytest.approx(-0.2)  # but it brakes


def test_the_law_is_zero_at_the_target_and_turns_the_shorter_way():
    law, J = AttitudeControl(), np.tile(300 * np.eye(3), (3, 1, 1))
    target = np.tile(attitude.IDENTITY, (3, 1))
    q = attitude.exp([[0, 0, 0], [0.01, 0, 0], [0, 0, 1.5 * np.pi]])
    still = np.zeros((3, 3))
    moment = law.moment(J, target, q, still, still)
    assert not moment[0].any()
    kp = 300 * (2 * np.pi * law.bandwidth) ** 2
    np.testing.assert_allclose(moment[1], [-0.01 * kp, 0, 0], rtol=1e-9)
    assert moment[2, 2] > 0  # 90 deg on, not 270 deg back
    most = 2 * law.damping_ratio * 2 * np.pi * law.bandwidth * 300 * law.spin_max
    assert moment[2, 2] == pytest.approx(most)


def test_no_moment_is_asked_of_a_body_that_turns_as_it_should_by_itself():
    """A spin at its limit towards the target: what is left is spin x (J spin + h)."""
    law, J = AttitudeControl(), np.diag([300.0, 200.0, 100.0])[None]
    q = attitude.exp(np.array([[0.0, 0.0, -1.0]]))
    spin, stored = np.array([[0.0, 0.0, law.spin_max]]), np.array([[1.0, 2.0, 3.0]])
    moment = law.moment(J, attitude.IDENTITY[None], q, spin, stored)
    np.testing.assert_allclose(moment, np.cross(spin, stored), atol=1e-12)


HUGE = tuple(replace(wheel, inertia=500.0) for wheel in WHEELS)


REFUSED = {
    "direction must have length 1": lambda: replace(JETS[0], direction=(1.0, 1.0, 0.0)),
    "axis must have length 1": lambda: replace(WHEELS[0], axis=(1.0, 1.0, 1.0)),
    "viscous must be >= 0": lambda: replace(WHEELS[0], viscous=-1.0),
    "dump_below <= dump_above": lambda: AttitudeControl(dump_below=0.9),
    "must include its wheels' inertia": lambda: replace(SERVICER, wheels=HUGE),
    "thrusters = true is any wrench": lambda: replace(SERVICER, thrusters=True),
    "needs wheels, jets or thrusters": lambda: Satellite(
        body=SERVICER.body, pointing=SERVICER.pointing
    ),
}


@pytest.mark.parametrize("message", REFUSED)
def test_what_cannot_be_is_refused(message):
    with pytest.raises(ParameterError, match=message):
        REFUSED[message]()
