"""Motions: at rest at both ends, exact there, and inside limits that are named."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ves_gym._util.params import ParameterError
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.dynamics import inverse_dynamics
from ves_gym.mechanics.limits import LimitError, limit_ratios, require_positions
from ves_gym.mechanics.motion import (
    QUINTIC_PEAK_SPEED,
    Motion,
    quintic,
)

START, GOAL = np.array([0.3, -0.8, 1.1]), np.array([-1.2, 0.4, 0.2])


def wavy(duration=2.0, m=16):
    inner = np.random.default_rng(5).normal(size=(m - 6, 3))
    control = np.vstack([[START] * 3, inner, [GOAL] * 3])
    return Motion(duration=duration, control=tuple(map(tuple, control.tolist())))


def distance_to(motion, points):
    """Largest distance from any of the points to the path."""
    path = motion.at(np.linspace(0, motion.duration, 4001)).q
    return max(np.linalg.norm(path - p, axis=1).min() for p in np.asarray(points))


# --------------------------------------------------------------------------- ends

angle = st.floats(-3, 3)
joints = st.tuples(angle, angle, angle)


@settings(max_examples=50, deadline=None)
@given(points=st.lists(joints, min_size=2, max_size=6), duration=st.floats(0.1, 20))
def test_a_motion_starts_and_ends_exactly_and_at_rest(points, duration):
    motion = Motion.through(points, duration)
    ends = motion.at([0.0, duration])
    assert (motion.start == points[0]).all()
    assert (motion.goal == points[-1]).all()
    np.testing.assert_allclose(ends.q, [points[0], points[-1]], rtol=0, atol=1e-14)
    scale = np.ptp(np.array(motion.control), axis=0).max() + 1e-300
    assert np.abs(ends.v).max() <= 1e-12 * scale * 5 * 32 / duration
    assert np.abs(ends.a).max() <= 1e-12 * scale * 20 * 32**2 / duration**2


def test_outside_its_time_a_motion_is_held():
    motion = wavy(2.0)
    before, after = motion.at([-5.0, -1e-9]), motion.at([2.0 + 1e-9, 7.0])
    assert (before.q == motion.at([0.0]).q).all()
    assert (after.q == motion.at([2.0]).q).all()
    for samples in (before, after):
        assert (samples.v == 0).all()
        assert (samples.a == 0).all()


# ------------------------------------------------------------------- constructions


def test_straight_is_the_quintic():
    T = 3.0
    motion = Motion.straight(START, GOAL, T)
    t = np.linspace(0, T, 101)
    u = t / T
    s = motion.at(t)
    span = GOAL - START
    np.testing.assert_allclose(s.q, START + quintic(u)[:, None] * span, atol=1e-14)
    speed = 30 * u**2 - 60 * u**3 + 30 * u**4
    np.testing.assert_allclose(s.v, speed[:, None] / T * span, atol=1e-13)
    acceleration = 60 * u - 180 * u**2 + 120 * u**3
    np.testing.assert_allclose(s.a, acceleration[:, None] / T**2 * span, atol=1e-12)
    assert speed.max() == QUINTIC_PEAK_SPEED
    np.testing.assert_array_equal(quintic([-1, 0, 0.5, 1, 2]), [0, 0, 0.5, 1, 1])


@pytest.mark.parametrize("k", [3, 4])
def test_through_passes_a_few_points_to_a_milliradian(k):
    """The docstring's accuracy, on random way-points within +-2 rad; the median case."""
    rng = np.random.default_rng(k)
    ways = rng.uniform(-2, 2, (30, k, 3))
    misses = [distance_to(Motion.through(way, 2.0), way) for way in ways]
    assert np.median(misses) < 1e-3
    assert max(misses) < 2e-3


def test_fit_recovers_what_lies_in_its_space_and_keeps_the_ends():
    motion = wavy(2.0, m=16)
    again = Motion.fit(motion.at(np.linspace(0, 2, 101)).q, 2.0, controls=16)
    np.testing.assert_allclose(again.control, motion.control, atol=1e-11)
    noisy = motion.at(np.linspace(0, 2, 101)).q + np.random.default_rng(0).normal(size=(101, 3))
    fitted = Motion.fit(noisy, 2.0, controls=12)
    assert len(fitted.control) == 12
    assert (fitted.start == noisy[0]).all()
    assert (fitted.goal == noisy[-1]).all()


