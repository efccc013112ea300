"""Motion without reaction: where there is such, the base rests; where not, it says so."""

import dataclasses

import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.puma import PUMA_560
from ves_gym.mechanics.servo import JointServo
from ves_gym.mechanics.vehicle import FREE_FLOATING
from ves_gym.planners.coupling import coupling_matrix, disturbance_matrix
from ves_gym.planners.query import Query, solve
from ves_gym.planners.reaction_null import ReactionNull, reaction_null_space
from ves_gym.simulation.playback import play_motions
from ves_gym.system.energy import base_energy
from ves_gym.system.system import System

# PUMAs on top of each other: heavy links all the way out
SIX = dataclasses.replace(PUMA_560, name="six", links=PUMA_560.links * 2)
EIGHT = dataclasses.replace(PUMA_560, name="eight", links=(PUMA_560.links * 3)[:8])


def servo(n):
    return JointServo(kp=(1000.0,) * n, kd=(30.0,) * n)


HOME = np.array([0.3, -0.5, 0.8, 0.4, -0.7, 0.2, 0.5, -0.3])


def test_more_than_six_joints_have_a_reaction_null_space():
    system = System(arm=EIGHT)
    N = reaction_null_space(system, HOME)
    assert N.shape == (8, 2)
    np.testing.assert_allclose(N.T @ N, np.eye(2), atol=1e-12)
    assert np.abs(inertia(EIGHT, HOME)[:6, 6:] @ N).max() < 1e-9
    assert np.abs(coupling_matrix(system, HOME) @ N).max() < 1e-9


def test_three_joints_have_none():
    assert reaction_null_space(System(), (0.3, -0.5, 0.8)).shape == (3, 0)
    # but nearly one at (45, 0, 0) deg, thesis 4.2
    assert reaction_null_space(System(), (np.pi / 4, 0, 0), share=0.02).shape == (3, 1)


def test_six_joints_can_keep_a_free_base_from_turning():
    system = System(arm=SIX, vehicle=FREE_FLOATING)
    N = reaction_null_space(system, HOME[:6], attitude=True)
    assert N.shape == (6, 3)
    assert np.abs(disturbance_matrix(system, HOME[:6]) @ N).max() < 1e-12
    assert reaction_null_space(system, HOME[:6]).shape == (6, 0)


def test_a_share_that_is_none():
    with pytest.raises(ParameterError, match=r"share must be >= 0 and < 1, got 1\.0"):
        reaction_null_space(System(), (0.0,) * 3, share=1.0)


def reactionless(system, attitude):
    """A query whose goal is reached along the null space alone, 1.5 rad away."""
    q = HOME[: system.arm.n].copy()
    N = reaction_null_space(system, q, attitude=attitude)
    direction = N @ N.T @ np.r_[1.0, 1.0, -1.0, np.zeros(len(q) - 3)]  # of the heavy links
    for _ in range(1500):
        N = reaction_null_space(system, q, attitude=attitude)
        direction = N @ (N.T @ direction)
        direction /= np.linalg.norm(direction)
        q = q + 1e-3 * direction
    return Query(
        system=system,
        start=tuple(HOME[: system.arm.n]),
        goal=tuple(q),
        duration=2.0,
        servo=servo,
    )


def test_along_it_the_base_rests():
    """Simulated: a hundredth of the straight line's energy at most, the whole way null."""
    system = System(arm=EIGHT, drive="prescribed")
    query = reactionless(system, False)
    plan = solve(ReactionNull(share=1e-6), query)
    assert plan.info["null_share"] > 0.95
    run = play_motions(system, [plan.motion, query.straight], servo=query.servo, settle=0.0)
    energy, straight = base_energy(system, run.q, run.y, run.yd).total.max(axis=1)
    assert energy < 0.01 * straight


def test_without_one_the_line_is_straight():
    query = Query(system=System(), start=(0.0, -0.2, 0.4), goal=(0.8, 0.5, -0.6), duration=2.0)
    plan = solve(ReactionNull(share=1e-9), query)
    assert plan.info["null_share"] == 0.0
    t = np.linspace(0, 2, 51)
    np.testing.assert_allclose(plan.motion.at(t).q, query.straight.at(t).q, atol=1e-6)


def test_a_free_floating_base_keeps_its_attitude():
    system = System(arm=SIX, vehicle=FREE_FLOATING, drive="prescribed")
    query = reactionless(system, True)
    plan = solve(ReactionNull(share=1e-6), query)
    run = play_motions(system, [plan.motion, query.straight], servo=query.servo, settle=0.0)
    turned = np.abs(run.y[:, :, 3:]).max(axis=(1, 2))
    assert turned[0] < 0.02 * turned[1]


def test_nearly_reactionless_directions_of_the_puma_are_used():
    query = Query(
        system=System(),
        start=(np.pi / 4, 0.0, 0.0),
        goal=(np.pi / 4, -0.25, 0.75),
        duration=2.0,
    )
    plan = solve(ReactionNull(), query)
    assert plan.feasible
    assert plan.info["null_share"] > 0.2
