"""`direct` and `damp`: exact gradients, limits at every instant, never worse; moving bases."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize

import ves_gym as vg
from tests.reach import SPEED_LIMITS
from ves_gym.damping.free_vibration import simulate_free_vibration
from ves_gym.damping.plant import GainMatrices
from ves_gym.mechanics.limits import limit_ratios
from ves_gym.mechanics.servo import HIGH_GAINS
from ves_gym.mechanics.vehicle import BENT_THESIS, FREE_FLOATING
from ves_gym.planners import sequential
from ves_gym.planners.direct import DampRelease, Direct
from ves_gym.planners.motion_problem import MotionProblem
from ves_gym.planners.obstacles import Sphere, Surroundings
from ves_gym.planners.prediction import BaseState, predict
from ves_gym.planners.query import NoPlan, Query, first_violation, solve
from ves_gym.planners.registry import get_planner
from ves_gym.planners.sequential import _solver, minimise, quadratic_program
from ves_gym.planners.suites import reach100
from ves_gym.simulation.playback import play_motions
from ves_gym.system.energy import base_energy
from ves_gym.system.system import System

BENT = System(vehicle=BENT_THESIS)

QUERIES = {q.name: q for _, q in reach100(BENT, "bent-thesis", 1).queries}


@pytest.fixture(scope="module", params=QUERIES)
def case(request):
    """One query of the benchmark, and what `direct` answers."""
    query = QUERIES[request.param]
    return query, solve(get_planner("direct"), query)


def value_of(problem, x):
    """E_mean [J] and its gradient."""
    u, slope = problem.momentum(x)
    return problem.energy.value(u), slope.T @ problem.energy.force(u)


def test_speed_position_and_torque_hold_at_every_instant(case):
    """Twenty thousand samples; speed and position are linear in the controls, so exact."""
    query, plan = case
    assert plan.feasible and plan.info["evaluations"] > 1
    straight = predict(query.system, query.straight, query.servo)
    assert plan.predicted.E_mean <= straight.E_mean
    s = plan.motion.at(np.linspace(0, query.duration, 20_001))
    assert (np.abs(s.v).max(axis=0) <= np.array(SPEED_LIMITS) * (1 + 1e-6)).all()
    arm = query.system.arm
    assert (s.q >= arm.column("q_min") - 1e-9).all()
    assert (s.q <= arm.column("q_max") + 1e-9).all()
    ratios = limit_ratios(arm, plan.motion, samples=5001)
    assert ratios["torque"].max() <= 1 + 1e-2  # the torque is no polynomial: sampled


def test_a_turn_faster_than_its_limits_is_refused():
    """180 degrees at 82 deg/s take 2.2 s; at 3 rad/s^2 up to that speed half a second more."""
    query = Query(
        system=BENT,
        start=(-np.pi / 2, 0.0, 0.0),
        goal=(np.pi / 2, 0.0, 0.0),
        duration=2.0,
        v_max=SPEED_LIMITS,
    )
    with pytest.raises(NoPlan, match=r"joint 1 needs 2.2 s at its speed limit, there are 2 s"):
        get_planner("direct").find(query, 0)
    for v_max, least in ((SPEED_LIMITS, "2.67"), ((5.0,) * 3, "2.05"), (None, "2.05")):
        slow = replace(query, v_max=v_max, a_max=(3.0,) * 3)
        with pytest.raises(NoPlan, match=f"needs {least} s at its limits of speed and accel"):
            get_planner("direct").find(slow, 0)


@pytest.mark.parametrize(
    ("vehicle", "drive"), [(BENT_THESIS, "motor"), (FREE_FLOATING, "prescribed")]
)
def test_the_gradient_is_that_of_the_objective(vehicle, drive):
    """Central differences of 1e-5 rad along random directions.

    Tolerance 1e-5 relative: difference error 1e-10, momentum differences 1e-9.
    """
    query = Query(
        system=System(vehicle=vehicle, drive=drive),
        start=(0.4, -0.6, 0.9),
        goal=(0.9, 0.4, -0.5),
        duration=1.3,
    )
    problem = MotionProblem(query, 10)
    rng = np.random.default_rng(1)
    for _ in range(4):
        x = problem.straight + 0.1 * rng.normal(size=problem.straight.size)
        direction = rng.normal(size=x.size)
        value, gradient = value_of(problem, x)
        ahead, behind = (value_of(problem, x + h * direction)[0] for h in (1e-5, -1e-5))
        slope = (ahead - behind) / 2e-5
        assert value > 0
        assert gradient @ direction == pytest.approx(slope, rel=1e-5)
    assert problem.motion(x).duration == 1.3


LIMITED = Query(  # every kind of limit, a ball near the way
    system=BENT,
    start=(-0.6, -0.2, 0.4),
    goal=(0.6, 0.2, 0.1),
    duration=1.5,
    v_max=SPEED_LIMITS,
    a_max=(8.0, 8.0, 20.0),
    surroundings=Surroundings(obstacles=(Sphere(centre=(0.9, 0.1, 1.1), radius=0.1),)),
)


def test_the_slope_of_its_limits():
    """Central differences of 1e-6; relative to the largest entry of a kind."""
    problem = MotionProblem(LIMITED, 8)
    rng = np.random.default_rng(0)
    x, h = problem.straight + 0.02 * rng.normal(size=problem.straight.size), 1e-6
    values, rows = problem.limits(x)
    for _ in range(3):
        d = rng.normal(size=x.size)
        ahead, behind = (problem.limits(x + s * h * d)[0] for s in (1, -1))
        assert len(ahead) == len(behind) == len(values)
        change = (ahead - behind) / (2 * h)
        np.testing.assert_allclose(rows @ d, change, atol=1e-5 * np.abs(change).max())


def test_a_start_outside_the_limits_is_brought_inside():
    query = QUERIES["reach-2s-000"]
    problem = MotionProblem(query, 12)
    rng = np.random.default_rng(0)
    x0 = np.clip(
        problem.straight + 0.3 * rng.normal(size=problem.straight.size), *problem.bounds
    )
    assert problem.limits(x0)[0].max() > 0.5
    minimum = minimise(problem, x0)
    assert minimum.excess < 1e-6
    assert minimum.energy < 0.9 * value_of(problem, problem.straight)[0]


def test_it_ends_at_a_minimum():
    """Nowhere within 1e-3 rad, inside the limits, is there less; to its tolerance."""
    problem = MotionProblem(QUERIES["reach-2s-000"], 12)
    minimum = minimise(problem, problem.straight, tolerance=1e-7)
    values, rows = problem.limits(minimum.x)
    gradient = value_of(problem, minimum.x)[1] / minimum.energy
    low, high = problem.bounds
    box = np.maximum(low - minimum.x, -1e-3), np.minimum(high - minimum.x, 1e-3)
    best = scipy.optimize.linprog(
        gradient, A_ub=rows, b_ub=np.maximum(-values, 1e-9), bounds=np.transpose(box)
    )
    assert best.fun > -1e-4


def test_quadratic_programs_against_their_conditions():
    """Karush, Kuhn and Tucker's, on random problems with a slack variable last."""
    rng = np.random.default_rng(0)
    for _ in range(10):
        R = rng.normal(size=(6, 6))
        H, g = R @ R.T + 0.1 * np.eye(6), rng.normal(size=6)
        A, upper = rng.normal(size=(8, 6)), rng.uniform(0.1, 1.0, 8)
        low, high = np.full(6, -0.5), np.full(6, 0.5)
        x, price = quadratic_program(H, g, A, upper, low, high)
        assert (A @ x <= upper + 1e-8).all() and (price >= -1e-8).all()
        np.testing.assert_allclose(price * (A @ x - upper), 0, atol=1e-7)
        residual = H @ x + g + A.T @ price  # what the bounds carry
        inside = (x > low + 1e-7) & (x < high - 1e-7)
        np.testing.assert_allclose(residual[inside], 0, atol=1e-6)
        assert (residual[x <= low + 1e-7] >= -1e-6).all() and (
            residual[x >= high - 1e-7] <= 1e-6
        ).all()


