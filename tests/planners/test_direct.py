"""`direct`: the gradient is right, the limits hold at every instant, it never loses."""

import dataclasses

import numpy as np
import pytest
import scipy.optimize

from ves_gym.mechanics.dynamics import inverse_dynamics
from ves_gym.mechanics.limits import limit_ratios
from ves_gym.mechanics.vehicle import BENT_THESIS, FREE_FLOATING
from ves_gym.planners.direct import MotionProblem
from ves_gym.planners.obstacles import Sphere, Surroundings
from ves_gym.planners.prediction import predict
from ves_gym.planners.query import NoPlan, Query, solve
from ves_gym.planners.registry import get_planner
from ves_gym.planners.sequential import minimise, quadratic_program
from ves_gym.planners.suites import SPEED_LIMITS, reach100
from ves_gym.system.system import System

BENT = System(vehicle=BENT_THESIS)

QUERIES = {q.name: q for _, q in reach100(BENT, "bent-thesis", 2).queries}


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


def test_a_turn_faster_than_its_speed_limit_is_refused():
    """180 degrees at 82 deg/s take 2.2 s."""
    query = Query(
        system=BENT,
        start=(-np.pi / 2, 0.0, 0.0),
        goal=(np.pi / 2, 0.0, 0.0),
        duration=2.0,
        v_max=SPEED_LIMITS,
    )
    with pytest.raises(NoPlan, match=r"joint 1 needs 2.2 s at its speed limit, there are 2 s"):
        get_planner("direct").find(query, 0)


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


def test_it_starts_from_the_straight_line():
    query = QUERIES["reach-2s-000"]
    problem = MotionProblem(query, 10)
    t = np.linspace(0, 2, 101)
    np.testing.assert_allclose(
        problem.motion(problem.straight).at(t).q, query.straight.at(t).q, atol=1e-9
    )
    assert problem.limits(problem.straight)[0].max() < 1e-9


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


def test_its_limits_are_those_of_the_motion():
    """Control polygons bound speed and acceleration from above; torque is sampled."""
    problem = MotionProblem(dataclasses.replace(LIMITED, surroundings=None), 8)
    x = problem.straight + 0.05 * np.random.default_rng(0).normal(size=problem.straight.size)
    s = problem.motion(x).at(np.linspace(0, 1.5, 4001))
    values = problem.limits(x)[0]
    samples = 2 * 3 * len(problem._torque_times)
    torque = (
        np.abs(inverse_dynamics(problem.arm, s.q, s.v, s.a)[0] / problem._tau_max).max() - 1
    )
    assert values[-samples:].max() == pytest.approx(torque, abs=0.05)
    polygons = values[:-samples].max()
    speed, acceleration = np.abs(s.v / SPEED_LIMITS).max(), np.abs(s.a / LIMITED.a_max).max()
    assert polygons >= max(speed, acceleration) - 1
    assert polygons <= 2.5 * max(speed, acceleration) - 1  # rough motion, wide polygon
    prescribed = Query(
        system=System(vehicle=BENT_THESIS, drive="prescribed"),
        start=(0.0,) * 3,
        goal=(0.1,) * 3,
        duration=1.0,
    )
    assert (
        MotionProblem(prescribed, 8).limits(MotionProblem(prescribed, 8).straight)[0].size == 0
    )


def test_acceleration_limits_hold_at_every_instant():
    query = QUERIES["reach-1s-000"]
    free = solve(get_planner("direct"), query)
    reached = np.abs(free.motion.at(np.linspace(0, 1, 2001)).a).max(axis=0)
    bound = dataclasses.replace(query, a_max=tuple(0.8 * reached))
    plan = solve(get_planner("direct"), bound)
    assert plan.feasible
    a = plan.motion.at(np.linspace(0, 1, 20_001)).a
    assert (np.abs(a) <= 0.8 * reached * (1 + 1e-6)).all()
    assert plan.predicted.E_mean > free.predicted.E_mean


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
