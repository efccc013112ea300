"""Jets: which of them make a wrench, whole pulses, propellant."""

from dataclasses import replace

import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.mechanics.pointing import Jet, allocated, pulses, wrench_matrix
from ves_gym.mechanics.vehicle import SERVICER, Satellite

JETS = SERVICER.jets
BIT, THRUST = JETS[0].min_impulse, JETS[0].thrust


def test_twelve_jets_make_any_small_wrench():
    wrench = np.random.default_rng(0).uniform(-3, 3, (200, 6))
    force = allocated(JETS, wrench)
    assert (force >= 0).all()
    assert (force <= THRUST).all()
    np.testing.assert_allclose(force @ wrench_matrix(JETS).T, wrench, atol=1e-6)


def test_jets_do_not_blow_at_each_other():
    force = allocated(JETS, np.array([[4.0, 0, 0, 0, 0, 0]]))[0]
    low = np.array([jet.direction[0] < 0 for jet in JETS])
    assert force[low].max() < 1e-6


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


def run(jet, forces, dt):
    owed, left, out = np.zeros((1, 1)), np.zeros((1, 1)), []
    for force in forces:
        given, owed, left = pulses((jet,), owed, left, np.array([[force]]), dt)
        out.append(given[0, 0])
    return np.array(out)


def test_a_pulse_is_no_smaller_than_the_minimum_impulse_bit():
    """Asked for a tenth of it a period: nothing for nine periods, then one whole bit."""
    dt = 0.0125
    given = run(JETS[0], [BIT / 10 / dt * (1 + 1e-9)] * 40, dt)
    fired = given[given > 0]
    np.testing.assert_allclose(fired, BIT, rtol=1e-6)
    assert len(fired) == 4
    assert not given[:9].any()


def test_a_request_above_the_bit_is_given_at_once():
    dt = 0.0125
    given = run(JETS[0], [0.06 / dt], dt)
    assert given[0] == pytest.approx(0.06)
    assert run(JETS[0], [1e3], dt)[0] == pytest.approx(
        THRUST * dt
    )  # no more than on all the time


def test_a_pulse_longer_than_a_period_goes_on():
    """The smallest pulse takes 2.5 periods; the request ends with the first of them."""
    dt = 0.0125
    jet = replace(JETS[0], min_impulse=2.5 * THRUST * dt)
    given = run(jet, [2.6 * THRUST] + [0.0] * 5, dt)
    assert given.sum() == pytest.approx(jet.min_impulse, rel=0.05)
    np.testing.assert_allclose(given[:2], THRUST * dt)
    assert not given[3:].any()


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"direction": (1.0, 1.0, 0.0)}, "direction must have length 1"),
        ({"thrust": 0.0}, "thrust must be > 0"),
        ({"min_impulse": -1.0}, "min_impulse must be >= 0"),
        ({"specific_impulse": 0.0}, "specific_impulse must be > 0"),
    ],
)
def test_bad_jets_are_refused(change, match):
    with pytest.raises(ParameterError, match=match):
        replace(JETS[0], **change)


def test_a_satellite_has_jets_or_any_wrench():
    with pytest.raises(ParameterError, match="thrusters = true is any wrench"):
        replace(SERVICER, thrusters=True)
    with pytest.raises(ParameterError, match="needs wheels, jets or thrusters"):
        Satellite(body=SERVICER.body, pointing=SERVICER.pointing)
    assert isinstance(JETS[0], Jet)
