"""References that know of vibration: laws, impulses, and the modes they are for."""

import dataclasses

import numpy as np
import pytest

from ves_gym.mechanics.vehicle import BENT_THESIS, FREE_FLOATING
from ves_gym.planners.coupling import modes
from ves_gym.planners.paths import septic
from ves_gym.planners.query import Query, solve
from ves_gym.planners.registry import get_planner
from ves_gym.planners.shaping import (
    ExcitedMode,
    Shaper,
    SmoothJerk,
    excited_modes,
    shaped_motion,
    shaper,
)
from ves_gym.planners.suites import reach100
from ves_gym.simulation.playback import play_motions
from ves_gym.system.system import System

BENT = System(vehicle=BENT_THESIS)

MODE = ExcitedMode(2 * np.pi * 0.8, 0.05, 1.0)


def residual(shape: Shaper, frequency: float, damping: float) -> float:
    """Vibration an impulse train leaves, over that of one impulse (Singer and Seering)."""
    root = np.sqrt(1 - damping**2)
    t, last = shape.times, shape.times[-1]
    grown = shape.sizes * np.exp(-damping * frequency * (last - t))
    return abs(np.sum(grown * np.exp(1j * frequency * root * t)))


@pytest.mark.parametrize("kind", ["zv", "zvd"])
def test_impulses_leave_their_mode_at_rest(kind):
    shape = shaper(kind, MODE)
    assert shape.times[0] == 0 and shape.sizes.sum() == pytest.approx(1.0)
    assert residual(shape, MODE.frequency, MODE.damping) < 1e-12


def test_zvd_forgives_a_wrong_frequency():
    """10 % off: ZV leaves about 15 %, ZVD 2 %; its slope is zero."""
    zv, zvd = (residual(shaper(k, MODE), 1.1 * MODE.frequency, 0.05) for k in ("zv", "zvd"))
    assert 0.1 < zv < 0.2
    assert zvd < 0.03


def test_the_seventh_order_law():
    u = np.linspace(0, 1, 20_001)
    s = septic(u)
    assert (s[0], s[-1]) == (0, 1)
    jerk = np.gradient(np.gradient(np.gradient(s, u), u), u)
    assert abs(jerk[5]) < 0.5 and abs(jerk[-6]) < 0.5
    assert np.gradient(s, u).max() == pytest.approx(35 / 16, rel=1e-6)
    np.testing.assert_array_equal(septic(np.array([-1.0, 2.0])), [0.0, 1.0])


QUERY = Query(
    system=System(
        vehicle=dataclasses.replace(BENT_THESIS, damping_ratio=0.0), drive="prescribed"
    ),
    start=(0.0, -0.1, 0.1),
    goal=(0.1, 0.1, -0.1),
    duration=4.0,
)


def test_modes_are_those_of_the_base_by_energy():
    base_modes = excited_modes(QUERY.system, QUERY.straight)
    energies = [mode.energy for mode in base_modes]
    assert energies == sorted(energies, reverse=True)
    expected = modes(QUERY.system, (0.05, 0.0, 0.0)).omega
    assert sorted(m.frequency for m in base_modes) == pytest.approx(expected)
    damped = excited_modes(BENT, QUERY.straight)
    # 5 % modal damping of the beam alone; the arm's mass takes from it
    assert all(0.005 < mode.damping < 0.06 for mode in damped)
    assert excited_modes(System(vehicle=FREE_FLOATING), QUERY.straight) == []


def test_a_shaped_motion_leaves_less_in_the_modes_it_is_shaped_for():
    """Undamped, small: E_res of the strongest mode down a hundred times, simulated."""
    strongest = excited_modes(QUERY.system, QUERY.straight)[0]
    shaped = shaped_motion(QUERY, shaper("zvd", strongest))
    run = play_motions(QUERY.system, [QUERY.straight, shaped], settle=0.0)
    shapes = modes(QUERY.system, (0.05, 0.0, 0.0))
    k = int(np.abs(shapes.omega - strongest.frequency).argmin())
    M = np.linalg.inv(shapes.shapes @ shapes.shapes.T)
    modal = [
        np.einsum("i,ij,nj->n", shapes.shapes[:, k], M, y)
        for y in (run.y[:, -1], run.yd[:, -1])
    ]
    residual = 0.5 * (modal[1] ** 2 + (strongest.frequency * modal[0]) ** 2)
    assert residual[1] < 0.01 * residual[0]


@pytest.mark.parametrize(
    "name", ["shaped-zv", pytest.param("shaped-zvd", marks=pytest.mark.slow)]
)
def test_shaping_pays_where_there_is_time_for_it(name):
    """Predicted E_res at 4 s, median over queries; and what was shaped for is told."""
    queries = [q for _, q in reach100(BENT, "bent-thesis", 6, durations=(4.0,)).queries]
    plans = [solve(get_planner(name), q) for q in queries]
    lines = [solve(get_planner("straight"), q) for q in queries]
    ratio = [a.predicted.E_res / b.predicted.E_res for a, b in zip(plans, lines, strict=True)]
    assert max(ratio) < 1.2  # its prediction is not quite that of the choice
    assert np.median(ratio) < 0.9
    assert all(p.feasible for p in plans)
    assert any(p.info["shaped_hz"] for p in plans)
    assert all(0 <= p.info["delay"] < 4.0 for p in plans)


def test_without_time_or_modes_the_line_is_the_quintic():
    short = Query(system=BENT, start=(0.0,) * 3, goal=(0.1,) * 3, duration=0.2)
    free = Query(
        system=System(vehicle=FREE_FLOATING), start=(0.0,) * 3, goal=(0.1,) * 3, duration=2
    )
    for query in (short, free):
        plan = solve(get_planner("shaped-zv"), query)
        assert plan.info["shaped_hz"] == []
        assert plan.motion == query.straight


def test_a_smoother_law_on_the_same_line():
    plan = solve(SmoothJerk(), QUERY)
    s = plan.motion.at(np.linspace(0, 4, 101))
    progress = (s.q - QUERY.start) / (np.array(QUERY.goal) - QUERY.start)
    np.testing.assert_allclose(progress, septic(s.t / 4)[:, None] * np.ones(3), atol=1e-6)
