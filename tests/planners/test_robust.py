"""The robust planner: what it minimises, by which machines, and that its price is kept."""

from dataclasses import replace

import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.effects.payload import PayloadMass
from ves_gym.mechanics.vehicle import BENT_THESIS, FREE_FLOATING
from ves_gym.planners.direct import Direct
from ves_gym.planners.objective import MeanEnergy
from ves_gym.planners.query import Query, solve
from ves_gym.planners.robust import Robust, ScenarioProblem, _corners, scenarios
from ves_gym.simulation.playback import play_motions
from ves_gym.system.energy import TAIL
from ves_gym.system.system import System

BENT = System(vehicle=BENT_THESIS)

UNCERTAIN = {"base/stiffness": {"error": (-0.2, 0.2)}, "payload/mass": {"mass": (0.0, 5.0)}}
QUERY = Query(
    system=BENT,
    start=(0.3, -0.5, 0.2),
    goal=(1.2, 0.4, -0.6),
    duration=2.0,
    v_max=tuple(BENT.arm.column("v_max").tolist()),
)


@pytest.fixture(scope="module")
def problem():
    return ScenarioProblem(QUERY, 8, scenarios(QUERY.system, UNCERTAIN))


def test_corners_of_few_numbers_are_all_of_them_and_of_many_balanced():
    assert len(np.unique(_corners(3), axis=0)) == 8
    many = _corners(6)
    assert many.shape == (8, 6)
    signs = 2 * many - 1
    np.testing.assert_array_equal(signs.T @ signs, 8 * np.eye(6))


def test_scenarios_are_the_described_machine_with_effects_at_their_ends():
    systems = scenarios(QUERY.system, UNCERTAIN)
    K = [s.base.K[0, 0] / QUERY.system.base.K[0, 0] for s in systems]
    masses = [s.arm.mass - QUERY.system.arm.mass for s in systems]
    assert sorted(np.round(K, 9)) == [0.8, 0.8, 1.2, 1.2]
    assert sorted(np.round(masses, 9)) == [0.0, 0.0, 5.0, 5.0]
    free = scenarios(BENT.replace(vehicle=FREE_FLOATING), UNCERTAIN)
    assert len(free) == 2  # a satellite has no stiffness


@pytest.mark.parametrize("sharpness", [0.0, 5.0])
def test_risk_is_the_mean_or_the_soft_maximum_and_its_derivatives_are_exact(problem, sharpness):
    """Reference: central differences of the value, and of the derivative with u held linear."""
    risk = problem.risk
    x = problem.straight + 0.1 * np.random.default_rng(0).normal(size=problem.straight.size)
    u, slope = problem.momentum(x)
    risk.scale, risk.sharpness = problem.energies(problem.straight), sharpness
    risk.weights[0] = 0.3
    r = problem.energies(x) / risk.scale
    mean = r[1:].mean() if not sharpness else np.log(np.exp(5 * r[1:]).mean()) / 5
    assert risk.value(u) == pytest.approx(0.3 * r[0] + mean, rel=1e-12)
    way = np.random.default_rng(1).normal(size=x.size)
    step = 1e-5
    ends = [problem.objective(x + k * way) for k in (step, -step)]
    gradient = slope.T @ risk.force(u)
    assert gradient @ way == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-6)
    along = slope @ way
    forces = risk.force(u + step * along), risk.force(u - step * along)
    second = along @ (forces[0] - forces[1]) / (2 * step)
    assert way @ risk.curvature(u, slope) @ way == pytest.approx(second, rel=1e-6)
    risk.sharpness = risk.weights[0] = 0.0


def test_a_payload_that_the_servo_does_not_know_costs_what_the_simulation_says():
    """Reference: the nonlinear simulation, whose servo is fed forward as described.

    Without the torque that it lacks the form gives 0.7 of it (4 to 8 kg at 1 s).
    """
    query = replace(QUERY, duration=1.0, goal=(0.7, -0.1, -0.2), v_max=None)
    heavy = query.system.replace(effects=(PayloadMass(mass=5.0),))
    motion = solve(Direct(), query).motion
    at = np.add(query.start, query.goal) / 2
    form, blind = (
        MeanEnergy(heavy.actual, at, 1.0, query.servo, described=arm)
        for arm in (query.system.arm, None)
    )
    played = play_motions(heavy, [motion], servo=query.servo, settle=TAIL).energies()[0].E_mean
    assert form.of(motion) == pytest.approx(played, rel=0.05)
    assert blind.of(motion) < 0.9 * played


def test_the_energies_are_those_of_the_machines(problem):
    x = problem.straight + 0.1 * np.random.default_rng(0).normal(size=problem.straight.size)
    middle = (problem.start + problem.goal) / 2
    expected = [
        MeanEnergy(s, middle, QUERY.duration, QUERY.servo, described=QUERY.system.arm).of(
            problem.motion(x)
        )
        for s in problem.systems
    ]
    np.testing.assert_allclose(problem.energies(x), expected, rtol=1e-9)


@pytest.mark.parametrize("objective", ["mean", pytest.param("worst", marks=pytest.mark.slow)])
def test_the_answer_costs_less_when_the_machine_is_another_and_its_price_is_kept(objective):
    robust = solve(Robust(UNCERTAIN, objective=objective, free=12), QUERY)
    nominal = solve(Robust(UNCERTAIN, objective=objective, free=12, price=1.0), QUERY)
    assert robust.feasible
    assert nominal.feasible
    before, after, known = (
        np.array(e)
        for e in (nominal.info["energies"], robust.info["energies"], robust.info["known"])
    )
    assert after[0] <= 1.15 * robust.info["nominal"]["energies"][0] * (1 + 1e-9)
    measure = np.max if objective == "worst" else np.mean
    assert measure((after / known)[1:]) < 0.97 * measure((before / known)[1:])
    assert (after > 0.99 * known).all()  # what was made for one machine alone is least there


def test_what_cannot_be_asked_is_refused():
    with pytest.raises(ParameterError, match=r"price must be >= 1, got 0\.5"):
        Robust(price=0.5)
    with pytest.raises(
        ParameterError, match="objective must be one of mean, worst, got 'best'"
    ):
        Robust(objective="best")
    with pytest.raises(ParameterError, match="at least one uncertain"):
        solve(Robust({}), QUERY)
    with pytest.raises(ParameterError, match="effect must be one of"):
        solve(Robust({"base/stifness": {"error": (0, 1)}}), QUERY)
