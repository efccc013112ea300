"""The platform's servo in pose space: exact answers, whatever the damping."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.running_blocks import pose_platform
from ves_gym._util.params import ParameterError
from ves_gym.hardware.platform import PoseServo

NODES = np.arange(11) * 1.25e-3
DT = NODES[-1]


def commands(periods, n=1, seed=0):
    """Random poses and rates to follow, (periods, n, 6) each."""
    rng = np.random.default_rng(seed)
    return rng.normal(size=(periods, n, 6)) * 1e-2, rng.normal(size=(periods, n, 6)) * 0.1


def started(servo, n=1, **options):
    platform = pose_platform(servo, n, NODES, **options)
    rng = np.random.default_rng(9)
    platform.reset(np.arange(n), rng.normal(size=(n, 6)) * 1e-2, rng.normal(size=(n, 6)) * 0.1)
    return platform


@pytest.mark.parametrize("feedforward", [True, False], ids=["with-rate", "pose-only"])
@pytest.mark.parametrize("zeta", [0.3, 0.7, 1.0, 1 + 1e-9, 4.0])
def test_the_path_solves_the_servos_equation(zeta, feedforward):
    """Against scipy's solve_ivp at every node, four periods with a new command in each.

    Tolerance: the reference's own 1e-11.
    """
    w = 2 * np.pi * 8.0
    platform = started(PoseServo(damping_ratio=zeta, rate_feedforward=feedforward))
    state = np.concatenate([platform.y[0], platform.yd[0]])
    for y_cmd, yd_cmd in zip(*commands(4), strict=True):
        rate = yd_cmd[0] if feedforward else np.zeros(6)

        def motion(t, s, rate=rate, goal=y_cmd[0]):
            e, ed = s[:6] - goal - rate * t, s[6:] - rate
            return np.concatenate([s[6:], -2 * zeta * w * ed - w**2 * e])

        want = solve_ivp(
            motion, (0, DT), state, "DOP853", NODES, rtol=1e-12, atol=1e-14
        ).y.T  # (nodes, 12)
        y, yd, ydd = (part[0] for part in platform.advance(y_cmd, yd_cmd))
        np.testing.assert_allclose(y, want[:, :6], rtol=0, atol=1e-11)
        np.testing.assert_allclose(yd, want[:, 6:], rtol=0, atol=1e-9)
        accelerations = [motion(t, s)[6:] for t, s in zip(NODES, want, strict=True)]
        np.testing.assert_allclose(ydd, accelerations, rtol=0, atol=1e-7)
        state = want[-1]


@pytest.mark.parametrize(("feedforward", "lag"), [(True, 0.0), (False, 2 * 0.7 / (16 * np.pi))])
def test_the_stated_lag_is_that_of_a_ramp(feedforward, lag):
    """A ramp of 0.1 m/s, once settled, lies 0.1 m/s x lag behind.

    Without feed-forward the command is a staircase; seen at its steps it is half a period
    later still on average, all of a period at the instant before the next step.
    """
    servo = PoseServo(rate_feedforward=feedforward)
    assert servo.lag == pytest.approx(lag)
    platform = pose_platform(servo, 1, NODES)
    for k in range(200):
        t = k * DT
        y, _, _ = platform.advance(np.full((1, 6), 0.1 * t), np.full((1, 6), 0.1))
    behind = 0.1 * (t + NODES) - y[0, :, 0]
    hold = 0.0 if feedforward else DT / 2
    assert np.trapezoid(behind, NODES) / DT == pytest.approx(0.1 * (lag + hold), abs=1e-6)


@pytest.mark.parametrize("value", [0.0, np.inf, "8"])
def test_bad_servos_are_refused(value, name="bandwidth"):
    with pytest.raises(ParameterError, match=rf"PoseServo.{name} must be > 0 .*got {value!r}"):
        PoseServo(**{name: value})
