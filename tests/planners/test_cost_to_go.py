"""The estimate of the cost to go is below every path, and says something."""

import dataclasses
import math

import numpy as np
import pytest

from tests.arms import six_joint_arm
from ves_gym.mechanics.arm_library import get_arm
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.modes import quintic_spectrum
from ves_gym.mechanics.vehicle import BENT_THESIS, FREE_FLOATING, STRAIGHT_HORIZONTAL_THESIS
from ves_gym.planners.cost_to_go import LeastLength, first_moment, spectral_shape
from ves_gym.planners.coupling import metric
from ves_gym.planners.metric import Metric
from ves_gym.planners.ompl_search import Ompl
from ves_gym.planners.query import Query
from ves_gym.planners.relaxation import shorten
from ves_gym.planners.search_costs import Energy, Time, cost_of
from ves_gym.system.system import System

LONG = Query(
    system=System(vehicle=BENT_THESIS),
    start=(-1.0, -0.8, 1.5),
    goal=(1.2, 0.9, -1.4),
    duration=8.0,
)
BASES = {
    "bent-thesis": System(vehicle=BENT_THESIS),
    "consistent": System(vehicle=dataclasses.replace(BENT_THESIS, mass_model="consistent")),
    "straight": System(vehicle=STRAIGHT_HORIZONTAL_THESIS),
    "free": System(vehicle=FREE_FLOATING),
    "six joints": System(vehicle=BENT_THESIS, arm=six_joint_arm()),
}


@pytest.mark.parametrize("base", BASES)
@pytest.mark.parametrize("duration", [None, 2.0])
def test_nothing_is_shorter(base, duration):
    """Neither short steps in the direction of least coupling nor relaxed paths."""
    system = BASES[base].ideal()
    m = Metric(system, "q" if duration is None else "qt", duration)
    bound, arm, rng = LeastLength(m), system.arm, np.random.default_rng(1)
    low, high = arm.column("q_min"), arm.column("q_max")
    a = rng.uniform(low, high, (400, arm.n))
    if base == "free":
        step = rng.normal(size=a.shape)
    else:
        step = np.linalg.eigh(metric(system, a, duration))[1][..., rng.integers(arm.n)]
    for size in (1e-4, 0.5):
        b = np.clip(a + size * step, low, high)
        estimates = [bound(x, y) for x, y in zip(a.tolist(), b.tolist(), strict=True)]
        assert (np.array(estimates) <= m.lengths(a, b) * (1 + 1e-9)).all()
    path = shorten(m, a[:2], 4000).path
    assert bound(a[0].tolist(), a[1].tolist()) <= m.length(path)


def test_it_is_consistent():
    """A triangle's inequality holds, so that no estimate along a path grows by more than it."""
    bound = LeastLength(Metric(LONG.system, "q"))
    a, b, c = np.random.default_rng(0).uniform(-1.5, 1.5, (3, 300, 3)).tolist()
    for x, y, z in zip(a, b, c, strict=True):
        assert bound(x, z) <= bound(x, y) + bound(y, z) + 1e-12
        assert bound(x, y) == pytest.approx(bound(y, x))
        assert bound(x, x) == 0.0


def test_it_is_most_of_a_length_that_a_constant_metric_is_a_tenth_of():
    """Seen: 0.56 and 0.11 of the shortest path on raw Q."""
    m = Metric(LONG.system, "q")
    shortest = m.length(shorten(m, np.array(LONG.ends), 20_000).path)
    apart = np.linalg.norm(np.subtract(*LONG.ends))
    assert LeastLength(m)(LONG.start, LONG.goal) > 0.5 * shortest
    assert m.floor * apart < 0.15 * shortest


def test_first_moment_is_what_the_joints_move():
    """Its derivative by the joints is the linear part of the base momentum."""
    arm, q, step = System(vehicle=BENT_THESIS).arm, np.array([0.3, -0.4, 0.9]), 1e-6
    for j, axis in enumerate(np.eye(3)):
        ends = [first_moment(inertia(arm, q + sign * step * axis)) for sign in (1, -1)]
        expected = inertia(arm, q)[:3, 6 + j]
        np.testing.assert_allclose((ends[0] - ends[1]) / (2 * step), expected, atol=1e-7)


def test_the_signed_spectrum():
    x = np.linspace(0.05, 60, 2000)
    np.testing.assert_allclose(np.abs(spectral_shape(x)), quintic_spectrum(x), atol=1e-12)


def test_a_search_that_is_proven_ends():
    """Time is a norm: the straight line's is the least, and no evaluation more is needed."""
    result = Ompl(objective="time").search(LONG, seed=0)
    assert result.cost == pytest.approx(result.bound, rel=1e-9)
    assert result.evaluations < 100
    assert isinstance(cost_of(LONG, "time"), Time)


def test_informed_search_does_with_fewer_evaluations():
    """Raw Q, 20,000 evaluations and lower bounds at a twentieth: seen 11.46 against 11.61."""
    informed = Ompl(objective="q", evaluations=20_000, relax=False).search(LONG, seed=0)
    assert informed.evaluations < 10_000
    assert informed.cost < 11.61
    assert informed.bound > 6
    assert Energy(LONG).floor() == 0.0


def test_motions_too_slow_for_the_base_have_a_bound_all_the_same():
    """A minute of Canadarm2 moves no mode of the beam: the momentum bounds nothing."""
    system = System(arm=get_arm("canadarm2")).ideal()
    m = Metric(system, "qt", 64.0)
    bound, a, b = LeastLength(m), [0.1] * 7, [0.5] * 7
    assert bound(a, b) >= m.floor * math.dist(a, b) * (1 - 1e-9)
