"""The robust planner: its energy is the weighted sum of the machines', its price is kept."""

import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.planners.direct import MotionProblem
from ves_gym.planners.query import Query, solve
from ves_gym.planners.robust import OBJECTIVES, Robust, ScenarioProblem, _corners, scenarios
from ves_gym.simulation.playback import play_motions
from ves_gym.system.system import System

UNCERTAIN = {"base/stiffness": {"error": (-0.2, 0.2)}, "payload/mass": {"mass": (0.0, 5.0)}}
QUERY = Query(
    system=System(),
    start=(0.3, -0.5, 0.2),
    goal=(1.2, 0.4, -0.6),
    duration=2.0,
    v_max=tuple(System().arm.column("v_max").tolist()),
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
    free = scenarios(System().replace(vehicle=_satellite()), UNCERTAIN)
    assert len(free) == 2  # a satellite has no stiffness


def _satellite():
    from ves_gym.mechanics.vehicle import FREE_FLOATING

    return FREE_FLOATING


def test_the_energy_is_the_weighted_sum_of_the_machines(problem):
    weights = np.array([0.4, 0.1, 0.2, 0.0, 0.3])
    problem.weigh(weights)
    x = problem.straight + 0.1 * np.random.default_rng(0).normal(size=problem.straight.size)
    energies = []
    for system in problem.systems:
        own = MotionProblem(Query(**{**vars(QUERY), "system": system}), 8)
        # the inertia is frozen where the query's machine freezes it
        energies.append(own.value(x)[0])
    np.testing.assert_allclose(problem.energies(x), energies, rtol=1e-9)
    value, gradient = problem.value(x)
    assert value == pytest.approx(weights @ energies, rel=1e-9)
    way = np.random.default_rng(1).normal(size=x.size)
    step = 1e-5
    slope = (problem.value(x + step * way)[0] - problem.value(x - step * way)[0]) / (2 * step)
    assert gradient @ way == pytest.approx(slope, rel=1e-6)


@pytest.mark.parametrize("objective", OBJECTIVES)
def test_the_answer_costs_less_when_the_machine_is_another_and_its_price_is_kept(objective):
    robust = solve(Robust(UNCERTAIN, objective=objective, free=12), QUERY)
    nominal = solve(Robust(UNCERTAIN, objective=objective, free=12, price=1.0), QUERY)
    assert robust.feasible
    assert nominal.feasible
    before, after = (np.array(p.info["energies"]) for p in (nominal, robust))
    assert after[0] <= 1.15 * robust.info["nominal"]["energies"][0] * (1 + 1e-9)
    measure = np.max if objective == "worst" else np.mean
    assert measure(after[1:]) < 0.97 * measure(before[1:])
    heavy = scenarios(QUERY.system, UNCERTAIN)[2]
    motions = [nominal.motion, robust.motion]
    energies = [
        play_motions(heavy, [m], servo=QUERY.servo).energies()[0].E_mean for m in motions
    ]
    predicted = before[3], after[3]
    np.testing.assert_allclose(energies, predicted, rtol=0.2)


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
