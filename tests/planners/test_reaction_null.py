"""Motion without reaction: where there is such, the base rests; where not, it says so."""

import dataclasses

import numpy as np
import pytest
import scipy

from tests.arms import seven_joint_arm
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.servo import JointServo
from ves_gym.mechanics.vehicle import BENT_THESIS, FREE_FLOATING
from ves_gym.planners.coupling import blocks, coupling_matrix
from ves_gym.planners.query import Query, solve
from ves_gym.planners.reaction_null import (
    ReactionNull,
    ReactionProblem,
    reaction_null_space,
)
from ves_gym.planners.registry import get_planner
from ves_gym.planners.suites import reach100
from ves_gym.simulation.playback import play_motions
from ves_gym.system.energy import base_energy
from ves_gym.system.system import System

BENT = System(vehicle=BENT_THESIS)

# PUMAs on top of each other: heavy links all the way out
SIX = dataclasses.replace(PUMA_560, name="six", links=PUMA_560.links * 2)
SEVEN = dataclasses.replace(PUMA_560, name="seven", links=(PUMA_560.links * 3)[:7])
EIGHT = dataclasses.replace(PUMA_560, name="eight", links=(PUMA_560.links * 3)[:8])


def servo(n):
    return JointServo(kp=(1000.0,) * n, kd=(30.0,) * n)


HOME = np.array([0.3, -0.5, 0.8, 0.4, -0.7, 0.2, 0.5, -0.3])


def test_more_than_six_joints_have_a_reaction_null_space():
    system = System(vehicle=BENT_THESIS, arm=EIGHT)
    N = reaction_null_space(system, HOME)
    assert N.shape == (8, 2)
    np.testing.assert_allclose(N.T @ N, np.eye(2), atol=1e-12)
    assert np.abs(inertia(EIGHT, HOME)[:6, 6:] @ N).max() < 1e-9
    assert np.abs(coupling_matrix(system, HOME) @ N).max() < 1e-9


def disturbance_matrix(system, q):
    """By which joint rates turn a free base, squared."""
    b = blocks(system, q)
    turn = np.linalg.solve(b.Mt, b.Hbm)[3:6]
    return turn.T @ turn


def test_three_joints_have_none():
    assert reaction_null_space(BENT, (0.3, -0.5, 0.8)).shape == (3, 0)
    # but nearly one at (45, 0, 0) deg, thesis 4.2
    assert reaction_null_space(BENT, (np.pi / 4, 0, 0), share=0.02).shape == (3, 1)


def test_six_joints_can_keep_a_free_base_from_turning():
    system = System(arm=SIX, vehicle=FREE_FLOATING)
    N = reaction_null_space(system, HOME[:6], attitude=True)
    assert N.shape == (6, 3)
    assert np.abs(disturbance_matrix(system, HOME[:6]) @ N).max() < 1e-12
    assert reaction_null_space(system, HOME[:6]).shape == (6, 0)


def null_curve(system, q, heading, length, attitude=False):
    """Configurations (k, n) [rad] along the reactionless part of a heading."""

    def part(_, q):
        N = reaction_null_space(system, q, attitude=attitude)
        return N @ (N.T @ heading) / np.linalg.norm(N.T @ heading)

    s = np.linspace(0, length, 101)
    return scipy.integrate.solve_ivp(part, (0, length), q, t_eval=s, rtol=1e-9, atol=1e-12).y.T


@pytest.mark.parametrize(
    "vehicle", [pytest.param(BENT_THESIS, marks=pytest.mark.slow), FREE_FLOATING]
)
def test_seven_joints_move_along_a_curve_without_reaction(vehicle):
    """Simulated: a thousandth of the energy, or of the turn, of a straight line as long."""
    system = System(arm=SEVEN, vehicle=vehicle, drive="prescribed")
    free = vehicle is FREE_FLOATING
    path = null_curve(system, HOME[:7], np.ones(7), 0.5, attitude=free)
    assert np.abs(path[-1] - path[0])[:3].max() > 0.05  # heavy links, not the last ones alone
    motion = Motion.through(path, 2.0)
    other = Motion.straight(path[0], path[0] + 0.5 / np.sqrt(7), 2.0)
    run = play_motions(system, [motion, other], servo=servo(7), settle=0.0)
    if free:
        turned = np.abs(run.y[:, :, 3:]).max(axis=(1, 2))
        assert turned[0] < 1e-3 * turned[1]
    else:
        energy = base_energy(system, run.q, run.y, run.yd).total.max(axis=1)
        assert energy[0] < 1e-3 * energy[1]


