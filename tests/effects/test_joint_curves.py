"""Curves at a joint against SciPy's B-splines, and what they refuse."""

import numpy as np
import pytest
import scipy

from ves_gym import ParameterError, System
from ves_gym.effects import JointCurves
from ves_gym.system.effect import joint_torque

MIDDLE, REACH, FASTEST = (0.1, -0.2, 0.0), (1.0, 1.5, 2.0), (1.0, 2.0, 0.5)
RNG = np.random.default_rng(7)
HEIGHTS = {
    "over_angle": RNG.normal(size=(9, 3)),
    "over_angle_turning": RNG.normal(size=(5, 3)),
    "over_rate": RNG.normal(size=(4, 3)),
}


def spline(heights, x):
    """Straight pieces between heights (k,) at even knots over -1 to 1, level beyond."""
    knots = np.linspace(-1, 1, len(heights))
    t = np.concatenate([knots[:1], knots, knots[-1:]])
    return scipy.interpolate.BSpline(t, heights, 1)(np.clip(x, -1, 1))


def curves(**heights):
    flat = {k: tuple(h.ravel()) for k, h in heights.items()}
    return JointCurves(middle=MIDDLE, reach=REACH, fastest=FASTEST, **flat)


@pytest.mark.parametrize("names", [(k,) for k in HEIGHTS] + [tuple(HEIGHTS)])
def test_torque_is_the_sum_of_its_splines(names):
    q, v = RNG.uniform(-3, 3, (200, 3)), RNG.uniform(-2, 2, (200, 3))
    given = {k: HEIGHTS[k] for k in names}
    found = joint_torque([curves(**given)], q, v, np.zeros_like(q), np.ones(3))
    wanted = np.zeros_like(q)
    for j in range(3):
        x, rate = (q[:, j] - MIDDLE[j]) / REACH[j], v[:, j] / FASTEST[j]
        for name, heights in given.items():
            at = rate if name == "over_rate" else x
            sign = -np.tanh(v[:, j] / 0.01) if name == "over_angle_turning" else 1.0
            wanted[:, j] += sign * spline(heights[:, j], at)
    np.testing.assert_allclose(found, wanted, atol=1e-12)


def test_a_curve_of_one_knot_is_level():
    q = RNG.uniform(-3, 3, (20, 3))
    found = joint_torque([curves(over_angle=HEIGHTS["over_angle"][:1])], q, q, q, np.ones(3))
    np.testing.assert_allclose(found, np.broadcast_to(HEIGHTS["over_angle"][0], q.shape))


@pytest.mark.parametrize("size", [1, 4])
def test_a_curve_has_a_number_for_every_joint_and_knot(size):
    effect = JointCurves(middle=MIDDLE, reach=REACH, fastest=FASTEST, over_rate=(1.0,) * size)
    with pytest.raises(ParameterError, match=f"for each knot, or empty, got {size} numbers"):
        System(effects=(effect,))
