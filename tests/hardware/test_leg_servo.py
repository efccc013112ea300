"""The leg servos: Table 5-1, margins, and the running platform."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.integrate

from tests.running_blocks import leg_platform
from ves_gym._util.params import ParameterError
from ves_gym.hardware.leg_response import (
    bandwidth,
    gain_margin,
    leg_poles,
    open_loop,
    step_response,
)
from ves_gym.hardware.leg_servo import (
    FILTERED,
    FILTERED_FEEDBACK,
    LEG_SERVOS,
    LOW_GAINS,
    Filter,
    Legs,
    LegServo,
    closed_loop,
)
from ves_gym.hardware.stewart import VES

CONTROL, PHYSICS = 7 / 587, 1 / 1174
servos = pytest.mark.parametrize("servo", LEG_SERVOS.values(), ids=LEG_SERVOS)


def platform(servo: LegServo, n: int = 1):
    per_control = round(servo.rate / 84)
    return leg_platform(servo, VES, n, per_control / servo.rate, 1 / (2 * servo.rate))


def ideal(hertz: float, place: str | None) -> LegServo:
    """An integrator with crossover `hertz`: sampled fast, no lag, no delay, no mode."""
    return LegServo(
        rate=58700.0,
        K1=2 * np.pi * hertz,
        scale=1.0,
        valve_lag=1e-7,
        participation=0.0,
        filter=None if place is None else Filter(place=place),
    )


# -------------------------------------------------------------------------- one leg


def test_nominal_gains_share_one_margin():
    """How `participation` and `scale` were fixed: 12 dB at 2 Hz, and with the filter."""
    assert abs(open_loop(LOW_GAINS, 2.0)) == pytest.approx(1.0, rel=0.01)
    assert gain_margin(LOW_GAINS) == pytest.approx(4.0, rel=0.01)
    assert gain_margin(FILTERED_FEEDBACK) == pytest.approx(4.0, rel=0.02)
    assert gain_margin(FILTERED) > 4.0


def test_K2_lowers_the_overshoot_and_hardly_the_bandwidth():
    """Section 5.6."""
    t = np.arange(0, 1, 1 / 587)
    without = replace(FILTERED, K2=0.0)
    assert step_response(FILTERED, t).max() < step_response(without, t).max() - 0.02
    assert bandwidth(FILTERED) == pytest.approx(bandwidth(without), rel=0.1)


@servos
def test_closed_loop_follows_from_the_open_loop(servo):
    """G = L1 / (1 + L), L1 the part of K1; without the mode it is also the rod's."""
    rigid = replace(servo, participation=0.0)
    f = np.geomspace(0.05, 200, 60)
    expected = open_loop(replace(rigid, K2=0.0), f) / (1 + open_loop(rigid, f))
    if servo.filter is not None and servo.filter.place == "feedback":
        b, a = servo.filter.coefficients(servo.rate)
        z = np.exp(2j * np.pi * f / servo.rate)
        expected *= np.polyval(a, z) / np.polyval(b, z)
    np.testing.assert_allclose(closed_loop(rigid, f), expected, rtol=1e-7)
    assert abs(closed_loop(servo, 0.01)) == pytest.approx(1, rel=1e-3)
    coarse = replace(servo, resolution=1e-4)  # is linearised without, where the leg is
    np.testing.assert_array_equal(closed_loop(coarse, f), closed_loop(servo, f))


def test_step_response_is_that_of_the_differential_equations():
    """Reference: the plant integrated numerically between samples of the low-gain servo."""
    servo = replace(LOW_GAINS, delay=0.0)
    w, zeta = 2 * np.pi * 11.5, servo.mode_damping

    def plant(t, x, u):
        jerk = 4 / servo.valve_lag**2 * (u - x[0] - servo.valve_lag * x[4])
        return [x[4], x[0], x[3], -x[4] - 2 * zeta * w * x[3] - w**2 * x[2], jerk]

    x, last, lengths = np.zeros(5), 0.0, []
    for _ in range(120):
        lengths.append(x[1])
        length = x[1] + servo.participation * x[2]
        u = servo.scale * (servo.K1 * (1 - length) - servo.K2 * (length - last))
        last = length
        span = (0, 1 / servo.rate)
        x = scipy.integrate.solve_ivp(plant, span, x, args=(u,), rtol=1e-10, atol=1e-13).y[
            :, -1
        ]
    response = step_response(servo, np.arange(120) / servo.rate)
    np.testing.assert_allclose(response, lengths, atol=1e-8)


