"""Attitude control: shares of the wheels, their limits, settings that are refused."""

from dataclasses import replace

import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.mechanics import attitude
from ves_gym.mechanics.pointing import (
    AttitudeControl,
    wheel_axes,
    wheel_torques,
    within_limits,
)
from ves_gym.mechanics.vehicle import SERVICER

WHEELS = SERVICER.wheels
FASTEST = WHEELS[0].speed_max
DT = 0.0125


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


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"bandwidth": 0.0}, "bandwidth must be > 0"),
        ({"dump_below": 0.9}, "dump_below <= dump_above"),
    ],
)
def test_bad_settings_are_refused(change, match):
    with pytest.raises(ParameterError, match=match):
        AttitudeControl(**change)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"axis": (1.0, 1.0, 1.0)}, "axis must have length 1"),
        ({"inertia": 0.0}, "inertia must be > 0"),
        ({"torque_max": -1.0}, "torque_max must be > 0"),
        ({"viscous": -1.0}, "viscous must be >= 0"),
    ],
)
def test_bad_wheels_are_refused(change, match):
    with pytest.raises(ParameterError, match=match):
        replace(WHEELS[0], **change)


def test_wheels_heavier_than_their_satellite_are_refused():
    huge = tuple(replace(wheel, inertia=500.0) for wheel in WHEELS)
    with pytest.raises(ParameterError, match="must include its wheels' inertia"):
        replace(SERVICER, wheels=huge)