def test_degenerate_way_points_and_another_pace():
    straight, middle = Motion.straight(START, GOAL, 1.0), (START + GOAL) / 3
    assert Motion.through([START, START, GOAL, GOAL], 1.0) == straight
    assert (Motion.through([START, START], 1.0).at(np.linspace(0, 1, 9)).v == 0).all()
    twice = Motion.through([START, middle, middle, GOAL], 1.0)
    assert twice == Motion.through([START, middle, GOAL], 1.0)
    u, slow = np.linspace(0, 1, 21), straight.retimed(3.0)
    np.testing.assert_allclose(slow.at(3 * u).q, straight.at(u).q, atol=1e-13)
    np.testing.assert_allclose(slow.at(3 * u).a, straight.at(u).a / 9, atol=1e-11)


E3 = ((0.0, 0.0, 0.0),) * 3
F3 = ((1.0, 1.0, 1.0),) * 3


def timed(*control):
    return lambda: Motion(duration=1.0, control=sum(control, ()))


REFUSED = {
    "duration must be > 0 s": lambda: Motion(duration=0.0, control=E3 + F3),
    r"shape \(>= 6, n\), got \(5, 3\)": timed(E3, F3[:2]),
    r"got \(6,\)": timed((0.0,) * 6),
    "rows of n numbers": timed(E3, (("1",) * 3,) * 3),
    "finite, got nan": timed(E3, ((np.nan,) * 3,) * 3),
    "its first and its last point three": timed(E3[:2], F3[:1], F3),
    "and its last point three times": timed(E3, E3[:1], F3[:2]),
    "start and goal": lambda: Motion.straight([0, 0, 0], [0, 0], 1.0),
    "way-points": lambda: Motion.through([[0, 0, 0]], 1.0),
    "samples": lambda: Motion.fit([[0, 0, 0]], 1.0),
    "controls must be >= 6, got 5": lambda: Motion.fit(np.zeros((20, 3)), 1.0, controls=5),
}


@pytest.mark.parametrize("message", REFUSED)
def test_what_is_no_motion_is_refused(message):
    with pytest.raises(ParameterError, match=message):
        REFUSED[message]()


# -------------------------------------------------------------------------- limits


def test_ratios_are_value_over_limit():
    motion = Motion.straight([0.0, 0, 0], [1.0, -0.5, 0.25], 1.0)
    ratios = limit_ratios(PUMA_560, motion)
    peak = QUINTIC_PEAK_SPEED * np.array([1.0, 0.5, 0.25])
    np.testing.assert_allclose(ratios["velocity"], peak / PUMA_560.column("v_max"), rtol=1e-12)
    np.testing.assert_allclose(
        ratios["position"], np.array([1, 0.5, 0.25]) / PUMA_560.column("q_max"), rtol=1e-12
    )
    s = motion.at(np.linspace(0, 1, 201))
    tau = np.abs(inverse_dynamics(PUMA_560, s.q, s.v, s.a)[0]).max(axis=0)
    np.testing.assert_allclose(ratios["torque"], tau / PUMA_560.column("tau_max"), rtol=1e-12)
    a_max = np.abs(s.a).max(axis=0)
    np.testing.assert_allclose(ratios["acceleration"], a_max / PUMA_560.column("a_max"))


def test_a_position_ratio_is_from_the_middle_of_the_range():
    lopsided = dataclasses.replace(
        PUMA_560,
        links=tuple(dataclasses.replace(k, q_min=-1.0, q_max=2.0) for k in PUMA_560.links),
    )
    motion = Motion.straight([0.5] * 3, [2.0, -1.0, 0.5], 1.0)
    np.testing.assert_allclose(
        limit_ratios(lopsided, motion)["position"], [1, 1, 0], atol=1e-12
    )
    require_positions(lopsided, motion)  # on the limit is inside
    beyond = Motion.straight([0.5] * 3, [2.1, 0.0, 0.5], 1.0)
    with pytest.raises(LimitError, match="about the middle of its range"):
        require_positions(lopsided, beyond)


def test_a_broken_limit_is_named_by_joint_time_and_value():
    motion = Motion.straight([0.0, 0, 0], [0.0, 2.0, 0.0], 9.0)
    with pytest.raises(LimitError, match=r"joint 2 at t = 9\.000 s: 114\.6 deg"):
        require_positions(PUMA_560, motion)
    require_positions(PUMA_560, Motion.straight([0.0, 0, 0], [0.0, 0.2, 0.0], 9.0))