@pytest.mark.parametrize(
    "vehicle", [BENT_THESIS, pytest.param(FREE_FLOATING, marks=pytest.mark.slow)]
)
def test_seven_joints_between_any_ends_take_the_least_reaction(vehicle):
    """Less than the straight line's, never more energy on a base with stiffness."""
    system = System(arm=seven_joint_arm(), vehicle=vehicle, drive="prescribed")
    for _, query in reach100(system, "bent-thesis", 2, durations=(2.0,)).queries:
        query = dataclasses.replace(query, system=system)
        plan = solve(get_planner("reaction-null"), query)
        assert plan.feasible
        assert 0 < plan.info["reaction"] < 0.9
        assert 0 < plan.info["null_share"] < 1
        if vehicle is BENT_THESIS:
            straight = solve(get_planner("straight"), query)
            assert plan.predicted.E_mean < 0.7 * straight.predicted.E_mean


@pytest.mark.parametrize("vehicle", [BENT_THESIS, FREE_FLOATING])
def test_the_reaction_is_that_of_the_base_and_its_derivative_exact(vehicle):
    """Root mean square of the base's turn (free) or of sqrt(q'^T Q q') at the middle."""
    system = System(arm=seven_joint_arm(), vehicle=vehicle, drive="prescribed")
    middle, step = HOME[:7] * 0.5, 1e-3 * np.linspace(1.0, -0.5, 7)
    ends = (tuple(middle - step), tuple(middle + step))
    query = Query(system=system, start=ends[0], goal=ends[1], duration=2.0)
    problem = ReactionProblem(query, 8)
    matrix = (disturbance_matrix if vehicle is FREE_FLOATING else coupling_matrix)(
        system, middle
    )
    # mean of the quintic's s'^2 over [0, 1] is 10/7
    expected = np.sqrt(10 / 7 * (2 * step) @ matrix @ (2 * step)) / 2.0
    assert problem.reaction(problem.straight) == pytest.approx(expected, rel=1e-3)
    rng = np.random.default_rng(0)
    x = problem.straight + 0.3 * rng.normal(size=problem.straight.size)
    way = rng.normal(size=x.size)
    ahead, back = (problem.momentum(x + h * way)[0] for h in (1e-6, -1e-6))
    slope = problem.momentum(x)[1] @ way
    np.testing.assert_allclose((ahead - back) / 2e-6, slope, atol=1e-6 * np.abs(slope).max())


@pytest.mark.parametrize(("vehicle", "least"), [(BENT_THESIS, 7), (FREE_FLOATING, 4)])
def test_an_arm_that_cannot_be_reactionless_says_so(vehicle, least):
    """Three joints: no answer rather than the straight line by another name, or a worse one."""
    system = System(vehicle=vehicle)
    query = Query(system=system, start=(0.0, -0.2, 0.4), goal=(0.8, 0.5, -0.6), duration=2.0)
    plan = solve(ReactionNull(share=1e-9), query)
    assert plan.found is None
    assert plan.failure.startswith("no reactionless motion: every motion of 3 joints moves")
    assert f"takes {least} joints" in plan.failure


@pytest.mark.parametrize("vehicle", [BENT_THESIS, FREE_FLOATING])
@pytest.mark.slow
def test_no_answer_is_worse_than_the_straight_line(vehicle):
    """Without the refusal 2 of these 12 cost up to 2.0 x (bent), 10 up to 1.7 x (free)."""
    queries = [q for _, q in reach100(BENT, "bent-thesis", 6, durations=(1.0, 4.0)).queries]
    refused = 0
    for query in queries:
        query = dataclasses.replace(query, system=System(vehicle=vehicle))
        plan, straight = (solve(p, query) for p in (ReactionNull(), get_planner("straight")))
        if plan.found is None:
            refused += "x the straight line" in plan.failure
        else:
            assert plan.predicted.E_mean <= straight.predicted.E_mean
    assert refused >= 2


@pytest.mark.parametrize("duration", [0.5, 4.0])
def test_nearly_reactionless_directions_of_the_puma_are_used_where_they_pay(duration):
    """Across (45, 0, 0) deg along its nearly reactionless direction: 0.45 to 0.82 x."""
    middle = np.array([np.pi / 4, 0.0, 0.0])
    direction = reaction_null_space(BENT, middle, share=0.02)[:, 0]
    ends = (tuple((middle + k * direction).tolist()) for k in (-0.4, 0.4))
    query = Query(system=BENT, start=next(ends), goal=next(ends), duration=duration)
    plan = solve(ReactionNull(), query)
    assert plan.found is not None
    assert plan.info["null_share"] > 0.8
    assert plan.predicted.E_mean < 0.85 * solve(get_planner("straight"), query).predicted.E_mean
