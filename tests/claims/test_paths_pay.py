"""Claim: choosing the path lowers the energy in the base.

`direct` against the straight joint line with the same ends, duration and speed limits
(reach100, bent beam, thesis mass, damped, motor drive); both simulated on the full
nonlinear system. Median ratio of the simulated `E_mean`:

    <= 0.60, 0.35, 0.10 at T = 1, 2, 4 s.

The figures are the design's measured 0.56, 0.30, 0.06 with room for other queries. The one
at T = 1 s is missed on reach100 (docs/claims.md); its tests expect that, and another holds
what is reached. The fast test takes the first queries of 2 s, the slow ones those of 1 and
4 s (forty at T = 1 s, where twelve are not representative) and all hundred.

Missed: median simulated E_mean of `direct` over the straight line on reach100 at T = 1 s:
promised 0.60, measured 0.63 (95 %: 0.57 to 0.68).
"""

import functools

import numpy as np
import pytest

from tests.reach import reach
from ves_gym.planners.query import Plan, solve
from ves_gym.planners.registry import get_planner
from ves_gym.simulation.playback import play_motions

MISS = pytest.mark.xfail(
    reason="miss: 0.63 on the whole suite (95 %: 0.57 to 0.68); random starts find"
    " nothing better, see docs/claims.md"
)
SLOW = pytest.mark.slow
PROMISED = [
    pytest.param(1.0, 0.60, marks=[MISS, SLOW]),
    (2.0, 0.35),
    pytest.param(4.0, 0.10, marks=SLOW),
]


def simulated(plans: list[Plan]) -> np.ndarray:
    """(n,) E_mean [J]."""
    query = plans[0].query
    run = play_motions(query.system, [p.motion for p in plans], servo=query.servo)
    return np.array([e.E_mean for e in run.energies()])


@functools.cache
def ratios(planner: str, duration: float, count: int) -> np.ndarray:
    """(count,) simulated E_mean of a planner over that of the straight line."""
    plans, lines = (
        [solve(get_planner(name), q) for q in reach(duration, count)]
        for name in (planner, "straight")
    )
    return simulated(plans) / simulated(lines)


COUNT = {1.0: 40, 2.0: 12, 4.0: 12}


@pytest.mark.parametrize(("duration", "promised"), PROMISED)
def test_direct_pays(duration, promised):
    assert np.median(ratios("direct", duration, COUNT[duration])) <= promised


@pytest.mark.slow
@pytest.mark.parametrize(("duration", "promised"), PROMISED)
def test_direct_pays_on_the_whole_suite(duration, promised):
    assert np.median(ratios("direct", duration, 100)) <= promised


@pytest.mark.slow
def test_direct_pays_at_one_second():
    """What is reached at T = 1 s: a median below 0.75, and no query made worse."""
    found = ratios("direct", 1.0, COUNT[1.0])
    assert np.median(found) <= 0.75
    assert found.max() < 1


def test_the_straight_line_does_not():
    """The same comparison finds nothing to gain between two straight lines."""
    assert ratios("straight", 2.0, 4) == pytest.approx(np.ones(4), rel=1e-12)
