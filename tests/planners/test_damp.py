"""Optimal motions against a moving base."""

from dataclasses import replace

import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.damping.free_vibration import simulate_free_vibration
from ves_gym.damping.plant import GainMatrices
from ves_gym.mechanics.servo import HIGH_GAINS
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.planners.damp import DampRelease
from ves_gym.planners.direct import Direct
from ves_gym.planners.prediction import BaseState, predict
from ves_gym.planners.query import NoPlan, Query, solve
from ves_gym.simulation.playback import play_motions
from ves_gym.system.energy import base_energy
from ves_gym.system.system import System

HOME = tuple(np.deg2rad([45.0, 10.0, -20.0]).tolist())
RELEASED = BaseState(y=(0.04, 0.05, -0.03, 0.0, 0.0, 0.0))
SYSTEM = System(vehicle=BENT_THESIS, physics_dt=2.5e-3)
QUERY = Query(
    system=SYSTEM,
    start=HOME,
    goal=HOME,
    duration=3.0,
    base=RELEASED,
    v_max=tuple(SYSTEM.arm.column("v_max").tolist()),
)


@pytest.fixture(scope="module")
def plan():
    return solve(DampRelease(), QUERY)


def played(motion, query=QUERY):
    run = play_motions(
        query.system, [motion], y=query.base.y, yd=query.base.yd, settle=10.0, watch=True
    )
    return run, base_energy(query.system, run.q[0], run.y[0], run.yd[0], run.internal(0))


def test_it_takes_the_energy_out_and_keeps_the_limits(plan):
    """Full nonlinear simulation, torque clipped; high gains hold the arm beside it."""
    assert plan.feasible, plan.failure
    run, energy = played(plan.motion)
    assert run.limit_check(0).inside, run.limit_check(0).reasons
    high = simulate_free_vibration(
        SYSTEM, HOME, [GainMatrices.of(HIGH_GAINS)], RELEASED.y, seconds=run.t[-1]
    )
    assert np.trapezoid(energy.strain, run.t) < 0.7 * high.E_int[0]


def test_its_energy_is_as_predicted(plan):
    """Tolerance: 2 % for what the linear base leaves out at 0.07 m."""
    run, energy = played(plan.motion)
    mean = np.trapezoid(energy.total, run.t) / run.t[-1]
    assert plan.predicted.E_mean == pytest.approx(mean, rel=0.02)


def test_about_a_base_at_rest_limits_are_broken_on_one_that_moves():
    """The other side: `direct` knows of the moving base, not of what servos must give."""
    plan = solve(Direct(free=18), QUERY)
    run, _ = played(plan.motion)
    assert not run.limit_check(0).inside
    assert not plan.feasible


def test_it_goes_on_from_moving_joints():
    query = replace(QUERY, start_rate=(0.2, -0.1, 0.3), goal=(0.9, 0.0, -0.2))
    plan = solve(DampRelease(), query)
    assert plan.feasible, plan.failure
    straight = predict(SYSTEM, query.straight, HIGH_GAINS, base=RELEASED)
    assert plan.predicted.E_mean < 0.7 * straight.E_mean


def test_what_cannot_be_asked():
    with pytest.raises(ParameterError, match="free must be >= 1 or None, got 0"):
        DampRelease(free=0)
    with pytest.raises(ParameterError, match="rounds must be >= 1, got 0"):
        DampRelease(rounds=0)
    far = replace(QUERY, goal=(-2.0, 0.0, 0.0), duration=0.2)
    with pytest.raises(NoPlan, match="joint 1 needs"):
        DampRelease().find(far, 0)