def test_a_program_without_a_solution_has_no_multipliers():
    """What the solver leaves in them is of no use, and no two runs have the same."""
    A, upper = np.array([[1.0, 0.0], [-1.0, 0.0]]), np.array([-0.4, -0.4])
    x, price = quadratic_program(np.eye(2), np.ones(2), A, upper, -np.ones(2), np.ones(2))
    assert np.isfinite(x).all() and (price == 0).all()


@pytest.mark.slow
def test_no_program_of_a_bounded_plan_is_given_up(monkeypatch):
    """Ten iterations without progress are no cycle: seven of its programs have that many."""
    solved = []

    def watched(size, rows):
        def call(**program):
            result = solver(**program)
            solved.append(solver.stats()["success"])
            return result

        solver = _solver(size, rows)
        call.stats = solver.stats
        return call

    monkeypatch.setattr(sequential, "_solver", watched)
    start, goal = np.radians([[0, -57, 57, 0, 0, 0], [90, -20, 40, 30, -40, 20]])
    system = System.from_dict({"arm": "ur5e", "vehicle": "bent"})
    vg.plan(start, goal, duration=2.0, planner="calm", system=system)
    assert len(solved) > 100 and all(solved)


# ---------------------------------------------------------------------------- a base that moves

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
    base = {"y": query.base.y, "yd": query.base.yd}
    run = play_motions(
        query.system, [motion], servo=query.servo, settle=10.0, watch=True, **base
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
    """The other side: a motion that does not know of the moving base."""
    query = replace(QUERY, goal=(1.9, 0.5, 0.6))
    motions = [solve(Direct(free=18), k).motion for k in (query, replace(query, base=None))]
    assert first_violation(query, motions[0]) is None
    assert "velocity of joint 2" in first_violation(query, motions[1])
    kept, broken = (played(motion, query)[0].limit_check(0) for motion in motions)
    print(kept.reasons, broken.reasons)
    assert kept.inside and not broken.inside


def test_it_goes_on_from_moving_joints():
    query = replace(QUERY, start_rate=(0.2, -0.1, 0.3), goal=(0.9, 0.0, -0.2))
    plan = solve(DampRelease(), query)
    assert plan.feasible, plan.failure
    straight = predict(SYSTEM, query.straight, HIGH_GAINS, base=RELEASED)
    assert plan.predicted.E_mean < 0.7 * straight.E_mean


def test_what_cannot_be_asked():
    far = replace(QUERY, goal=(-2.0, 0.0, 0.0), duration=0.2)
    with pytest.raises(NoPlan, match="joint 1 needs"):
        DampRelease().find(far, 0)
