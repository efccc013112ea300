"""Claims of thesis chapter 5: the filter of Table 5-1, and what it does for positioning.

Table 5-2's experiment: a decoupled vehicle with the PUMA on it is released from
Y = (.2, -.2, .1 m, 10, -10, 20 deg); the positioning error is commanded minus actual pose.
"""

import numpy as np
import pytest

from ves_gym.hardware.leg_servo import FILTERED, FILTERED_FEEDBACK, LOW_GAINS, Filter, leg_clock
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.vehicle import DECOUPLED
from ves_gym.simulation.playback import play_motions
from ves_gym.system.emulator_settings import EmulatorSettings
from ves_gym.system.system import System

RELEASE = np.r_[0.2, -0.2, 0.1, np.deg2rad([10, -10, 20])]
STILL = Motion.straight(np.zeros(3), np.zeros(3), 1.0)


def positioning_error(servo):
    """(6,) root mean square of commanded minus actual pose over 10 s."""
    control_dt, physics_dt = leg_clock(servo)
    system = System(
        vehicle=DECOUPLED,
        mode="emulated",
        emulator=EmulatorSettings(platform=servo, payload_compensation=False),
        control_dt=control_dt,
        physics_dt=physics_dt,
    )
    run = play_motions(system, [STILL], settle=9.0, y=RELEASE)
    assert not run.events
    return np.sqrt(((run.y_cmd - run.y)[0] ** 2).mean(axis=0))


def test_coefficients_are_those_of_table_5_1():
    b, a = Filter().coefficients(587.0)
    np.testing.assert_allclose(b, [0.6040, -1.1969, 0.6040], atol=5e-5)
    np.testing.assert_allclose(a, [1.0, -1.9002, 0.9113], atol=5e-5)
    notch = np.angle(np.roots(b)[0]) * 587 / 2 / np.pi
    assert abs(notch) == pytest.approx(12.7, abs=0.05)  # Hz


@pytest.mark.slow
def test_filter_lowers_the_positioning_error_by_about_forty_percent():
    """5.5: about 40 % against low gains without the filter, on every axis."""
    low = positioning_error(LOW_GAINS)
    fall = 1 - positioning_error(FILTERED) / low
    other = 1 - positioning_error(FILTERED_FEEDBACK) / low
    print("lower by", fall.round(3), "and on the feedback by", other.round(3))
    assert fall == pytest.approx(0.40, abs=0.04)
    assert (other > fall).all()