def test_gain_margin_is_where_the_poles_leave_the_circle(servo=FILTERED):
    margin = gain_margin(servo)
    assert np.abs(leg_poles(servo.scaled(0.999 * margin))).max() < 1
    assert np.abs(leg_poles(servo.scaled(1.001 * margin))).max() > 1
    assert gain_margin(servo.scaled(margin * 2)) == pytest.approx(0.5, rel=1e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"delay": 0.5 / 587}, r"delay must be a whole number of leg periods.*nearest is"),
        ({"rate": 18.0, "delay": 0.0}, "corner must be < half the rate"),
        ({"K1": 0.0}, "K1 must be > 0"),
        ({"resolution": -1e-6}, "resolution must be >= 0"),
    ],
)
def test_servos_out_of_range_are_refused(change, message):
    with pytest.raises(ParameterError, match=message):
        replace(FILTERED, **change)
    with pytest.raises(ParameterError, match="place must be one of error, feedback"):
        Filter(place="output")
    with pytest.raises(ParameterError, match="whole number"):
        Filter(order=2.5)


# ----------------------------------------------------------------------- six legs


@servos
def test_the_platform_steps_as_one_leg_does(servo):
    """A small step along z moves all legs alike: each follows `step_response`."""
    legs, y = platform(servo), np.array([[0, 0, 1e-3, 0, 0, 0.0]])
    step = VES.leg_lengths(y) - VES.home_lengths
    nodes = np.concatenate([legs.advance(y)[0][0, :-1] for _ in range(20)])
    response = (VES.leg_lengths(nodes)[::2] - VES.home_lengths) / step
    expected = step_response(servo, np.arange(len(response)) / servo.rate)
    np.testing.assert_allclose(response, np.tile(expected, (6, 1)).T, atol=1e-8)


@pytest.mark.slow
def test_poles_decide_whether_the_running_platform_is_stable():
    """The same gains shake the platform without the filter and settle with it (5.2, 5.3)."""
    fast = replace(LOW_GAINS, K1=6e4, K2=0.0)
    filtered = replace(FILTERED, K1=6e4)
    growth = {servo: np.abs(leg_poles(servo)).max() for servo in (fast, filtered)}
    assert growth[fast] > 1 > growth[filtered]
    errors = {}
    for servo in (fast, filtered):
        legs, y = platform(servo), np.array([[1e-4, 0, 0, 0, 0, 0]])
        runs = [legs.advance(y)[0][0] - y for _ in range(84)]  # 1 s
        errors[servo] = [np.abs(runs[i]).max() for i in (10, 83)]
    assert errors[fast][1] > 1.3 * errors[fast][0]
    settled = growth[filtered] ** (7 * (83 - 10))  # samples of a leg
    assert errors[filtered][1] < 2 * settled * errors[filtered][0] < 0.3 * errors[filtered][0]


@servos
def test_a_platform_at_rest_stays(servo):
    y = np.array([[0.1, 0.05, -0.1, 0.1, -0.05, 0.2]])
    legs = platform(servo)
    legs.reset(np.array([0]), y)
    for _ in range(10):
        pose, rate, acceleration = legs.advance(y)
    np.testing.assert_allclose(pose, np.broadcast_to(y, pose.shape), atol=1e-11)
    assert np.abs(rate).max() < 1e-11
    assert np.abs(acceleration).max() < 1e-9
    np.testing.assert_allclose(legs.measured(), y, atol=1e-11)


def test_measured_pose_is_quantised():
    coarse, y = replace(FILTERED, resolution=1e-3), np.array([[0.01, 0.02, 0.03, 0, 0, 0.1]])
    legs = platform(coarse)
    legs.reset(np.array([0]), y)
    measured = VES.leg_lengths(legs.measured())
    np.testing.assert_allclose(measured, np.round(VES.leg_lengths(y), 3), atol=1e-11)
    exact = platform(FILTERED)
    exact.reset(np.array([0]), y)
    np.testing.assert_allclose(exact.measured(), y, atol=1e-11)


def test_legs_torn_off_give_no_pose_and_spare_the_others():
    legs = platform(LOW_GAINS, 2)
    commands = np.zeros((2, 6))
    commands[1, 2] = 50.0
    alone = platform(LOW_GAINS)
    for _ in range(30):
        y, _, _ = legs.advance(commands)
        np.testing.assert_array_equal(y[:1], alone.advance(commands[:1])[0])
    legs.reset(np.array([1]), np.zeros((1, 6)))
    assert np.isfinite(legs.advance(np.zeros((2, 6)))[0]).all()


@pytest.mark.parametrize(
    ("control", "physics", "message"),
    [
        (0.0125, PHYSICS, r"control_dt must be a whole number .* \* 7 = 0\.01192"),
        (CONTROL, 1e-3, r"physics_dt must divide the leg period .* / 2 = 0\.000851"),
        (0.0, PHYSICS, "control_dt must be"),
    ],
)
def test_rates_that_do_not_divide_are_refused(control, physics, message):
    Legs(FILTERED, VES, CONTROL, PHYSICS)
    with pytest.raises(ParameterError, match=message):
        Legs(FILTERED, VES, control, physics)
